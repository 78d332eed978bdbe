"""What is counted and logged of a batch."""

from __future__ import annotations

from tensordict import TensorDictBase

__all__ = ["batch_statistics", "control_steps"]


def control_steps(batch: TensorDictBase) -> int:
    """Control steps in a batch; without a macro step, every policy step is one.

    Args:
        batch: what the collector returned.

    Returns:
        Their number.
    """
    steps = batch.get(("next", "control_steps"), None)
    return batch.numel() if steps is None else int(steps.sum())


def batch_statistics(batch: TensorDictBase) -> dict[str, float]:
    """Means over the episodes that ended in a batch; rewards are those of a policy step.

    Args:
        batch: what the collector returned.

    Returns:
        ``reward`` and, where the task has them, the reward groups by name; where episodes ended, also ``success``,
        ``progress`` and each metric.
    """
    following = batch["next"]
    terms = following.get("reward_terms", following.empty())
    statistics = {"reward": following["reward"].mean()}
    statistics |= {f"reward_{name}": terms[name].mean() for name in terms.keys()}
    done = following["done"].squeeze(-1)
    if bool(done.any()):
        ended = following[done]
        statistics |= {"success": ended["success"].float().mean(), "progress": ended["progress"].mean()}
        statistics |= {name: ended["metrics", name].mean() for name in following["metrics"].keys()}
    return {name: float(value) for name, value in statistics.items()}

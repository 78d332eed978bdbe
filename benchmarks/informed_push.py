"""What knowing the hidden would be worth: PPT on box pushing, told at every decision what is drawn and not observed.

The policy reads the box's mass, friction, centre of mass and true place besides what every policy reads. No robot knows
that. What it gains over PPT with the same options and training says how much is to be gained by finding it out, by
touch for example. It is a recipe in a file of its own, so

``ppt-rl train benchmarks/informed_push.py --randomisation.com -0.015 0.015 --run-dir runs/informed``, then
``ppt-rl evaluate runs/informed``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import Transform, TransformedEnv

from ppt_rl.envs import PushEnv
from ppt_rl.evaluation import Recipe
from ppt_rl.modules import ProMP
from ppt_rl.recipes import ppo_ppt_push
from ppt_rl.tasks.push import PUSH, make_push_policy

#: Signs of the hidden quantities when left and right change places: centre of mass, mass, friction, error of the place.
_SIGNS = (1, -1, 1, 1, 1, -1)


class HiddenTransform(Transform):
    """Observes what an episode of :class:`~ppt_rl.envs.PushEnv` hides, as ``hidden`` ``(*B, 6)``.

    These are the centre of mass in the box's axes, 2 [m], its mass [kg] and friction [-], and how far ``box_start`` is
    from the true place of the box at the start, 2 [m].
    """

    def __init__(self, base: PushEnv) -> None:
        super().__init__()
        self._episode, self._start = base._episode, torch.zeros(base.num_envs, 2)

    def _hidden(self) -> Tensor:
        physical = self._episode.physical
        known = [physical["com"], physical["mass"], physical["friction"]]
        return torch.cat([*known, self._episode.box_start - self._start], -1).to(self._episode.half.dtype)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("hidden", self._hidden())

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        place, rows = tensordict_reset["box_pose"][:, :2], tensordict.get("_reset", None)
        self._start = place.clone() if rows is None else torch.where(rows.reshape(-1, 1), place, self._start)
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Declare the observation."""
        half = self._episode.half
        observation_spec["hidden"] = Unbounded(shape=(len(half), 6), dtype=half.dtype, device=half.device)
        return observation_spec


@dataclass(frozen=True)
class Config(ppo_ppt_push.Config):
    """Train PPT on box pushing with a policy that is told what is hidden."""

    run_dir: Path = Path("runs/informed_push")


def make_chain(config: Config, base: PushEnv, promp: ProMP) -> list[Transform]:
    """PPT's chain after a transform that observes what is hidden."""
    return [HiddenTransform(base), *ppo_ppt_push.make_chain(config, base, promp)]


def make_policy(config: Config, env: TransformedEnv) -> tuple[nn.Module, nn.Module]:
    """Actor and critic, both informed."""
    return make_push_policy(
        config, env, initial_scale=config.initial_scale, extra_keys=("tank_energy", "valve", "hidden"),
        extra_signs={"hidden": _SIGNS},
    )  # fmt: skip


RECIPE = Recipe(
    "informed_push", "PPT, informed", PUSH, Config, make_chain, make_policy, ppo_ppt_push.make_modules,
    ppo_ppt_push.fit, has_tank=True, has_reference=True, in_study=False,
)  # fmt: skip

if __name__ == "__main__":
    RECIPE.main()

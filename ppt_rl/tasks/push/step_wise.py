"""What the two step-wise pushing recipes share: from the policy's velocity to the references of the controller."""

from __future__ import annotations

from torchrl.envs import StepCounter, Transform, UnaryTransform

from ppt_rl.envs import PushEnv
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace
from ppt_rl.tasks.push.config import StepWiseConfig
from ppt_rl.tasks.push.prior import PUSH_AXES, fit_push_prior
from ppt_rl.transforms import (
    CartesianVelocityTransform,
    HoldActionTransform,
    MacroStepTransform,
    ReferenceVelocityTransform,
    ViaPointTransform,
)

__all__ = ["fit_step_wise", "step_wise_modules", "step_wise_transforms"]

#: On a reference, the sum of both velocities may be this much faster than the policy's own.
_HEADROOM = 2.0


def step_wise_modules(config: StepWiseConfig) -> dict[str, ProMP]:
    """The movement primitive of the reference, its prior not fitted yet; nothing without a reference.

    Args:
        config: options of the recipe.

    Returns:
        The modules by name.
    """
    return {"promp": ProMP(config.num_basis, len(PUSH_AXES), config.duration)} if config.on_reference else {}


def fit_step_wise(config: StepWiseConfig, promp: ProMP | None = None) -> None:
    """Fit the prior of the reference to scripted demonstrations, where there is one.

    Args:
        config: options of the recipe.
        promp: the primitive; changed in place.
    """
    if promp is not None:
        fit_push_prior(promp, goal=config.goal, counter_turn=config.counter_turn)


def step_wise_transforms(config: StepWiseConfig, base: PushEnv, promp: ProMP | None) -> list[Transform]:
    """The end of a step-wise chain: the policy decides every few control steps on a velocity, which is integrated.

    Args:
        config: options of the recipe.
        base: bare environment.
        promp: the primitive of the reference; None without one.

    Returns:
        The transforms, which write ``phase``, ``reference_position`` and ``last_action`` for the policy.
    """
    speed = tuple((_HEADROOM if config.on_reference else 1.0) * limit for limit in config.velocity)
    chain: list[Transform] = [
        CartesianVelocityTransform(TaskSpace(PUSH_AXES, base.start_pose), max_velocity=speed, max_lead=config.lead),
        MacroStepTransform(config.hold_steps, discount=config.ppo.gamma),
    ]
    hold = HoldActionTransform(config.hold_steps, smoothing=config.smoothing)
    if promp is None:
        phase = UnaryTransform(["step_count"], ["phase"], fn=lambda count: count / config.batch_steps)
        return [*chain, hold, StepCounter(), phase]
    reference = ReferenceVelocityTransform(promp, max_velocity=speed, scale=1 / _HEADROOM)
    return [*chain, reference, hold, ViaPointTransform(promp)]

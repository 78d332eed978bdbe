from __future__ import annotations

import torch
from torchrl.envs import Compose, StepCounter, TransformedEnv, UnaryTransform

from ppt_rl.envs import PandaPushEnv
from ppt_rl.transforms import MacroStepTransform


def interrupted(after: int) -> TransformedEnv:
    """Chunks of five torques that are cut off once so many control steps are over."""
    base = PandaPushEnv(2, num_threads=1, physics_dt=0.002, seed=0)
    late = UnaryTransform(["step_count"], ["late"], fn=lambda count: count >= after)
    return TransformedEnv(base, Compose(StepCounter(), late, MacroStepTransform(5, interrupt_key="late")))


def test_a_chunk_that_interrupts_every_row_stops_one_step_later_and_the_next_goes_on_from_there() -> None:
    env, plain = interrupted(3), PandaPushEnv(2, num_threads=1, physics_dt=0.002, seed=0)
    torque = torch.linspace(-2.0, 2.0, 7).expand(2, 7)
    tensordict, by_hand = env.reset(), plain.reset()
    for executed in (4, 2, 2):  # all at once, so they execute one step more
        tensordict = env.step(tensordict.set("action", torque.unsqueeze(1).expand(2, 5, 7).clone()))
        assert (tensordict["next", "control_steps"] == executed).all()
        for _ in range(executed):
            by_hand = plain.step_mdp(plain.step(by_hand.set("action", torque.clone())))
        torch.testing.assert_close(tensordict["next", "pose"], by_hand["pose"], rtol=0.0, atol=0.0)
        tensordict = env.step_mdp(tensordict)
    env.close()
    plain.close()

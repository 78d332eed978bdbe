from __future__ import annotations

import torch
from torchrl.envs import Compose, StepCounter, TransformedEnv, UnaryTransform

from ppt_rl.envs import PandaPushEnv
from ppt_rl.transforms import MacroStepTransform
from tests.engines import COARSE
from tests.transforms.mocks import MockArmEnv


def interrupted(after: int) -> TransformedEnv:
    """Chunks of five torques that are cut off once so many control steps are over."""
    base = PandaPushEnv(2, seed=0, engine=COARSE)
    late = UnaryTransform(["step_count"], ["late"], fn=lambda count: count >= after)
    return TransformedEnv(base, Compose(StepCounter(), late, MacroStepTransform(5, interrupt_key="late")))


def test_a_chunk_that_interrupts_every_row_stops_one_step_later_and_the_next_goes_on_from_there() -> None:
    env, plain = interrupted(3), PandaPushEnv(2, seed=0, engine=COARSE)
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


def test_a_row_that_waits_beside_one_whose_episode_is_over_keeps_its_state_and_goes_on_from_there() -> None:
    late = UnaryTransform(["count"], ["late"], fn=lambda count: count == 3)
    base = MockArmEnv((2,), horizons=(2, 100))
    env = TransformedEnv(base, Compose(late, MacroStepTransform(5, interrupt_key="late")))
    by_hand = TransformedEnv(MockArmEnv((2,), horizons=(100,)), late.clone())
    chunk = torch.linspace(-1.0, 1.0, 70).reshape(2, 5, 7)
    tensordict, plain = env.reset(), by_hand.reset()
    tensordict = env.step(tensordict.set("action", chunk.clone()))["next"]
    assert tensordict["control_steps"].flatten().tolist() == [2, 3]
    assert tensordict["done"].flatten().tolist() == [True, False]
    reward = torch.zeros(2, 1)
    for step in range(3):
        plain = by_hand.step(plain.set("action", chunk[:, step].clone()))["next"]
        reward += plain["reward"] * torch.tensor([[step < 2], [True]])
        row = 0 if step == 1 else 1 if step == 2 else None
        if row is not None:
            for key in ("count", "pose", "push"):
                torch.testing.assert_close(tensordict[key][row], plain[key][row], rtol=0.0, atol=0.0)
    torch.testing.assert_close(tensordict["reward"], reward)

"""A loop that only executes a policy may run in torch's inference mode, and the environment be used outside again."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from ppt_rl.envs import PandaMazeEnv
from ppt_rl.modules import CartesianImpedanceController
from ppt_rl.transforms import MacroStepTransform
from tests.engines import ONE_THREAD
from tests.transforms.cases import make_chain_env, sliding_env
from tests.transforms.test_step_data import assert_same


def make(task: str) -> TransformedEnv:
    if task == "push":
        return make_chain_env(2, replan_steps=4)
    base = PandaMazeEnv.straight(2, duration=0.1, seed=3, engine=ONE_THREAD)
    return sliding_env(base).append_transform(MacroStepTransform(4))


def episode(env: TransformedEnv, first: TensorDict | None = None) -> TensorDict:
    """Five policy steps, the last of them in the next episode of every environment."""
    td, steps = env.reset(first), []
    for number in range(5):
        generator = torch.Generator().manual_seed(number)
        spec = env.full_action_spec["action"]
        td["action"] = 0.1 * torch.randn(spec.shape, generator=generator)
        if spec.shape[-1] == 13:  # references: near the tool
            td["action"] = torch.cat([td["pose"], torch.zeros(2, 6)], -1).unsqueeze(1) + 0.01 * td["action"]
        step, td = env.step_and_maybe_reset(td)
        steps.append(step["next"])
    return torch.stack(steps)


@pytest.mark.parametrize("task", ["push", "maze"])
def test_a_loop_in_inference_mode_does_the_same_and_the_environment_goes_on_outside(task):
    one, other = make(task), make(task)
    for inference in (True, False, True, False):
        with torch.inference_mode(inference):
            found = episode(one)
        assert_same(found.clone(), episode(other))
        partial = TensorDict({"_reset": torch.tensor([[True], [False]])}, [2])
        with torch.inference_mode(inference):
            found = episode(one, one.reset().update(partial))
        assert_same(found.clone(), episode(other, other.reset().update(partial)))


def test_what_the_transforms_keep_can_be_differentiated_later():
    env = make("push")
    with torch.inference_mode():
        episode(env)
    for transform in env.transform:
        for name, value in vars(transform).items():
            for part in value if isinstance(value, tuple) else (value,):
                assert not (isinstance(part, torch.Tensor) and part.is_inference()), (type(transform).__name__, name)
    inner = env.transform[2]
    pose = torch.tensor([[0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0]], requires_grad=True)
    controller = inner.controller
    controller(pose, torch.zeros(1, 6), pose.detach() + 0.01, torch.zeros(1, 6)).sum().backward()
    assert pose.grad is not None


def test_a_controller_made_in_inference_mode_works_there():
    with torch.inference_mode():
        pose = torch.tensor([[0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0]])
        made = CartesianImpedanceController()
        found = made(pose, torch.zeros(1, 6), pose + 0.01, torch.zeros(1, 6))
    expected = CartesianImpedanceController()(pose, torch.zeros(1, 6), pose + 0.01, torch.zeros(1, 6))
    torch.testing.assert_close(found.clone(), expected, rtol=0.0, atol=0.0)

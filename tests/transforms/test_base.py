"""A law of a user's own on the base class of observers: masks, resets, specs and errors come with it."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Unbounded
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.transforms.observer import ObserverTransform
from tests.transforms.mocks import MockArmEnv, actions_for, play


class LargestForce(ObserverTransform):
    """The largest force of the episode so far, and the share of it that is felt now."""

    state_keys = ("largest_force",)

    def __init__(self):
        super().__init__(in_keys=["wrench"], out_keys=["force_share"])

    def _begin(self, wrench):
        return {"largest_force": self._size(wrench)}

    def _update(self, state, wrench):
        return {"largest_force": torch.maximum(state["largest_force"], self._size(wrench))}

    def _outputs(self, tensordict, state, wrench):
        return {"force_share": self._size(wrench) / state["largest_force"]}

    def _state_specs(self, batch, like):
        return {"largest_force": Unbounded(shape=(*batch, 1), dtype=like.dtype)}

    def _output_specs(self, batch, like):
        return {"force_share": Unbounded(shape=(*batch, 1), dtype=like.dtype)}

    @staticmethod
    def _size(wrench):
        return torch.linalg.vector_norm(wrench[..., :3], dim=-1, keepdim=True)


class Force(ObserverTransform):
    """The size of the force: no state."""

    _hint = " The arm measures it."

    def __init__(self):
        super().__init__(in_keys=["wrench"], out_keys=["force"])

    def _outputs(self, tensordict, state, wrench):
        return {"force": torch.linalg.vector_norm(wrench[..., :3], dim=-1, keepdim=True)}

    def _output_specs(self, batch, like):
        return {"force": Unbounded(shape=(*batch, 1), dtype=like.dtype)}


def observed(batch=(3,), **kwargs):
    return TransformedEnv(MockArmEnv(batch, **kwargs), LargestForce())


def forces(td):
    return torch.linalg.vector_norm(td["wrench"][..., :3], dim=-1, keepdim=True)


@pytest.mark.parametrize("observer", [LargestForce, Force])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_specs_hold(observer, dtype):
    check_env_specs(TransformedEnv(MockArmEnv((2,), dtype=dtype), observer()), break_when_any_done="both")
    check_env_specs(TransformedEnv(SerialEnv(2, MockArmEnv), observer()))


def test_state_and_outputs_are_those_of_the_law_at_every_step_and_every_reset():
    env = observed(horizons=(4,))
    steps = play(env, actions_for(env, 8))
    for start in (0, 4):
        episode = steps[:, start : start + 4]
        seen = torch.cat([forces(episode[:, :1]), forces(episode["next"])], 1)
        assert torch.equal(episode["largest_force"][:, 0], seen[:, 0])
        assert torch.equal(episode["next", "largest_force"], seen.cummax(1).values[:, 1:])
        assert torch.equal(episode["next", "force_share"], seen[:, 1:] / seen.cummax(1).values[:, 1:])


def test_environments_outside_the_step_mask_keep_their_state_and_the_others_go_on():
    env = observed()
    root = env.reset().set("largest_force", torch.full((3, 1), 1e-3)).set("action", actions_for(env, 1)[0])
    reached = env.step(root.clone().set("_step", torch.tensor([True, False, True])))["next"]
    assert torch.equal(reached["largest_force"][1], root["largest_force"][1])
    assert torch.equal(reached["largest_force"][[0, 2]], forces(reached)[[0, 2]])


def test_a_partial_reset_begins_anew_only_where_it_resets():
    env = observed()
    odd = env.reset().set("largest_force", torch.full((3, 1), 1e3))
    reached = env.reset(odd.set("_reset", torch.tensor([[False], [True], [False]])))
    assert reached["largest_force"].flatten()[[0, 2]].tolist() == [1e3, 1e3]
    assert torch.equal(reached["largest_force"][1], forces(reached)[1])


def test_a_step_from_a_root_without_the_state_begins_at_the_readings_of_that_root():
    env = observed()
    root = env.reset().set("action", actions_for(env, 1)[0])
    assert torch.equal(
        env.step(root.exclude("largest_force"))["next", "largest_force"], env.step(root)["next", "largest_force"]
    )


def test_an_observer_without_state_observes_stored_data_and_one_with_state_leaves_them_alone():
    td = MockArmEnv((5,)).reset()
    assert torch.equal(Force()(td.clone())["force"], forces(td))
    assert set(LargestForce()(td.clone()).keys()) == set(td.keys())


@pytest.mark.parametrize("act", ["_step", "_reset"])
def test_a_missing_reading_is_named_with_what_there_is_and_who_writes_it(act):
    td = TensorDict({"twist": torch.zeros(2, 6)}, [2])
    with pytest.raises(
        KeyError, match=r"Force needs \['wrench'\]; the tensordict holds \['twist'\]\. The arm measures"
    ):
        getattr(Force(), act)(td, td)

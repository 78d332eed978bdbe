from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives.value import GAE

from ppt_rl.modules import make_critic
from ppt_rl.training.advantage import AdvantageEstimator
from ppt_rl.training.shards import Shards


def steps(shape, ends, seed=0):
    """Steps ``(*B, T)`` on a path; a share of them ends an episode, and another cuts it off."""
    torch.manual_seed(seed)
    path = torch.randn(*shape[:-1], shape[-1] + 1, 3)
    terminated, truncated = torch.rand(*shape, 1) < ends, torch.rand(*shape, 1) < ends
    done = terminated | truncated
    # After the end of an episode the next root is the first state of another one.
    root = torch.where(done.roll(1, -2), torch.randn(*shape, 3), path[..., :-1, :])
    following = {
        "observation": path[..., 1:, :], "reward": torch.randn(*shape, 1), "done": done, "terminated": terminated,
        "truncated": truncated & ~terminated, "control_steps": torch.randint(1, 9, (*shape, 1)),
    }  # fmt: skip
    return TensorDict({"observation": root, "next": TensorDict(following, shape)}, shape)


@pytest.mark.parametrize("shape", [(1, 1), (7, 1), (5, 23), (2, 3, 11)], ids=str)
@pytest.mark.parametrize("ends", [0.0, 0.2, 1.0])
def test_advantages_are_those_of_torchrl_which_evaluates_every_state_twice(shape, ends):
    critic, batch = make_critic(["observation"], 3), steps(shape, ends)
    expected = GAE(gamma=0.97, lmbda=0.9, value_network=critic, average_gae=False)
    expected.set_keys(steps_to_next_obs=("next", "control_steps"))
    with torch.no_grad():
        expected = expected(batch.clone(), time_dim=len(shape) - 1)
    found = AdvantageEstimator(critic, 0.97, 0.9)(batch.clone())
    for key in ("advantage", "value_target", "state_value"):
        torch.testing.assert_close(found[key], expected[key], rtol=1e-5, atol=1e-5)


def test_a_batch_without_control_steps_counts_every_policy_step_as_one():
    critic, batch = make_critic(["observation"], 3), steps((4, 9), 0.1)
    ones = batch.clone()
    ones["next", "control_steps"] = torch.ones_like(ones["next", "control_steps"])
    estimator = AdvantageEstimator(critic, 0.9, 0.9)
    without = estimator(batch.exclude(("next", "control_steps")))
    torch.testing.assert_close(without["advantage"], estimator(ones)["advantage"])


def test_only_the_ends_of_episodes_that_are_cut_off_are_evaluated_for_themselves():
    critic, batch = make_critic(["observation"], 3), steps((6, 20), 0.1)
    seen = []
    critic.register_forward_pre_hook(lambda module, args: seen.append(len(args[0])))
    AdvantageEstimator(critic, 0.9, 0.9)(batch)
    cut = batch["next", "done"].clone()
    cut[:, -1] = True
    assert seen == [120, int((cut & ~batch["next", "terminated"]).sum())]


@pytest.mark.parametrize("threads", [1, 2])
def test_many_states_are_evaluated_in_parts_without_a_graph(threads):
    critic, batch = make_critic(["observation"], 3), steps((40, 100), 0.05)
    seen = []
    critic.register_forward_hook(lambda module, args, found: seen.append((len(found), found["state_value"].grad_fn)))
    found = AdvantageEstimator(critic, 0.9, 0.9, shards=Shards(threads))(batch.clone())
    assert [graph for _, graph in seen] == [None] * len(seen)
    assert sorted(rows for rows, _ in seen)[-4:] == [1000] * 4
    with torch.no_grad():
        torch.testing.assert_close(found["state_value"], critic(batch.clone())["state_value"])


def test_other_keys_are_read_and_written_on_demand():
    critic = make_critic(["observation"], 3, out_key="cost_value")
    batch = steps((4, 9), 0.1)
    batch["next", "cost"] = batch["next", "reward"].square()
    keys = {"reward": "cost", "advantage": "cost_advantage", "value_target": "cost_target", "value": "cost_value"}
    found = AdvantageEstimator(critic, 0.9, 0.9, **keys)(batch.clone())
    plain = batch.clone()
    plain["next", "reward"] = plain["next", "cost"]
    expected = AdvantageEstimator(critic, 0.9, 0.9, value="cost_value")(plain)
    torch.testing.assert_close(found["cost_advantage"], expected["advantage"])
    assert "advantage" not in found.keys()

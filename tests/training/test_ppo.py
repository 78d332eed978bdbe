from __future__ import annotations

import threading

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.modules import make_actor, make_critic
from ppt_rl.training.batches import batch_statistics, control_steps
from ppt_rl.training.finite import TrainingDiverged
from ppt_rl.training.ppo import Learner, PPOConfig


def batch(actor, count=256):
    """A contextual bandit: the best action is the observation itself."""
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        data = actor(TensorDict({"observation": torch.randn(count, 2)}, [count]))
    reward = -(data["action"] - data["observation"]).square().sum(-1, keepdim=True)
    done = torch.ones_like(reward, dtype=torch.bool)
    following = {
        "observation": torch.randn(count, 2), "reward": reward, "done": done, "terminated": done,
        "truncated": ~done, "control_steps": torch.full_like(reward, 10, dtype=torch.int64),
    }  # fmt: skip
    data["next"] = TensorDict(following, [count])
    return data.unsqueeze(1).refine_names(None, "time")


def learner(**settings):
    actor = make_actor(["observation"], 2, 2, initial_scale=0.5)
    return Learner(actor, make_critic(["observation"], 2), PPOConfig(**settings))


def test_ppo_improves_the_reward_of_a_contextual_bandit():
    ppo = learner(target_kl=0.05)
    rewards = []
    for _ in range(25):
        data = batch(ppo.actor)
        rewards.append(float(data["next", "reward"].mean()))
        ppo.update(data)
    assert sum(rewards[-5:]) / 5 > 0.7 * rewards[0]


def test_values_are_not_bootstrapped_past_the_end_of_a_task():
    ppo = learner()
    data = batch(ppo.actor)
    ppo.advantage(data)
    torch.testing.assert_close(data["value_target"], data["next", "reward"])


def test_the_discount_counts_control_steps():
    ppo = learner(gamma=0.9)
    data = batch(ppo.actor)
    data["next", "terminated"] = torch.zeros_like(data["next", "terminated"])
    ppo.advantage(data)
    expected = data["next", "reward"] + 0.9**10 * data["next", "state_value"]
    torch.testing.assert_close(data["value_target"], expected)


def test_the_divergence_is_zero_before_an_update_and_positive_after():
    ppo = learner()
    data = batch(ppo.actor).reshape(-1)
    assert float(ppo._divergence(data)) == pytest.approx(0.0, abs=1e-6)
    assert ppo.update(batch(ppo.actor))["kl"] > 0


def count_steps(ppo, monkeypatch):
    """A list that grows with every step of the optimizer."""
    steps, step = [], ppo.optimizer.step

    def spy(*args, **kwargs):
        steps.append(len(steps))
        return step(*args, **kwargs)

    monkeypatch.setattr(ppo.optimizer, "step", spy)
    return steps


@pytest.mark.parametrize(("target_kl", "epochs"), [(1e-9, 1), (1e9, 6)])
def test_an_update_ends_early_when_the_policy_has_moved_far_enough(target_kl, epochs, monkeypatch):
    ppo = learner(target_kl=target_kl, epochs=6, minibatches=3)
    steps = count_steps(ppo, monkeypatch)
    result = ppo.update(batch(ppo.actor))
    assert len(steps) == 3 * epochs
    assert (result["kl"] > 2 * target_kl) == (epochs == 1)


def test_the_learning_rate_falls_when_the_policy_moves_too_far_and_rises_when_it_hardly_does():
    rates = [learner(target_kl=kl, epochs=1, learning_rate=1e-4) for kl in (1e-9, 1e9)]
    low, high = (ppo.update(batch(ppo.actor))["learning_rate"] for ppo in rates)
    assert low < 1e-4 < high


@pytest.mark.parametrize(
    ("threads", "count", "parts", "used"), [(2, 2048, 2, 2), (2, 256, 1, 1), (3, 8192, 8, 3), (None, 8192, 8, 4)]
)
def test_the_networks_and_rows_of_a_minibatch_are_shared_among_threads(threads, count, parts, used, monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: set(range(4)))
    actor = make_actor(["observation"], 2, 2, initial_scale=0.5)
    ppo = Learner(actor, make_critic(["observation"], 2), PPOConfig(epochs=1, minibatches=1), threads)
    seen, gradients = [], ppo.objective.gradients

    def spy(rows, share=1.0, losses=ppo.objective.losses):
        seen.append((threading.current_thread(), torch.get_num_threads(), len(rows) * len(losses)))
        return gradients(rows, share, losses)

    monkeypatch.setattr(ppo.objective, "gradients", spy)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        ppo.update(batch(ppo.actor, count))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert len(seen) == parts
    assert 1 <= len({thread for thread, *_ in seen}) <= used  # a quick one may take the work of another
    assert {inside for _, inside, _ in seen} == {1}
    assert sum(rows for *_, rows in seen) == 2 * count  # each row for actor and critic


def test_the_number_of_threads_changes_no_bit_of_an_update():
    results = []
    for threads in (1, 3):
        torch.manual_seed(0)
        actor = make_actor(["observation"], 2, 2, initial_scale=0.5)
        config = PPOConfig(epochs=3, minibatches=2, target_kl=1e9)
        ppo = Learner(actor, make_critic(["observation"], 2), config, threads)
        results.append((ppo.update(batch(ppo.actor, 6144)), [value.detach() for value in ppo.objective.parameters]))
    (told, ours), (also, theirs) = results
    assert also == told
    assert all(torch.equal(one, other) for one, other in zip(ours, theirs, strict=True))


def test_the_divergence_of_a_large_batch_is_that_of_rows_at_equal_distances():
    ppo = learner(epochs=1, learning_rate=2e-3)
    data = batch(ppo.actor, 6144)
    ppo.update(data)
    flat = data.reshape(-1)
    judged = ppo._judged(flat)
    assert torch.equal(judged["observation"], flat["observation"][::6])
    assert float(ppo._divergence(judged)) == pytest.approx(float(ppo._divergence(flat)), rel=0.2)
    old = ppo.actor.det_part(judged.clone())
    assert float(ppo._divergence(judged.update({"loc": old["loc"], "scale": old["scale"]}))) == pytest.approx(0.0)


def test_the_threads_of_torch_are_given_back_where_an_update_fails(monkeypatch):
    ppo, threads, before = learner(), [], torch.get_num_threads()

    def fail():
        threads.append(torch.get_num_threads())
        raise RuntimeError("no step")

    monkeypatch.setattr(ppo.optimizer, "step", fail)
    torch.set_num_threads(2)
    try:
        with pytest.raises(RuntimeError, match="no step"):
            ppo.update(batch(ppo.actor, 64))
        assert threads == [1]
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_an_update_leaves_the_batch_as_it_was():
    ppo = learner(epochs=1)
    data = batch(ppo.actor)
    before = data.clone()
    ppo.update(data)
    assert set(data.keys(True, True)) == set(before.keys(True, True))
    assert all(torch.equal(data[key], before[key]) for key in before.keys(True, True))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_update_ends_before_a_step_that_is_not_finite(bad, monkeypatch):
    ppo = learner(minibatches=1)
    steps, data = count_steps(ppo, monkeypatch), batch(ppo.actor)
    data["next", "reward"][3] = bad
    before = [value.clone() for value in ppo.objective.parameters]
    with pytest.raises(TrainingDiverged, match=r"^(objective|critic|gradient) is (nan|inf)$"):
        ppo.update(data)
    assert not steps
    assert all(torch.equal(a, b) for a, b in zip(before, ppo.objective.parameters, strict=True))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_where_the_host_may_not_look_a_step_that_is_not_finite_is_left_out_and_told_after_the_pass(bad, monkeypatch):
    monkeypatch.setattr("ppt_rl.training.ppo.is_readable", lambda value: False)
    ppo = learner(epochs=3, minibatches=2)
    data = batch(ppo.actor)
    data["next", "reward"][3] = bad
    steps = count_steps(ppo, monkeypatch)
    with pytest.raises(TrainingDiverged, match=r"^(objective|critic|gradient) is (nan|inf)$"):
        ppo.update(data)
    assert len(steps) == 2
    assert all(value.isfinite().all() for value in ppo.objective.parameters)


def test_a_step_that_makes_a_network_infinite_is_named(monkeypatch):
    ppo = learner()
    monkeypatch.setattr(ppo.optimizer, "step", lambda: next(ppo.critic.parameters()).data.fill_(torch.inf))
    with pytest.raises(TrainingDiverged, match=r"is (not finite|nan|inf)$"):
        ppo.update(batch(ppo.actor))


# -- what is logged of a batch -----------------------------------------------------------------------------------------


def record(ends, **following):
    """Two environments over four steps; ``ends`` are the steps at which an episode of each is over."""
    done = torch.zeros(2, 4, 1, dtype=torch.bool)
    for row, steps in enumerate(ends):
        done[row, steps] = True
    step = torch.arange(1.0, 9.0).reshape(2, 4, 1)
    metrics = TensorDict({"work": step * done, "max_power": 2 * step * done}, [2, 4])
    terms = TensorDict({"progress": step, "power": -0.1 * step}, [2, 4])
    data = {
        "done": done, "reward": step, "success": step > 5, "progress": 0.1 * step, "metrics": metrics,
        "reward_terms": terms, **following,
    }  # fmt: skip
    return TensorDict({"next": TensorDict(data, [2, 4])}, [2, 4])


def test_statistics_are_means_over_the_episodes_that_ended_and_rewards_those_of_a_policy_step():
    found = batch_statistics(record([[3], [1, 3]]))  # steps 1 2 3 4 and 5 6 7 8: episodes end at 4, at 6 and at 8
    expected = {
        "reward": 4.5, "reward_progress": 4.5, "reward_power": -0.45, "success": 2 / 3, "progress": 0.6, "work": 6.0,
        "max_power": 12.0,
    }  # fmt: skip
    assert found == pytest.approx(expected)


def test_a_batch_in_which_no_episode_ended_tells_its_rewards_only():
    expected = {"reward": 4.5, "reward_progress": 4.5, "reward_power": -0.45}
    assert batch_statistics(record([[], []])) == pytest.approx(expected)


def test_control_steps_are_those_of_the_macro_steps_or_else_the_number_of_policy_steps():
    assert control_steps(record([[3], [3]])) == 8
    counts = torch.tensor([[7, 7, 7, 2], [7, 7, 7, 7]]).unsqueeze(-1)
    assert control_steps(record([[3], [3]], control_steps=counts)) == 51


@pytest.mark.parametrize(("name", "value"), [("epochs", 0), ("clip", -0.1), ("gamma", 1.5), ("learning_rate", -1.0)])
def test_impossible_settings_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        PPOConfig(**{name: value})

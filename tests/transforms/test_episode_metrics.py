from __future__ import annotations

import pytest
import torch
from torchrl.envs import Compose, StepCounter, TerminateTransform, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.functional.metrics import METRICS, MetricsConfig, begin_metrics, summarise_metrics, update_metrics
from ppt_rl.modules import Kinematics
from ppt_rl.transforms import EpisodeMetricsTransform, JointTorqueTransform, MacroStepTransform, PowerLimitTransform
from tests.transforms.cases import push_env
from tests.transforms.mocks import MockArmEnv, actions_for, play

CONFIG = MetricsConfig(p_max=1.0, contact_force=3.0)


def offline(steps, dt=0.01):
    """Metrics of a recorded episode ``(T, ...)`` by the functional form."""
    memory = begin_metrics(steps["twist"][0], steps["wrench"][0], CONFIG, dt=dt)
    for step in steps["next"].unbind(0):
        power = step.get("power", None)
        power = (step["twist"] * step["wrench"]).sum(-1, keepdim=True) if power is None else power
        memory = update_metrics(memory, step["twist"], step["wrench"], power, CONFIG, dt=dt)
    return summarise_metrics(memory)


def test_streaming_equals_the_functional_form_on_every_recorded_episode():
    env = TransformedEnv(MockArmEnv((2,), horizons=(5, 7)), EpisodeMetricsTransform(CONFIG))
    steps = play(env, actions_for(env, 15))
    episodes = 0
    for row, horizon in enumerate((5, 7)):
        for start in range(0, 16 - horizon, horizon):
            episode = steps[row, start : start + horizon]
            assert episode["next", "done"].flatten().tolist() == [False] * (horizon - 1) + [True]
            expected = offline(episode)
            for name in METRICS:
                torch.testing.assert_close(episode["next", "metrics", name][-1], expected[name])
            episodes += 1
    assert episodes == 5


def test_metrics_are_zero_before_done_and_at_reset_in_every_row():
    env = TransformedEnv(MockArmEnv((2,), horizons=(3, 5)), EpisodeMetricsTransform(CONFIG))
    steps = play(env, actions_for(env, 12))
    done = steps["next", "done"]
    for name in METRICS:
        assert not steps["next", "metrics", name][~done].any()
    assert (steps["next", "metrics", "max_power"][done] > 0).all()
    assert (steps["next", "metrics", "jerk_rms"][done] > 0).all()
    begins = torch.cat([torch.ones_like(done[:, :1]), done[:, :-1]], 1)
    for name in METRICS:
        assert not steps["metrics", name][begins].any()


def test_a_partial_reset_begins_a_new_episode_in_its_rows_and_goes_on_in_the_others():
    env = TransformedEnv(MockArmEnv((2,), horizons=(20,)), EpisodeMetricsTransform(CONFIG))
    last = env._step_mdp(play(env, actions_for(env, 3))[:, -1])
    reached = env.reset(last.clone().set("_reset", torch.tensor([[True], [False]])))
    fresh = begin_metrics(reached["twist"], reached["wrench"], CONFIG, dt=0.01)
    assert torch.equal(reached["metrics_memory"][0], fresh[0])
    assert torch.equal(reached["metrics_memory"][1], last["metrics_memory"][1])
    assert not torch.equal(reached["metrics_memory"][1], fresh[1])


def test_max_power_is_the_commanded_power_where_it_is_observed():
    chain = Compose(JointTorqueTransform(Kinematics(PANDA, 0.1)), EpisodeMetricsTransform(CONFIG))
    env = TransformedEnv(MockArmEnv((2,), horizons=(6,)), chain)
    steps = play(env, actions_for(env, 6, scale=20.0))
    commanded = (steps["action"] * steps["twist"]).sum(-1).abs().amax(1)
    measured = (steps["next", "twist"] * steps["next", "wrench"]).sum(-1).abs().amax(1)
    torch.testing.assert_close(steps["next", "metrics", "max_power"][:, -1, 0], commanded)
    torch.testing.assert_close(steps["next", "metrics", "max_power_measured"][:, -1, 0], measured)


def test_max_power_is_the_measured_power_where_no_commanded_one_is_observed():
    env = TransformedEnv(MockArmEnv((2,), horizons=(6,)), EpisodeMetricsTransform(CONFIG))
    end = play(env, actions_for(env, 6))["next", "metrics"][:, -1]
    torch.testing.assert_close(end["max_power"], end["max_power_measured"])


@pytest.mark.parametrize("dt", [0.01, 0.02])
def test_streaming_equals_the_functional_form_on_the_simulated_arm(dt):
    chain = [JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)), EpisodeMetricsTransform(CONFIG)]
    env = push_env(2, *chain, duration=10 * dt, control_dt=dt)
    steps = play(env, actions_for(env, 10, scale=10.0))
    assert steps["next", "done"][:, -1].all()
    for row in range(2):
        for name, value in offline(steps[row], dt).items():
            torch.testing.assert_close(steps["next", "metrics", name][row, -1], value)


@pytest.mark.parametrize("key", ["twist", "wrench"])
def test_a_missing_observation_is_named_with_what_there_is(key):
    transform = EpisodeMetricsTransform()
    td = MockArmEnv((2,)).reset().exclude(key)
    with pytest.raises(KeyError, match=rf"EpisodeMetricsTransform needs .*{key}.*holds .*count"):
        transform._step(td, td)


@pytest.mark.parametrize(
    "later",
    [
        lambda: JointTorqueTransform(Kinematics(PANDA, 0.1)),
        lambda: StepCounter(max_steps=5),
        lambda: PowerLimitTransform(1.0, terminate=True),
        lambda: TerminateTransform(lambda td: td["done"]),
    ],
    ids=["power", "step counter", "power limit", "terminate"],
)
def test_a_transform_whose_power_or_end_of_episodes_would_be_missed_is_refused(later):
    env = TransformedEnv(MockArmEnv((2,)), Compose(EpisodeMetricsTransform(), later()))
    with pytest.raises(ValueError, match=r"EpisodeMetricsTransform stands before \['\w+'\].*append it after them"):
        env.reset()


def test_after_a_counter_that_ends_episodes_the_metrics_are_those_of_the_episode():
    env = TransformedEnv(
        MockArmEnv((2,), horizons=(20,)), Compose(StepCounter(max_steps=5), EpisodeMetricsTransform(CONFIG))
    )
    episode = play(env, actions_for(env, 5))[0]
    assert bool(episode["next", "done"][-1])
    for name, value in offline(episode).items():
        torch.testing.assert_close(episode["next", "metrics", name][-1], value)


def test_a_counter_that_only_counts_may_stand_anywhere():
    env = TransformedEnv(MockArmEnv((2,)), Compose(EpisodeMetricsTransform(), StepCounter()))
    assert (env.rollout(6)["next", "metrics", "max_power"][:, -1] > 0).all()


def test_after_a_macro_step_the_metrics_are_refused():
    env = TransformedEnv(MockArmEnv((2,)), Compose(MacroStepTransform(2), EpisodeMetricsTransform()))
    with pytest.raises(ValueError, match="EpisodeMetricsTransform stands after a MacroStepTransform"):
        env.reset()

"""The example on other people's environments: specs, what the tank bounds, and a training."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
import torch
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

PATH = Path(__file__).resolve().parents[2] / "examples" / "reacher.py"
_SPEC = importlib.util.spec_from_file_location("reacher_example", PATH)
reacher_example = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = reacher_example  # a dataclass looks its module up
_SPEC.loader.exec_module(reacher_example)
REACHERS = reacher_example.REACHERS
either = pytest.mark.parametrize("name", REACHERS)


@either
def test_the_chain_keeps_its_specs_and_an_episode_has_five_policy_steps(name):
    env = reacher_example.make_env(REACHERS[name], 2, seed=0)
    check_env_specs(env)
    steps = env.rollout(7, break_when_any_done=False)["next"]
    assert steps["done"][0].flatten().tolist() == [False] * 4 + [True] + [False] * 2
    assert (steps["control_steps"] == round(0.2 * REACHERS[name].duration / REACHERS[name].dt)).all()
    env.close()


@either
def test_the_control_step_and_the_gear_are_those_of_the_environment(name):
    env = REACHERS[name].make()
    inner = env._env.physics if name == "dm_control" else env._env.unwrapped
    step = env._env.control_timestep() if name == "dm_control" else inner.dt
    assert step == pytest.approx(REACHERS[name].dt)
    assert inner.model.actuator_gear[:, 0].tolist() == [REACHERS[name].gear] * 2
    env.close()


@either
def test_what_is_executed_stays_within_power_and_energy_whatever_the_policy_does(name):
    reacher = REACHERS[name]
    chain = reacher_example.make_chain(reacher)
    macro = next(i for i, stage in enumerate(chain) if type(stage).__name__ == "MacroStepTransform")
    env = TransformedEnv(reacher.make(), Compose(*chain[:macro]))  # at control rate
    env.set_seed(0)
    spent, td = 0.0, env.reset()
    for _ in range(25):
        reference = torch.cat([td["joint_position"] + 3 * torch.randn(2), 20 * torch.randn(2)])
        executed = []
        env.base_env._step = _recording(env.base_env._step, executed)
        velocity = td["joint_velocity"].clone()
        td = env._step_mdp(env.step(td.set("action", reference)))
        power = reacher.gear * float((executed[0].to(velocity) * velocity).sum().abs())  # [W]
        spent += power * reacher.dt
        assert executed[0].abs().max() <= 1.0
        assert power <= reacher.p_max * (1 + 1e-5)
        assert spent <= reacher.e_max * (1 + 1e-5)
        del env.base_env._step
    assert spent > 0.1 * reacher.e_max
    env.close()


def _recording(step, executed):
    def record(td):
        executed.append(td["action"].clone())
        return step(td)

    return record


@either
def test_a_short_training_leaves_an_actor_that_plays_whole_episodes(name):
    reacher = REACHERS[name]
    actor = reacher_example.train(reacher, control_steps=100, num_envs=1)
    reached = reacher_example.returns(reacher, actor, seed=1, episodes=2)
    assert reached.shape == (2,)
    assert reached.isfinite().all()


@pytest.mark.slow
def test_a_minute_of_training_improves_the_return():
    reacher = REACHERS["gym"]
    actor = reacher_example.train(reacher)

    def mean(policy):
        return torch.stack([reacher_example.returns(reacher, policy, 1000 + 100 * seed) for seed in range(3)]).mean()

    assert mean(actor) > mean(None) + 2.0

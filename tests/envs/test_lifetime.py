from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import ArmEnv, EngineConfig, MazeEnv, MazeLayout, PushEnv, Straight, paper_layout
from ppt_rl.envs.physics import Parameter
from tests.engines import COARSE, ONE_THREAD, model_of, write_state
from tests.envs.scenes import assert_same, opengl
from tests.transforms.cases import make_chain_env

SHORT = {"duration": 0.05, "seed": 3, "engine": COARSE}
ENVS = {
    "ArmEnv": lambda: ArmEnv(3, **SHORT),
    "PushEnv": lambda: PushEnv(3, **SHORT),
    "PushEnv, audited, on two threads": lambda: PushEnv(
        3, duration=0.05, seed=3, engine=EngineConfig(physics_dt=0.002, num_threads=2, audit=True)
    ),
    "straight MazeEnv": lambda: MazeEnv.straight(2, **SHORT),
    "random MazeEnv": lambda: MazeEnv.mazes(2, **SHORT),
    "given MazeEnv": lambda: MazeEnv.of([paper_layout(), MazeLayout((Straight(0.2),))], 3, **SHORT),
    "chain on PushEnv": lambda: make_chain_env(2, replan_steps=2, duration=0.06),
}
COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}
every_env = pytest.mark.parametrize("name", ENVS)
every_copy = pytest.mark.parametrize("how", COPIES)


def in_the_middle(name):
    """An environment in the middle of an episode, and the tensordict to step from."""
    env = ENVS[name]()
    env.rollout(4)
    generator = torch.Generator().manual_seed(1)
    td = env.reset()
    for _ in range(2):
        td = env._step_mdp(env.step(td.set("action", draw(env, generator))))
    return env, td


def draw(env, generator):
    spec = env.full_action_spec["action"]
    return 0.3 * torch.randn(spec.shape, generator=generator, dtype=spec.dtype)


def continued(env, td, steps=7, seed=2):
    """What follows from fixed actions, across the ends of episodes."""
    generator, reached, td = torch.Generator().manual_seed(seed), [], td.clone()
    for _ in range(steps):
        step, td = env.step_and_maybe_reset(td.set("action", draw(env, generator)))
        reached.append(step["next"].clone())
    return [*reached, td]


@every_env
@every_copy
def test_a_copy_continues_like_the_original_and_draws_the_same_next_episodes(name, how):
    env, td = in_the_middle(name)
    other = COPIES[how](env)
    expected, reached = continued(env, td), continued(other, td)
    assert any(step["done"].any() for step in expected)
    for one, two in zip(expected, reached, strict=True):
        assert_same(one, two)
    env.close()
    other.close()


@every_env
@every_copy
def test_what_a_copy_does_leaves_the_original_as_it_was(name, how):
    undisturbed, td = in_the_middle(name)
    expected = continued(undisturbed, td)
    env, td = in_the_middle(name)
    other = COPIES[how](env)
    continued(other, td, seed=9)
    other.close()
    for one, two in zip(expected, continued(env, td), strict=True):
        assert_same(one, two)


@every_copy
def test_a_copy_of_an_environment_that_was_never_reset_begins_with_the_same_episode(how):
    env = PushEnv(2, **SHORT)
    other = COPIES[how](env)
    assert_same(env.reset(), other.reset())
    check_env_specs(other)


@every_copy
def test_a_copy_has_models_and_states_of_its_own(how):
    env = PushEnv(2, **SHORT)
    env.reset()
    other = COPIES[how](env)
    mass, state = float(model_of(env, 0).body("box").mass[0]), env.engine.state(0)
    other.engine.write(torch.tensor([0]), [Parameter("body_mass", ("box",), torch.full((2, 1), 9.0))])
    write_state(other, 0, slice(None), 0.0)
    assert model_of(other, 0).body("box").mass[0] == 9
    assert not other.engine.state(0).any()
    assert model_of(env, 0).body("box").mass[0] == mass
    assert np.array_equal(env.engine.state(0), state)


@every_copy
def test_a_copy_of_a_closed_environment_is_closed(how):
    env = PushEnv(1, **SHORT)
    env.reset()
    env.close()
    other = COPIES[how](env)
    assert other.is_closed
    with pytest.raises(RuntimeError, match="PushEnv is closed"):
        other.reset()


@opengl
@every_copy
def test_a_copy_of_a_rendered_environment_renders_for_itself(how):
    env = PushEnv(1, **SHORT)
    env.reset()
    picture = env.render(width=32, height=24)
    other = COPIES[how](env)
    env.close()
    assert np.array_equal(other.render(width=32, height=24), picture)
    other.close()


@every_copy
def test_an_environment_that_a_collector_uses_can_be_copied(how):
    env = PushEnv(2, **SHORT)
    collector = Collector(env, frames_per_batch=4, total_frames=4)
    other = COPIES[how](env)
    assert other.collector is None
    collector.shutdown()
    assert env.is_closed
    assert other.rollout(2).shape == (2, 2)


# -- order of calls ----------------------------------------------------------------------------------------------------


def test_an_environment_is_open_until_it_is_closed_and_its_threads_stop_then():
    env = PushEnv(2, engine=EngineConfig(num_threads=2, name="threads"))
    assert not env.is_closed
    pool = env.engine._pool
    env.close()
    assert env.is_closed
    with pytest.raises(RuntimeError):  # mujoco's own error: the pool has no threads left
        pool.rollout(env.engine.models, env.engine._data, env.engine._state, nstep=1)


def test_closing_twice_is_an_error_unless_it_is_asked_for():
    env = PushEnv(1, **SHORT)
    env.close()
    with pytest.raises(RuntimeError, match=r"PushEnv is closed already; .* call close\(raise_if_closed=False\)"):
        env.close()
    env.close(raise_if_closed=False)


def test_closing_a_chain_closes_its_environment_once():
    env = TransformedEnv(PushEnv(1, **SHORT))
    env.close()
    assert env.base_env.is_closed
    with pytest.raises(RuntimeError, match="PushEnv is closed already"):
        env.close()
    env.close(raise_if_closed=False)


@pytest.mark.parametrize(
    "use",
    [
        lambda env, td: env.reset(),
        lambda env, td: env.step(td),
        lambda env, td: env.rollout(2),
        lambda env, td: env.physics(),
    ],
    ids=["reset", "step", "rollout", "physics"],
)
@pytest.mark.parametrize("wrap", [lambda env: env, TransformedEnv], ids=["bare", "transformed"])
def test_a_closed_environment_is_of_no_more_use_and_says_so(wrap, use):
    env = wrap(PushEnv(1, **SHORT))
    td = env.rand_action(env.reset())
    env.close()
    with pytest.raises(RuntimeError, match=r"PushEnv is closed, so its physics threads have stopped.* Make a new"):
        use(env, td)


@opengl
def test_a_closed_environment_renders_no_more():
    env = PushEnv(1, **SHORT)
    env.reset()
    env.render(width=32, height=24)
    env.close()
    with pytest.raises(RuntimeError, match="PushEnv is closed"):
        env.render(width=32, height=24)


def test_a_step_before_the_first_reset_is_an_error_that_names_the_environments():
    env = PushEnv(3, engine=ONE_THREAD)
    td = env.fake_tensordict().exclude("next")
    with pytest.raises(RuntimeError, match=r"stepped before its first reset \(environments \[0, 1, 2\]\).*env.reset"):
        env.step(td)
    env.reset(td.empty().set("_reset", torch.tensor([[True], [False], [True]])))
    with pytest.raises(RuntimeError, match=r"environments \[1\]"):
        env.step(td)
    stepped = env.step(td.clone().set("_step", torch.tensor([True, False, True])))
    assert stepped["next", "pose"].isfinite().all()
    env.reset()
    env.step(td)

"""Chunks over ``SerialEnv`` and ``ParallelEnv`` of batch-locked environments, the macro step outside or inside."""

from __future__ import annotations

import multiprocessing
from functools import partial

import pytest
import torch
from torchrl.envs import Compose, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import PushEnv
from ppt_rl.transforms import EnergyTankTransform, MacroStepTransform
from tests.engines import COARSE
from tests.envs.scenes import assert_same
from tests.transforms.cases import make_chain_env
from tests.transforms.mocks import MockArmEnv, actions_for, play

multiprocessing.get_context("forkserver").set_forkserver_preload(["torchrl.envs", "ppt_rl.envs", "ppt_rl.transforms"])
WORKERS = {"serial": SerialEnv, "parallel": partial(ParallelEnv, mp_start_method="forkserver")}
every_kind = pytest.mark.parametrize("kind", WORKERS)


def mock(honours=True):
    return MockArmEnv((3,), horizons=(2, 9, 5), honours_step=honours)


def push():
    return PushEnv(3, duration=0.06, seed=4, engine=COARSE)


def tank():
    return EnergyTankTransform(p_max=0.5, e_max=0.05, dt=0.01)


def outside(kind, make, *inner):
    return TransformedEnv(
        WORKERS[kind](2, make), Compose(*(stage() for stage in inner), MacroStepTransform(4, trace_keys=["pose"]))
    )


def inside(make, *inner):
    return TransformedEnv(make(), Compose(*(stage() for stage in inner), MacroStepTransform(4, trace_keys=["pose"])))


@every_kind
@pytest.mark.parametrize("honours", [True, False], ids=["honours_step", "ignores_step"])
def test_rows_of_a_worker_that_end_inside_a_chunk_are_frozen_at_their_own_ends(kind, honours):
    env, alone = outside(kind, partial(mock, honours)), inside(mock)
    root, chunk = env.reset(), actions_for(env, 1)[0]
    reached = env.step(root.clone().set("action", chunk))["next"]
    assert reached["control_steps"].flatten().tolist() == [2, 4, 4] * 2
    assert reached["done"].flatten().tolist() == [True, False, False] * 2
    for worker in range(2):
        expected = alone.step(root[worker].clone().set("action", chunk[worker]))["next"]
        assert_same(reached[worker].select(*expected.keys(True, True)), expected)
    env.close()


@every_kind
@pytest.mark.parametrize("where", ["outside", "inside"])
def test_rows_of_the_simulated_arm_that_end_at_different_times_equal_single_batches(kind, where):
    """A partial reset in the middle of an episode of six control steps lets rows end at different times."""
    env = outside(kind, push, tank) if where == "outside" else WORKERS[kind](2, partial(inside, push, tank))
    alone = [inside(push, tank) for _ in range(2)]
    check_env_specs(env)
    env.set_seed(5)
    seed = 5
    for one in alone:
        seed = one.set_seed(seed)
    generator, some = torch.Generator().manual_seed(0), torch.tensor([[True, False, False], [False, True, True]])
    td, singles = env.reset(), [one.reset() for one in alone]
    for turn in range(4):
        chunk = 2.0 * torch.randn(2, 3, 4, 7, generator=generator)
        following, td = env.step_and_maybe_reset(td.set("action", chunk))
        for worker, one in enumerate(alone):
            expected, singles[worker] = one.step_and_maybe_reset(singles[worker].set("action", chunk[worker]))
            assert_same(following["next"][worker], expected["next"])
            assert_same(td[worker], singles[worker])
        if turn == 0:
            td = env.reset(td.set("_reset", some.unsqueeze(-1)))
            for worker, one in enumerate(alone):
                singles[worker] = one.reset(singles[worker].set("_reset", some[worker].unsqueeze(-1)))
        if turn == 1:
            assert following["next", "control_steps"].flatten().tolist() == [4, 2, 2, 2, 4, 4]
            assert (following["next", "valve"] < 1).any()
    env.close()


@every_kind
def test_the_whole_chain_runs_in_workers_of_three_arms(kind):
    env, alone = WORKERS[kind](2, partial(make_chain_env, 3)), make_chain_env(3)
    check_env_specs(env)
    actions = actions_for(env, 3)
    env.set_seed(7)
    alone.set_seed(7)
    assert_same(play(env, actions)[0], play(alone, actions[:, 0]))
    env.close()


# -- what torchrl's batched environments cannot do ---------------------------------------------------------------------


@every_kind
def test_waiting_for_an_interruption_is_refused_because_workers_step_as_a_whole(kind):
    env = TransformedEnv(WORKERS[kind](2, mock), MacroStepTransform(4, interrupt_key="via_mask"))
    with pytest.raises(
        ValueError, match=r"interrupt_key is 'via_mask', but \w+Env steps whole workers of 3 .*into the"
    ):
        env.reset()
    env.close()


def test_a_mask_that_selects_a_part_of_a_worker_is_refused_with_the_remedy():
    env = outside("serial", mock)
    td = env.reset().set("action", actions_for(env, 1)[0])
    mask = torch.tensor([[True, True, True], [True, False, True]])
    with pytest.raises(
        ValueError, match=r"SerialEnv steps whole workers only. Put MacroStepTransform into the workers"
    ):
        env.step(td.clone().set("_step", mask))
    reached = env.step(td.clone().set("_step", torch.tensor([[True] * 3, [False] * 3])))["next"]
    assert reached["control_steps"].flatten().tolist() == [2, 4, 4, 0, 0, 0]
    assert not reached["reward"][1].any()
    assert torch.equal(reached["pose"][1], td["pose"][1])


def test_interruptions_work_over_workers_of_one_environment_each():
    base = SerialEnv(2, partial(MockArmEnv, (1,)))
    env = TransformedEnv(base, MacroStepTransform(4, interrupt_key="done"))
    assert env.reset().shape == (2, 1)
    check_env_specs(env)

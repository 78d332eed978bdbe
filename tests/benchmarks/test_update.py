from __future__ import annotations

import pytest
import torch
import update

SMALL = update.Config(num_envs=4, steps=8, observations=5, actions=2, epochs=1, minibatches=2, repeats=1, busy=False)


def test_our_update_of_the_benchmark_learns():
    run = update.ours(SMALL)
    run()
    run()


def test_the_batch_has_the_shape_of_a_collectors():
    from ppt_rl.modules import make_actor

    batch = update.make_batch(SMALL, make_actor(["observation"], 5, 2))
    assert batch.shape == (4, 8)
    assert torch.equal(batch["observation"][:, 1:], batch["next", "observation"][:, :-1])


def test_both_are_timed_in_turn_and_compared():
    pytest.importorskip("rsl_rl")
    result = update.measure(SMALL)
    assert {"ours_quiet_s", "rsl_rl_quiet_s", "ratio_quiet"} == set(result)
    assert all(value > 0 for value in result.values())


def test_a_process_beside_is_busy_and_ends():
    with update.busy_process() as process:
        assert process.is_alive()
    assert not process.is_alive()

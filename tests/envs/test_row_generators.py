from __future__ import annotations

import pytest
import torch

from ppt_rl.envs import MazeEnv, PushEnv
from ppt_rl.envs.row_generators import RowGenerators
from tests.engines import COARSE

SHORT = {"duration": 0.1, "engine": COARSE}
MAKERS = [PushEnv, MazeEnv.mazes, MazeEnv.straight]
each_task = pytest.mark.parametrize("make", MAKERS, ids=["push", "mazes", "straight"])


def starts(env, resets: int) -> list[torch.Tensor]:
    """Joint positions and what the task draws, after each of some resets."""
    keys = ("goal", "box_start", "box_size") if isinstance(env, PushEnv) else ("start_heading", "corridor_heading")
    tds = [env.reset() for _ in range(resets)]
    return [torch.cat([td["joint_position"], *(td[key] for key in keys)], -1) for td in tds]


@each_task
def test_the_episodes_of_a_row_do_not_depend_on_the_size_of_the_batch(make):
    few, many = (starts(make(size, seed=5, **SHORT), 3) for size in (2, 5))
    for a, b in zip(few, many, strict=True):
        torch.testing.assert_close(a, b[:2], rtol=0, atol=0)
        assert not torch.equal(b[0], b[1])


@each_task
def test_a_row_of_a_batch_is_repeated_alone(make):
    many, alone = make(4, seed=7, **SHORT), make(1, seed=0, **SHORT)
    alone.first_row = 2
    alone.set_seed(7)
    for a, b in zip(starts(alone, 2), starts(many, 2), strict=True):
        torch.testing.assert_close(a[0], b[2], rtol=0, atol=0)


@each_task
def test_what_a_row_draws_does_not_depend_on_the_resets_of_others(make):
    env, other = make(3, seed=1, **SHORT), make(3, seed=1, **SHORT)
    env.reset()
    td = other.reset()
    for _ in range(3):
        td = other.reset(td.set("_reset", torch.tensor([[True], [False], [False]])))
    torch.testing.assert_close(starts(env, 1)[0][1:], starts(other, 1)[0][1:], rtol=0, atol=0)


@each_task
def test_torchs_seed_governs_an_environment_without_one(make):
    def first(seed: int) -> torch.Tensor:
        torch.manual_seed(seed)
        return starts(make(2, **SHORT), 1)[0]

    assert torch.equal(first(3), first(3))
    assert not torch.equal(first(3), first(4))


def test_drawing_for_some_rows_leaves_the_generators_of_the_others():
    rows, again = RowGenerators(3, 4), RowGenerators(3, 4)
    rows.uniform(torch.tensor([0, 0, 2]), 5)
    some, first = torch.tensor([1, 3]), torch.tensor([0])
    assert torch.equal(rows.uniform(some, 2), again.uniform(some, 2))
    assert not torch.equal(rows.uniform(first, 2), again.uniform(first, 2))


def test_numbers_drawn_ahead_are_those_drawn_one_by_one():
    """As on a GPU, here on the CPU: rows begin episodes in any order, more of them than are drawn ahead."""
    plain, ahead = RowGenerators(3, 5), RowGenerators(3, 5)
    ahead.draws_ahead = True
    generator = torch.Generator().manual_seed(0)
    for _ in range(70):
        rows = (torch.rand(5, generator=generator) < 0.4).nonzero().squeeze(-1)
        if len(rows):
            assert torch.equal(plain.uniform(rows, 3), ahead.uniform(rows, 3))


def test_streams_and_seeds_draw_different_numbers():
    row, each = torch.tensor([0]), [(seed, stream) for seed in (0, 1) for stream in (0, 1)]
    draws = {tuple(RowGenerators(seed, 1, stream=stream).uniform(row, 2)[0].tolist()) for seed, stream in each}
    assert len(draws) == 4


def test_a_negative_seed_is_refused():
    with pytest.raises(ValueError, match="seed is -1; expected a whole number of at least 0"):
        PushEnv(1, seed=-1, **SHORT)

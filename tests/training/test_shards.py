from __future__ import annotations

import threading
from functools import partial

import pytest
import torch

from ppt_rl.training.shards import Shards


@pytest.mark.parametrize(("rows", "count"), [(1, 1), (10, 1), (1500, 1), (1600, 2), (10_000, 10)])
def test_there_is_a_part_for_a_thousand_rows_and_one_part_on_a_device(rows, count):
    assert Shards.count(rows, torch.device("cpu")) == count
    assert Shards.count(rows, torch.device("meta")) == 1


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
@pytest.mark.parametrize("count", [1, 2, 7])
def test_results_are_in_the_order_of_the_tasks(threads, count):
    assert Shards(threads).run([partial(int, number) for number in range(count)]) == list(range(count))


def test_tasks_run_at_the_same_time_with_one_thread_of_torch_each():
    shards, together = Shards(3), threading.Barrier(3, timeout=30)

    def work():
        together.wait()
        return torch.get_num_threads()

    with shards.alone():
        assert shards.run([work] * 3) == [1, 1, 1]


def test_what_fails_in_a_task_is_raised():
    def fail():
        raise ArithmeticError("in the second task")

    with pytest.raises(ArithmeticError, match="in the second task"):
        Shards(2).run([int, fail])

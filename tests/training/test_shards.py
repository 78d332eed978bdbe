from __future__ import annotations

import threading

import pytest
import torch

from ppt_rl.training.shards import Shards


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
@pytest.mark.parametrize(("rows", "count"), [(10, 1), (1500, 1), (1600, 2), (10_000, 10)])
def test_every_row_is_in_one_part_and_the_number_of_threads_changes_no_part(threads, rows, count):
    parts = Shards(threads)(lambda part: part, torch.arange(rows))
    assert len(parts) == count
    assert torch.equal(torch.cat(parts), torch.arange(rows))


def test_parts_run_at_the_same_time_with_one_thread_of_torch_each():
    shards, together = Shards(3), threading.Barrier(3, timeout=30)

    def work(part):
        together.wait()
        return torch.get_num_threads()

    with shards.alone():
        assert shards(work, torch.arange(3072)) == [1, 1, 1]


def test_what_fails_in_a_part_is_raised():
    def fail(part):
        if part[0] > 0:
            raise ArithmeticError("in the second part")

    with pytest.raises(ArithmeticError, match="in the second part"):
        Shards(2)(fail, torch.arange(2048))


def test_rows_on_a_device_stay_together():
    assert len(Shards(4)(lambda part: part, torch.empty(10_000, device="meta"))) == 1

import numpy as np
import pytest
import torch

from ppt_rl.envs.episodes import Episodes


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_replacing_rows_writes_them_in_the_tensors_precision_and_leaves_the_old_tensor_and_other_rows(
    dtype: torch.dtype,
) -> None:
    episodes = Episodes(3, dtype)
    episodes.speed, episodes.over = episodes.zeros(2), torch.tensor([True, True, True])
    observed, old = episodes.speed, episodes.speed.clone()
    episodes.replace(torch.tensor([2, 0]), speed=np.asarray([[0.1, 0.2], [0.3, 0.4]]), over=False)
    assert torch.equal(episodes.speed, torch.tensor([[0.3, 0.4], [0.0, 0.0], [0.1, 0.2]], dtype=dtype))
    assert episodes.over.tolist() == [False, True, False]
    assert torch.equal(observed, old)


def test_zeros_are_one_block_per_environment() -> None:
    assert torch.equal(Episodes(4, torch.float64).zeros(3, 2), torch.zeros(4, 3, 2, dtype=torch.float64))

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs.rewards import REWARD_GROUPS, reward_spec, total_reward, work_penalty, zero_rewards
from ppt_rl.envs.specs import SpecMaker

F64 = torch.float64


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64).unsqueeze(-1)


def test_the_total_is_the_sum_of_all_groups_whatever_their_number() -> None:
    terms = {"progress": column(0.5, -1.0), "contact": column(-0.25, 0.0), "power": column(0.0, -0.125)}
    assert_close(total_reward(terms), column(0.25, -1.125), rtol=0, atol=0)
    assert_close(total_reward({"only": column(3.0)}), column(3.0), rtol=0, atol=0)


def test_the_total_leaves_the_groups_as_they_are() -> None:
    terms = {"progress": column(0.5), "contact": column(-0.25)}
    total_reward(terms).add_(1.0)
    assert terms["progress"] == 0.5
    assert terms["contact"] == -0.25


@pytest.mark.parametrize("names", [REWARD_GROUPS, ("path", "force")])
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_the_rewards_of_a_reset_fit_the_spec_and_are_zero(names: tuple[str, ...], dtype: torch.dtype) -> None:
    spec = reward_spec(SpecMaker(torch.Size([3]), dtype, torch.device("cpu")), names)
    terms = zero_rewards(3, dtype, names)
    assert set(spec.keys()) == set(terms) == set(names)
    for name, value in terms.items():
        assert spec[name].is_in(value), name
        assert (value == 0).all(), name


def test_work_costs_the_same_in_and_out_of_the_robot() -> None:
    wrench = torch.tensor([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3]], dtype=F64)
    twist = torch.tensor([[0.1, 0.0, 0.2, 1.0, 0.5, 0.0]], dtype=F64)
    power = 0.1 + 0.6 + 0.1 + 0.1  # [W]
    for sign in (1.0, -1.0):
        got = work_penalty(3.0, wrench=sign * wrench, twist=twist, dt=0.01)
        assert_close(got, column(-3.0 * power * 0.01), rtol=0, atol=1e-15)


def test_a_force_across_the_motion_costs_no_power() -> None:
    wrench = torch.tensor([[5.0, 0.0, 0.0, 0.0, 0.0, 0.0]], dtype=F64)
    twist = torch.tensor([[0.0, 0.3, 0.0, 0.0, 0.0, 1.0]], dtype=F64)
    assert work_penalty(3.0, wrench=wrench, twist=twist, dt=0.01) == 0


def test_the_penalty_on_work_does_not_depend_on_how_finely_time_is_divided() -> None:
    wrench, twist = torch.ones(1, 6, dtype=F64), torch.ones(1, 6, dtype=F64)
    coarse, fine = (work_penalty(1.0, wrench=wrench, twist=twist, dt=dt) for dt in (0.02, 0.01))
    assert_close(coarse, 2 * fine)

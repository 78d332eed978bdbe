import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from ppt_rl.functional.limits import EffortBounds, scale_change, scale_into

LAWS = settings(max_examples=200, deadline=None, derandomize=True)
NUMBERS = st.floats(-(2.0**100), 2.0**100, width=32)
LOW, HIGH = torch.tensor([-87.0, -12.0, -1.0, 0.0]), torch.tensor([87.0, 12.0, 0.0, 5.0])
BOX = EffortBounds.of(LOW, HIGH)


@LAWS
@given(effort=st.lists(NUMBERS, min_size=4, max_size=4))
def test_a_scaled_effort_is_within_its_bounds_and_along_the_effort(effort):
    tau = torch.tensor(effort)
    scaled, factor = scale_into(tau, BOX)
    assert ((scaled >= LOW) & (scaled <= HIGH)).all()
    factor = torch.ones(1) if factor is None else factor
    assert 0.0 <= factor <= 1.0
    torch.testing.assert_close(scaled, factor * tau, rtol=1e-6, atol=1e-30)


def test_an_effort_within_its_bounds_stays_as_it_is_to_the_last_digit():
    generator = torch.Generator().manual_seed(0)
    tau = torch.rand(100, 4, generator=generator) * (HIGH - LOW) + LOW
    assert torch.equal(scale_into(0.999 * tau, BOX)[0], 0.999 * tau)


def test_the_largest_share_of_a_bound_decides():
    tau = torch.tensor([[174.0, 6.0, -0.5, 1.0], [10.0, -36.0, -0.3, 0.0]])
    torch.testing.assert_close(scale_into(tau, BOX)[1], torch.tensor([[0.5], [1 / 3]]))


def test_a_torque_without_power_gets_none_from_its_limits_though_clipping_would_give_it_some():
    generator = torch.Generator().manual_seed(1)
    limit = torch.tensor([87.0] * 4 + [12.0] * 3)
    velocity = torch.randn(1000, 7, generator=generator, dtype=torch.float64)
    torque = 1e4 * torch.randn(1000, 7, generator=generator, dtype=torch.float64)
    torque -= velocity * (torque * velocity).sum(-1, keepdim=True) / velocity.square().sum(-1, keepdim=True)
    assert ((torque.clamp(-limit, limit) * velocity).sum(-1).abs() > 2.0).double().mean() > 0.8
    scaled, _ = scale_into(torque, EffortBounds.of(-limit.double(), limit.double()))
    assert (scaled * velocity).sum(-1).abs().max() < 1e-9


@LAWS
@given(
    effort=st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    last=st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
)
def test_a_change_is_limited_and_keeps_its_direction(effort, last):
    tau, before = torch.tensor(effort, dtype=torch.float64), torch.tensor(last, dtype=torch.float64)
    after = scale_change(tau, before, 10.0)
    change = after - before
    assert change.abs().max() <= 10.0 * (1 + 1e-9)
    share = (change.norm() / (tau - before).norm().clamp_min(1e-300)).clamp_max(1.0)
    torch.testing.assert_close(change, share * (tau - before), rtol=1e-6, atol=1e-9)

from __future__ import annotations

import pytest
import torch

from ppt_rl.functional import PIDGains, begin_multiplier, pid_multiplier
from ppt_rl.modules import PIDMultiplier
from ppt_rl.training.finite import first_not_finite

GAINS = PIDGains(proportional=0.7, integral=0.2, derivative=0.4, smoothing=0.3)
COSTS = torch.tensor([3.0, 1.5, 0.2, 2.6, 2.7, 0.9])


def test_the_module_applies_the_law():
    multiplier, state = PIDMultiplier(1.2, GAINS, initial=0.5), begin_multiplier(torch.tensor(0.5).double())
    for cost in COSTS:
        state = pid_multiplier(state, cost.double(), 1.2, GAINS)
        assert torch.equal(multiplier.update(cost), state.multiplier)
        assert torch.equal(multiplier(), state.multiplier)


@pytest.mark.parametrize("before", range(len(COSTS)))
def test_a_state_dict_holds_all_that_the_controller_remembers(before):
    whole, first, second = (PIDMultiplier(1.2, GAINS, initial=start) for start in (0.5, 0.5, 0.0))
    for cost in COSTS:
        whole.update(cost)
    for cost in COSTS[:before]:
        first.update(cost)
    second.load_state_dict(first.state_dict())
    for cost in COSTS[before:]:
        second.update(cost)
    assert {name: float(value) for name, value in second.state_dict().items()} == {
        name: float(value) for name, value in whole.state_dict().items()
    }


def test_no_optimizer_moves_it_and_no_gradient_reaches_it():
    multiplier = PIDMultiplier(1.0)
    assert not list(multiplier.parameters())
    assert not multiplier.update(torch.tensor(3.0, requires_grad=True)).requires_grad


def test_a_controller_before_its_first_update_counts_as_finite():
    assert first_not_finite({"multiplier": PIDMultiplier(1.0)}) is None

from __future__ import annotations

import math

import pytest
import torch
from torch import nn

from ppt_rl.training.finite import TrainingDiverged, first_not_finite, require_finite_update, size_of


def network():
    return nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))


def test_a_fresh_network_and_its_optimizer_are_finite():
    net = network()
    optimizer = torch.optim.Adam(net.parameters())
    net(torch.randn(4, 2)).sum().backward()
    optimizer.step()
    assert first_not_finite({"net": net, "optimizer": optimizer, "counters": {"steps": 3, "seconds": 0.5}}) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_parameter_that_is_not_finite_is_named(bad):
    net = network()
    net[0].weight.data[1, 1] = bad
    assert first_not_finite({"net": net}) == "net.0.weight"


def test_a_buffer_may_be_infinite_but_not_nan():
    net = network()
    net[1].running_var[0] = math.inf
    assert first_not_finite({"net": net}) is None
    net[1].running_var[1] = math.nan
    assert first_not_finite({"net": net}) == "net.1.running_var"


def test_the_state_of_an_optimizer_that_is_not_finite_is_named():
    net = nn.Linear(1, 1, bias=False)
    optimizer = torch.optim.Adam(net.parameters())
    net(torch.ones(1, 1)).sum().backward()
    optimizer.step()
    optimizer.state[net.weight]["exp_avg_sq"].fill_(math.inf)
    assert first_not_finite({"net": net, "optimizer": optimizer}) == "optimizer.state.0.exp_avg_sq"


def test_a_number_beside_the_networks_counts_too():
    assert first_not_finite({"schedule": {"rates": [1e-3, math.nan]}}) == "schedule.rates.1"


def test_the_first_loss_that_is_not_finite_is_named_with_its_value():
    losses = {"objective": torch.tensor(1.0), "critic": torch.tensor(math.nan), "gradient": torch.tensor(math.inf)}
    with pytest.raises(TrainingDiverged, match=r"^critic is nan$"):
        require_finite_update(**losses)
    require_finite_update(objective=torch.tensor(1e38), gradient=torch.tensor(3e38))


def test_the_size_of_a_state_is_that_of_its_tensors():
    assert size_of({"net": nn.Linear(2, 3), "counters": {"steps": 1}}) == 4 * 9

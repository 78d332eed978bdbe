from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import ClipPPOLoss

from ppt_rl.functional import PIDGains
from ppt_rl.functional.lagrangian import penalised
from ppt_rl.modules import PIDMultiplier, make_actor, make_critic
from ppt_rl.training import LagrangianPPOLoss
from ppt_rl.training.objective import Objective, ValueLoss, gaussian_divergence, standardised, summed
from tests.sampling import normal

COST = ("loss_cost_critic", "cost_value", "cost_value_target")


def parts():
    torch.manual_seed(0)
    actor, critic = make_actor(["observation"], 3, 2, initial_scale=0.5), make_critic(["observation"], 3)
    return actor, critic, make_critic(["observation"], 3, out_key="cost_value")


def sample(actor, count=64):
    """Rows of a policy that is far enough from the present one for the clip to matter."""
    torch.manual_seed(1)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        rows = actor(TensorDict({"observation": torch.randn(count, 3)}, [count]))
    rows["action_log_prob"] += 0.4 * torch.randn(count)
    for key in ("advantage", "value_target", "cost_advantage", "cost_value_target"):
        rows[key] = 2 * torch.randn(count, 1)
    return rows


@pytest.mark.parametrize("entropy", [0.0, 0.1])
@pytest.mark.parametrize("clip", [0.05, 0.2, 2.0])
def test_losses_and_gradients_are_those_of_torchrl(clip, entropy):
    actor, critic, _ = parts()
    rows = sample(actor)
    if clip < 1:
        torchrls = ClipPPOLoss(
            actor, critic, clip_epsilon=clip, entropy_bonus=entropy > 0, entropy_coeff=entropy, critic_coeff=1.0,
            normalize_advantage=True, loss_critic_type="smooth_l1",
        )  # fmt: skip
        expected = {name: loss for name, loss in torchrls(rows).items() if name.startswith("loss_")}
        wanted = torch.autograd.grad(sum(expected.values()), list(torchrls.parameters()))
    objective = Objective(actor, [ValueLoss("loss_critic", critic)], clip=clip, entropy=entropy)
    losses, found = objective.gradients(rows.set("advantage", standardised(rows["advantage"])))
    assert all(gradient.isfinite().all() for gradient in found)
    if clip < 1:
        assert losses.keys() == expected.keys()
        for name, loss in losses.items():
            assert_close(loss, expected[name].detach(), rtol=1e-5, atol=1e-6)
        for one, other in zip(found, wanted, strict=True):
            assert_close(one, other, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("multiplier", [0.0, 2.0])
def test_with_a_cost_critic_they_are_those_of_the_constrained_loss(multiplier):
    actor, critic, cost_critic = parts()
    rows = sample(actor)
    weight = PIDMultiplier(1.0, PIDGains(proportional=0.0, integral=0.0), initial=multiplier)
    settings = {"entropy_bonus": False, "normalize_advantage": True, "critic_coeff": 1.0}
    constrained = LagrangianPPOLoss(actor, critic, cost_critic, weight, **settings)
    expected = constrained(rows)
    values = [ValueLoss("loss_critic", critic), ValueLoss(COST[0], cost_critic, *COST[1:])]
    objective = Objective(actor, values, clip=0.2, entropy=0.0)
    whole = penalised(rows["advantage"], rows["cost_advantage"], weight())
    losses, found = objective.gradients(rows.clone(False).set("advantage", standardised(whole)))
    for name in ("loss_objective", "loss_critic", "loss_cost_critic"):
        assert_close(losses[name], expected[name].detach(), rtol=1e-5, atol=1e-6)
    total = sum(loss for name, loss in expected.items() if name.startswith("loss_"))
    for one, other in zip(found, torch.autograd.grad(total, objective.parameters), strict=True):
        assert_close(one, other, rtol=1e-4, atol=1e-6)


def test_parts_of_the_rows_add_up_to_all_of_them():
    actor, critic, _ = parts()
    rows = sample(actor, 65)
    objective = Objective(actor, [ValueLoss("loss_critic", critic)], clip=0.2, entropy=0.1)
    losses, whole = objective.gradients(rows)
    pieces = [objective.gradients(part, len(part) / 65) for part in rows.split([20, 45])]
    together = summed([part for part, _ in pieces])
    for name, loss in losses.items():
        assert_close(together[name], loss)
    for one, *others in zip(whole, *(part for _, part in pieces), strict=True):
        assert_close(sum(others), one)


def test_a_frozen_parameter_gets_no_gradient_and_the_others_theirs():
    actor, critic, _ = parts()
    rows = sample(actor)
    objective = Objective(actor, [ValueLoss("loss_critic", critic)], clip=0.2, entropy=0.0)
    _, before = objective.gradients(rows)
    objective.parameters[0].requires_grad_(False)
    _, after = objective.gradients(rows)
    assert after[0] is None
    for one, other in zip(before[1:], after[1:], strict=True):
        assert_close(one, other)


def test_a_single_advantage_is_left_alone_and_equal_ones_become_zero():
    assert standardised(torch.tensor([[3.0]])).item() == 3.0
    assert not standardised(torch.full((5, 1), 2.0)).any()


def test_the_divergence_is_that_of_torch():
    old, new = (
        (normal(5, 3), normal(5, 3, seed=1).abs() + 0.1),
        (normal(5, 3, seed=2), normal(5, 3, seed=3).abs() + 0.1),
    )
    expected = torch.distributions.kl_divergence(torch.distributions.Normal(*old), torch.distributions.Normal(*new))
    assert_close(gaussian_divergence(old, new), expected.sum(-1))
    assert not gaussian_divergence(old, old).any()

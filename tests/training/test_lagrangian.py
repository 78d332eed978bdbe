from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.checkpoint import GlobalRNGState
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import ExcludeTransform
from torchrl.envs.utils import ExplorationType, check_env_specs, set_exploration_type
from torchrl.objectives import ClipPPOLoss

from ppt_rl.functional import PIDGains
from ppt_rl.modules import PIDMultiplier, make_actor, make_critic
from ppt_rl.training import LagrangianPPOLoss, TrainingDiverged
from ppt_rl.training.checkpoint import load_checkpoint, save_checkpoint
from ppt_rl.training.lagrangian import EpisodeCosts, cost_of, require_cost
from tests.training.costly import CostlyEnv, batches, collect, make_learner

STILL = PIDGains(proportional=0.0, integral=0.0)
BRISK = PIDGains(proportional=1.0, integral=0.1)
either_critic = pytest.mark.parametrize("cost_critic", [True, False], ids=["two_critics", "one_critic"])


def parts():
    torch.manual_seed(0)
    actor, critic = make_actor(["observation"], 3, 2, initial_scale=0.5), make_critic(["observation"], 3)
    return actor, critic, make_critic(["observation"], 3, out_key="cost_value")


def losses(multiplier, **changes):
    """PPO's loss and the constrained one, each with networks of its own that are equal."""
    settings = {"entropy_bonus": False, "normalize_advantage": True, "critic_coeff": 1.0, **changes}
    ours, theirs = parts(), parts()
    plain = ClipPPOLoss(*ours[:2], **settings)
    return plain, LagrangianPPOLoss(*theirs, PIDMultiplier(1.0, STILL, initial=multiplier), **settings)


def sample(actor, count=64):
    """A flat batch from a policy that is not quite the present one."""
    torch.manual_seed(1)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        batch = actor(TensorDict({"observation": torch.randn(count, 3)}, [count]))
    batch["action_log_prob"] += 0.1 * torch.randn(count)
    for key in ("advantage", "value_target", "cost_advantage", "cost_value_target"):
        batch[key] = torch.randn(count, 1)
    return batch


def gradients(loss, batch, *names):
    """Gradients of the sum of some losses, by the order of the parameters."""
    found = loss(batch)
    wanted = [value for name, value in loss.named_parameters() if not name.startswith("cost_critic")]
    return torch.autograd.grad(sum(found[name] for name in names), wanted, allow_unused=True)


# -- the loss ----------------------------------------------------------------------------------------------------------


def test_at_a_multiplier_of_zero_losses_and_gradients_are_those_of_ppo_to_the_bit():
    plain, constrained = losses(0.0)
    batch = sample(plain.actor_network)
    for name in ("loss_objective", "loss_critic"):
        assert torch.equal(plain(batch)[name], constrained(batch)[name])
        for one, other in zip(*(gradients(loss, batch, name) for loss in (plain, constrained)), strict=True):
            assert (one is None) == (other is None)
            assert one is None or torch.equal(one, other)


@pytest.mark.parametrize("multiplier", [0.5, 3.0])
def test_the_gradient_is_that_of_ppo_on_the_reward_less_the_weighted_cost(multiplier):
    plain, constrained = losses(multiplier, normalize_advantage=False)
    batch = sample(plain.actor_network)
    penalised = batch.clone()
    penalised["advantage"] = (batch["advantage"] - multiplier * batch["cost_advantage"]) / (1 + multiplier)
    found, expected = gradients(constrained, batch, "loss_objective"), gradients(plain, penalised, "loss_objective")
    pairs = [(a, b) for a, b in zip(found, expected, strict=True) if a is not None]
    assert pairs
    for a, b in pairs:
        assert_close(a, b)


def test_a_step_along_the_gradient_makes_costly_actions_less_likely():
    actor, *critics = parts()
    loss = LagrangianPPOLoss(actor, *critics, PIDMultiplier(1.0, STILL, initial=5.0), entropy_bonus=False)
    batch = sample(actor)
    batch["advantage"].zero_()
    batch["cost_advantage"] = batch["action"][:, :1]  # the first action costs what it is
    before = actor(batch.clone())["loc"].mean(0)
    loss(batch)["loss_objective"].backward()
    torch.optim.SGD(loss.parameters(), lr=0.1).step()
    assert float((actor(batch.clone())["loc"].mean(0) - before)[0].detach()) < -1e-3


def test_the_cost_critic_learns_the_cost_alone():
    _, loss = losses(2.0)
    batch = sample(parts()[0])
    found = loss(batch)
    found["loss_cost_critic"].backward()
    with_gradient = {name.split(".")[0] for name, value in loss.named_parameters() if value.grad is not None}
    assert with_gradient == {"cost_critic_network_params"}
    value = parts()[2](batch.clone())["cost_value"]
    assert_close(found["loss_cost_critic"], torch.nn.functional.smooth_l1_loss(value, batch["cost_value_target"]))


def test_the_keys_of_the_loss_are_declared():
    _, loss = losses(1.0)
    assert {"cost_advantage", "cost_value_target", "observation"} <= set(loss.in_keys)
    assert set(loss(sample(parts()[0])).keys()) >= {key for key in loss.out_keys if key.startswith("loss")}


def test_a_batch_without_the_advantage_of_the_cost_is_refused_by_name():
    _, loss = losses(1.0)
    with pytest.raises(KeyError, match=r"lacks \['cost_advantage'\]; expected .*Apply a GAE to each"):
        loss(sample(parts()[0]).exclude("cost_advantage"))


# -- the costs of episodes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cuts", [[12], [1] * 12, [5, 4, 3], [2, 10]])
def test_the_costs_of_episodes_are_summed_over_the_ends_of_batches(cuts):
    torch.manual_seed(3)
    cost, done = torch.rand(4, 12, 1), torch.rand(4, 12, 1) < 0.3
    expected = []
    for row in range(4):
        begin = 0
        for end in done[row, :, 0].nonzero().flatten().tolist():
            expected.append(float(cost[row, begin : end + 1].sum()))
            begin = end + 1
    episodes = EpisodeCosts()
    found = [episodes(c, d) for c, d in zip(cost.split(cuts, 1), done.split(cuts, 1), strict=True)]
    assert sorted(torch.cat(found).tolist()) == pytest.approx(sorted(expected))


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_any_batch_of_environments_has_episodes(shape):
    cost, done = torch.ones(*shape, 5, 1), torch.zeros(*shape, 5, 1, dtype=torch.bool)
    done[..., 3, :] = True
    count = math.prod(shape)
    assert EpisodeCosts()(cost, done).tolist() == [4.0] * count


# -- learning ----------------------------------------------------------------------------------------------------------


def test_the_small_environment_keeps_its_specs():
    check_env_specs(CostlyEnv(3))


@either_critic
def test_at_a_multiplier_of_zero_networks_learn_what_ppo_lets_them_learn_to_the_bit(cost_critic):
    plain, constrained = make_learner(None), make_learner(1.0, STILL, cost_critic=cost_critic)
    for batch in batches(plain, 3):
        for learner in (plain, constrained):
            torch.manual_seed(5)
            learner.update(batch.clone())
    for name in ("actor", "critic"):
        pairs = zip(plain.networks[name].parameters(), constrained.networks[name].parameters(), strict=True)
        assert all(torch.equal(one, other) for one, other in pairs), name


@pytest.mark.parametrize(
    ("cost_critic", "steps", "gains", "within"),
    [(True, 2, BRISK, (1.35, 1.65)), (False, 3, BRISK, (1.35, 1.65)), (True, 2, STILL, (3.0, 1e9))],
    ids=["two_critics_on_whole_episodes", "one_critic_on_parts_of_episodes", "no_gains"],
)
def test_the_cost_comes_to_its_limit_in_any_environment_with_a_cost(cost_critic, steps, gains, within):
    learner = make_learner(1.5, gains, cost_critic=cost_critic, learning_rate=2e-3, epochs=2, target_kl=0.1)
    costs = [learner.update(batch)["cost"] for batch, _ in zip(collect(learner, steps=steps), range(40), strict=False)]
    assert costs[0] < 0.5  # the untrained policy hardly acts
    assert within[0] < sum(costs[-15:]) / 15 < within[1]


def test_an_update_tells_cost_limit_and_multiplier():
    learner = make_learner(0.1, BRISK)
    (batch,) = batches(learner, 1)
    told = learner.update(batch)
    cost = float(batch["next", "cost"].sum(1).mean())
    assert told["cost"] == pytest.approx(cost)
    assert (told["cost_limit"], told["multiplier"]) == (0.1, pytest.approx(1.1 * (cost - 0.1)))
    assert math.isfinite(told["loss_cost_critic"])


def test_a_batch_in_which_no_episode_ends_leaves_the_multiplier_alone():
    learner = make_learner(0.1, BRISK)
    told = learner.update(batches(learner, 1, steps=2, length=5)[0])
    assert "cost" not in told
    assert told["multiplier"] == 0.0


@either_critic
def test_a_run_that_goes_on_from_a_checkpoint_learns_what_the_uninterrupted_one_does(cost_critic, tmp_path):
    whole = make_learner(0.1, BRISK, cost_critic=cost_critic)
    *first, last = batches(whole, 4)
    for batch in first:
        whole.update(batch.clone())
    components = {**whole.components, "rng": GlobalRNGState()}
    path = save_checkpoint(tmp_path, components, step=1, metadata={"variant": "x", "config": {}, "success": 0.0})
    expected = whole.update(last.clone())
    again = make_learner(0.1, BRISK, cost_critic=cost_critic)
    load_checkpoint(path, {**again.components, "rng": GlobalRNGState()})
    assert again.update(last.clone()) == expected
    for name, network in whole.networks.items():
        pairs = zip(network.parameters(), again.networks[name].parameters(), strict=True)
        assert all(torch.equal(one, other) for one, other in pairs), name


def test_the_batch_of_the_collector_stays_as_it_was():
    learner = make_learner(0.1, BRISK, cost_critic=False)
    (batch,) = batches(learner, 1)
    reward = batch["next", "reward"].clone()
    learner.update(batch)
    assert torch.equal(batch["next", "reward"], reward)


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_an_environment_without_a_cost_is_refused_by_name_before_the_first_step():
    env = TransformedEnv(CostlyEnv(2), ExcludeTransform("cost"))
    with pytest.raises(KeyError, match=r"no cost 'cost', only .*step.*Append a transform .*PowerLimitTransform"):
        require_cost(env, "cost")
    require_cost(CostlyEnv(2), "cost")


def test_a_batch_without_a_cost_is_refused_by_name():
    learner = make_learner(1.0)
    (batch,) = batches(learner, 1)
    with pytest.raises(KeyError, match=r"no cost 'cost', only .*reward"):
        learner.update(batch.exclude(("next", "cost")))


def test_a_cost_of_another_shape_is_refused():
    learner = make_learner(1.0)
    (batch,) = batches(learner, 1)
    batch["next", "cost"] = torch.zeros(64, 2, 3)
    with pytest.raises(ValueError, match=r"'cost' has shape \(64, 2, 3\); expected \(64, 2, 1\), one number a step"):
        cost_of(batch, "cost")


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_cost_that_is_not_finite_ends_the_training_before_the_multiplier_moves(bad):
    learner = make_learner(1.0)
    (batch,) = batches(learner, 1)
    batch["next", "cost"][3] = bad
    with pytest.raises(TrainingDiverged, match=r"cost is (nan|inf)"):
        learner.update(batch)
    assert float(learner.constraint.multiplier()) == 0.0

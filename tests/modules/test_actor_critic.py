import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.modules.actor_critic import HIDDEN, InputNorm, Mirror, make_actor, make_critic, update_input_norm

KEYS = ("pose", "twist")


def observations(*batch: int, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    pose = 3 + 2 * torch.randn(*batch, 7, generator=generator)
    twist = 0.1 * torch.randn(*batch, 6, generator=generator) - 1
    return TensorDict({"pose": pose, "twist": twist}, batch)


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_the_actor_writes_an_action_and_its_log_probability(batch):
    torch.manual_seed(0)
    actor = make_actor(KEYS, 13, 4)
    out = actor(observations(*batch))
    assert out["action"].shape == (*batch, 4)
    assert out["action_log_prob"].shape == batch
    assert_close(out["action_log_prob"], actor.get_dist(out).log_prob(out["action"]))


def test_the_log_probability_is_that_of_independent_normals():
    torch.manual_seed(0)
    out = make_actor(KEYS, 13, 4, initial_scale=0.3)(observations(5))
    normals = torch.distributions.Normal(out["loc"], out["scale"])
    assert_close(out["action_log_prob"], normals.log_prob(out["action"]).sum(-1))


def test_the_action_is_written_to_the_given_key():
    out = make_actor(KEYS, 13, 4, action_key="weights")(observations(5))
    assert out["weights"].shape == (5, 4)
    assert "action" not in out


@pytest.mark.parametrize("scale", [0.05, 0.3, 1.0])
def test_initially_the_mean_is_near_zero_and_the_scale_is_the_given_one(scale):
    torch.manual_seed(0)
    data = observations(1000)
    actor = make_actor(KEYS, 13, 4, initial_scale=scale)
    update_input_norm(actor, data)
    out = actor(data)
    assert out["loc"].abs().max().item() < 0.05
    assert_close(out["scale"], torch.full((1000, 4), scale), rtol=1e-3, atol=0.0)


def test_the_deterministic_action_is_the_mean():
    actor, data = make_actor(KEYS, 13, 4), observations(5)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        out = actor(data)
    assert torch.equal(out["action"], out["loc"])


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_the_critic_writes_one_value_per_row(batch):
    assert make_critic(KEYS, 13)(observations(*batch))["state_value"].shape == (*batch, 1)


def test_the_hidden_layers_are_the_papers_with_relu():
    assert HIDDEN == (256, 256, 128)
    for module in (make_actor(KEYS, 13, 4), make_critic(KEYS, 13)):
        layers = [m for m in module.modules() if isinstance(m, torch.nn.Linear)]
        assert [layer.out_features for layer in layers[:-1]] == [256, 256, 128]
        assert sum(isinstance(m, torch.nn.ReLU) for m in module.modules()) == 3


def test_every_parameter_of_actor_and_critic_gets_a_gradient():
    torch.manual_seed(0)
    actor, critic, data = make_actor(KEYS, 13, 4), make_critic(KEYS, 13), observations(5)
    actor.get_dist(data).log_prob(torch.ones(5, 4)).sum().backward()
    critic(data)["state_value"].sum().backward()
    for parameter in (*actor.parameters(), *critic.parameters()):
        assert parameter.grad is not None
        assert bool((parameter.grad != 0).any())


def test_input_norm_standardises_the_data_it_has_seen():
    data = observations(5000)
    norm = InputNorm(13, limit=100.0)
    norm.update(data["pose"], data["twist"])
    x = norm(data["pose"], data["twist"])
    assert_close(x.mean(0), torch.zeros(13), rtol=0.0, atol=1e-4)
    assert_close(x.std(0, correction=0), torch.ones(13), rtol=0.0, atol=1e-4)


def test_input_norm_is_the_identity_before_it_has_seen_data():
    x = torch.linspace(-4, 4, 13)
    assert torch.equal(InputNorm(13)(x), x)


def test_input_norm_clips_to_its_limit():
    assert torch.equal(InputNorm(3, limit=2.0)(torch.tensor([-9.0, 0.5, 9.0])), torch.tensor([-2.0, 0.5, 2.0]))


def test_a_constant_feature_becomes_zero_even_if_it_changes_later():
    data = torch.randn(100, 2, generator=torch.Generator().manual_seed(0))
    data[:, 1] = 7.0
    norm = InputNorm(2)
    norm.update(data)
    assert bool((norm(torch.tensor([[0.0, 7.0], [0.0, 1e6]]))[:, 1] == 0).all())


@pytest.mark.parametrize("sizes", [(1, 999), (300, 700), (10, 20, 970)])
def test_statistics_updated_in_parts_equal_those_of_all_the_data(sizes):
    data = 3.0 + 2.0 * torch.randn(1000, 4, generator=torch.Generator().manual_seed(0))
    parts, whole = InputNorm(4), InputNorm(4)
    for part in data.split(sizes):
        parts.update(part)
    whole.update(data)
    assert_close(dict(parts.named_buffers()), dict(whole.named_buffers()), rtol=1e-5, atol=1e-5)
    assert_close(parts.loc, data.mean(0))
    assert_close(parts.scale, data.std(0, correction=0))


def test_update_flattens_every_batch_dimension():
    data = observations(20, 30)
    flat, nested = InputNorm(13), InputNorm(13)
    nested.update(data["pose"], data["twist"])
    flat.update(data["pose"].reshape(600, 7), data["twist"].reshape(600, 6))
    assert_close(dict(nested.named_buffers()), dict(flat.named_buffers()))


@pytest.mark.parametrize("module", [make_actor(KEYS, 13, 4), make_critic(KEYS, 13)], ids=["actor", "critic"])
def test_update_input_norm_sets_the_statistics_in_the_state_dict(module):
    data = observations(500)
    update_input_norm(module, data)
    x = torch.cat([data["pose"], data["twist"]], -1)
    state = module.state_dict()
    (loc,) = (value for key, value in state.items() if key.endswith("norm.loc"))
    (scale,) = (value for key, value in state.items() if key.endswith("norm.scale"))
    assert_close(loc, x.mean(0))
    assert_close(scale, x.std(0, correction=0))


def test_inputs_are_read_in_the_order_of_the_keys():
    torch.manual_seed(0)
    critic, data = make_critic(KEYS, 13), observations(5)
    swapped = make_critic(KEYS[::-1], 13)
    swapped.load_state_dict(critic.state_dict())
    first = next(m for m in swapped.modules() if isinstance(m, torch.nn.Linear))
    with torch.no_grad():
        first.weight.copy_(torch.cat([first.weight[:, 7:], first.weight[:, :7]], -1))
    assert_close(swapped(data.clone())["state_value"], critic(data.clone())["state_value"])


def test_a_mirrored_actor_takes_the_mirrored_action_for_a_mirrored_observation() -> None:
    inputs, action = torch.tensor([1.0, -1.0, -1.0, 1.0]), torch.tensor([1.0, -1.0, 1.0])
    torch.manual_seed(0)
    actor = make_actor(["o"], 4, 3, mirror=Mirror(inputs.tolist(), action.tolist()))
    free = make_actor(["o"], 4, 3)
    free.load_state_dict(actor.state_dict())
    x = torch.randn(16, 4)
    update_input_norm(actor, TensorDict({"o": x + 0.5}, 16))
    update_input_norm(free, TensorDict({"o": x + 0.5}, 16))

    def mean(who: torch.nn.Module, o: torch.Tensor) -> torch.Tensor:
        return who.get_dist(TensorDict({"o": o}, 16)).mean

    assert_close(mean(actor, inputs * x), action * mean(actor, x))
    assert not torch.allclose(mean(free, inputs * x), action * mean(free, x), atol=1e-4)


@pytest.mark.parametrize("mirror", [Mirror([1.0, -1.0], [1.0] * 3), Mirror([1.0] * 4, [0.5] * 3)])
def test_a_mirror_that_does_not_fit_is_refused(mirror: Mirror) -> None:
    with pytest.raises(ValueError, match=r"mirror has the factors .*; expected \+1 or -1 for each"):
        make_actor(["o"], 4, 3, mirror=mirror)

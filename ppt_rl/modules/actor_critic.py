"""Gaussian actor and value network: three ReLU layers (256, 256, 128) on normalised inputs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch import Tensor, nn
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator

from ppt_rl.functional.argument_checks import require_whole
from ppt_rl.functional.checks import require_positive

__all__ = ["HIDDEN", "InputNorm", "Mirror", "make_actor", "make_critic", "update_input_norm"]

#: Hidden layers of actor and critic (paper, section "Common Experimental Setup").
HIDDEN = (256, 256, 128)
#: Largest number of inputs or actions.
_WIDEST = 100_000


class InputNorm(nn.Module):
    """Concatenate the inputs and standardise them: ``(x - loc) / scale``, clipped to ``+-limit``.

    The statistics are buffers, so checkpoints contain them. They change only in :meth:`update`.

    Args:
        size: total number of input features.
        limit: bound on a standardised feature [-].
        floor: smallest standard deviation; a feature that varies less counts as constant and becomes zero.
    """

    loc: Tensor
    scale: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int, limit: float = 10.0, floor: float = 1e-3) -> None:
        super().__init__()
        self.limit = limit
        self.floor = floor
        self.register_buffer("loc", torch.zeros(size))
        self.register_buffer("scale", torch.ones(size))
        self.register_buffer("variance", torch.zeros(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def update(self, *inputs: Tensor) -> None:
        """Update mean and variance to those of all data seen so far, including these samples.

        Args:
            *inputs: ``(*B, n_i)`` samples of each input.
        """
        data = torch.cat(inputs, -1).flatten(0, -2)
        share = len(data) / (self.count + len(data)).to(data.dtype)  # share of the new data in all data
        difference = data.mean(0) - self.loc
        variance = (1 - share) * self.variance + share * data.var(0, correction=0)
        self.variance.copy_(variance + share * (1 - share) * difference.square())
        self.loc.add_(share * difference)
        self.count.add_(len(data))
        std = self.variance.sqrt()
        self.scale.copy_(torch.where(std < self.floor, torch.full_like(std, torch.inf), std))

    def forward(self, *inputs: Tensor) -> Tensor:
        """Concatenate and standardise.

        Args:
            *inputs: ``(*B, n_i)`` inputs.

        Returns:
            ``(*B, sum n_i)`` standardised features.
        """
        x = torch.cat(inputs, -1)  # a copy, so that what follows may write into it
        return x.sub_(self.loc).div_(self.scale).clamp_(-self.limit, self.limit)


class Mirror(NamedTuple):
    """How a reflection changes inputs and action, for a task that is the same task when reflected.

    Attributes:
        inputs: factor +1 or -1 of each input feature.
        action: factor +1 or -1 of each component of the action.
    """

    inputs: Sequence[float]
    action: Sequence[float]


class _Network(nn.Module):
    """Input normalisation, hidden layers and a head; with a mirror, the hidden layers are made equivariant."""

    mirrored_in: Tensor | None
    mirrored_out: Tensor | None

    def __init__(self, in_size: int, out_size: int, head: nn.Module, mirror: Mirror | None = None) -> None:
        super().__init__()
        self.norm = InputNorm(in_size)
        self.mlp = MLP(
            in_features=in_size, out_features=out_size, num_cells=list(HIDDEN), activation_class=nn.ReLU,
            activation_kwargs={"inplace": True},
        )  # fmt: skip
        self.head = head
        for name, size, signs in zip(("in", "out"), (in_size, out_size), mirror or (None, None), strict=True):
            if signs is not None and (len(signs) != size or any(sign not in (1, -1) for sign in signs)):
                raise ValueError(
                    f"mirror has the factors {list(signs)} for {size} entries; expected +1 or -1 for each."
                )
            factors = None if signs is None else torch.as_tensor(signs, dtype=torch.get_default_dtype())
            self.register_buffer(f"mirrored_{name}", factors, persistent=False)

    def forward(self, *inputs: Tensor) -> Tensor | tuple[Tensor, ...]:
        y = self.mlp(self.norm(*inputs))
        if self.mirrored_in is not None:
            x = torch.cat(inputs, -1)
            y = 0.5 * (y + self.mirrored_out * self.mlp(self.norm(self.mirrored_in * x)))
        return self.head(y)


def _check_keys(in_keys: Sequence[str]) -> None:
    if isinstance(in_keys, str) or not isinstance(in_keys, Sequence) or not in_keys:
        raise ValueError(f"in_keys is {in_keys!r}; expected a list of one or more observations.")


def make_actor(
    in_keys: Sequence[str],
    in_size: int,
    action_size: int,
    *,
    action_key: str = "action",
    initial_scale: float = 1.0,
    mirror: Mirror | None = None,
) -> ProbabilisticActor:
    r"""Gaussian actor with a state-independent scale. Its last layer starts near zero, and so does its mean.

    With a mirror ``(S, T)`` the mean is equivariant, ``\mu(S o) = T \mu(o)``, whatever the network ``f`` learns:

    .. math:: \mu(o) = \tfrac12 \big( f(o) + T f(S o) \big)

    Args:
        in_keys: observations that it reads, concatenated in this order.
        in_size: their total size.
        action_size: size of the action.
        action_key: key that it writes.
        initial_scale: initial standard deviation, in units of the action.
        mirror: reflection under which the task is the same; None for none.

    Returns:
        The actor. Set its input statistics with :func:`update_input_norm`.

    Raises:
        ValueError: if a number is out of range, or the mirror does not fit the sizes.
    """
    _check_keys(in_keys)
    in_size, action_size = (
        require_whole("in_size", in_size, 1, _WIDEST),
        require_whole("action_size", action_size, 1, _WIDEST),
    )
    require_positive("initial_scale", initial_scale)
    head = AddStateIndependentNormalScale(action_size, scale_lb=1e-3, init_value=math.log(initial_scale))
    network = _Network(in_size, action_size, head, mirror)
    with torch.no_grad():
        network.mlp[-1].weight.mul_(0.01)
        network.mlp[-1].bias.zero_()
    module = TensorDictModule(network, in_keys=list(in_keys), out_keys=["loc", "scale"])
    return ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        out_keys=[action_key],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )


def make_critic(in_keys: Sequence[str], in_size: int, *, out_key: str = "state_value") -> ValueOperator:
    """State-value network. It may read privileged observations, since only training uses it.

    Args:
        in_keys: observations that it reads, concatenated in this order.
        in_size: their total size.
        out_key: key that it writes.

    Returns:
        The critic. Set its input statistics with :func:`update_input_norm`.

    Raises:
        ValueError: if there is no observation, or the size is out of range.
    """
    _check_keys(in_keys)
    in_size = require_whole("in_size", in_size, 1, _WIDEST)
    return ValueOperator(_Network(in_size, 1, nn.Identity()), in_keys=list(in_keys), out_keys=[out_key])


def update_input_norm(module: TensorDictModule, data: TensorDictBase) -> None:
    """Update the input statistics of an actor or a critic with new data.

    Args:
        module: an actor from :func:`make_actor` or a critic from :func:`make_critic`.
        data: contains the observations that the module reads, ``(*B, n_i)`` each.

    Raises:
        ValueError: if the module has no input statistics.
        KeyError: if an observation is missing.
    """
    norms = [part for part in module.modules() if isinstance(part, InputNorm)]
    if not norms:
        raise ValueError(
            f"module is a {type(module).__name__} without input statistics; expected one of make_actor or make_critic."
        )
    inner = module[0] if isinstance(module, ProbabilisticActor) else module
    inputs = [data.get(key, None) for key in inner.in_keys]
    missing = [key for key, value in zip(inner.in_keys, inputs, strict=True) if value is None]
    if missing:
        raise KeyError(f"the data lacks {missing}; expected the observations {inner.in_keys} that the module reads.")
    norms[0].update(*inputs)

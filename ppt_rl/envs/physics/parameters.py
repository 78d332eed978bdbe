"""Parameters of a model that differ between environments, by their names in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

__all__ = ["Parameter", "ids_of", "write_model", "write_models"]


class Parameter(NamedTuple):
    """A field of the model, some of its objects, and their values in every environment.

    Attributes:
        field: name of a field of ``mujoco.MjModel``; what stands before the underscore is the kind of its objects:
            ``geom_size``, ``body_mass``, ``pair_friction``, ...
        names: names of the n objects; none stands for all objects of that kind.
        values: ``(num_envs, n, c)``: the first c numbers of each object's entry, or ``(num_envs, n)`` for a field with
            one number for each object.
    """

    field: str
    names: tuple[str, ...]
    values: Tensor


def ids_of(model: Any, parameter: Parameter) -> NDArray[np.int64]:
    """The indices of a parameter's objects.

    Args:
        model: ``mujoco.MjModel``.
        parameter: the parameter.

    Returns:
        ``(n,)`` indices into the field.

    Raises:
        KeyError: if the model has no object of such a name.
    """
    kind = parameter.field.split("_")[0]
    if not parameter.names:
        return np.arange(len(getattr(model, parameter.field)))
    named = getattr(model, kind)
    return np.asarray([named(name).id for name in parameter.names])


def write_model(model: Any, parameters: Sequence[Parameter], row: int) -> None:
    """Write the parameters of one environment into a model.

    Args:
        model: ``mujoco.MjModel``, changed in place.
        parameters: what to write.
        row: index of the environment.
    """
    write_models([model], parameters, [row])


def write_models(models: Sequence[Any], parameters: Sequence[Parameter], rows: Sequence[int]) -> None:
    """Write the parameters of some environments into a model for each; all models have the same objects.

    Args:
        models: ``mujoco.MjModel`` of each, changed in place.
        parameters: what to write.
        rows: index of each environment.
    """
    for parameter in parameters:
        ids = ids_of(models[0], parameter)
        values = parameter.values[list(rows)].cpu().numpy()
        for model, value in zip(models, values, strict=True):
            _write(model, parameter.field, ids, value)


def _write(model: Any, name: str, ids: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    field = getattr(model, name)
    if field.ndim == 1:
        field[ids] = values
    else:
        field[ids, : values.shape[-1]] = values
    if name in ("geom_pos", "geom_quat"):
        model.geom_sameframe[ids] = 0  # the frame of the geom no longer is that of its body

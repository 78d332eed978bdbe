"""What a transform can learn of the environment that it is in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tensordict import TensorDictBase
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv
from torchrl.envs.batched_envs import BatchedEnvBase

__all__ = [
    "attribute",
    "base_of",
    "parent_of",
    "step_inside",
    "transforms_after",
    "transforms_of",
]


def base_of(env: EnvBase) -> EnvBase:
    """The base environment under any number of ``TransformedEnv``.

    Args:
        env: any environment.

    Returns:
        The first environment inside that is no ``TransformedEnv``.
    """
    while isinstance(env, TransformedEnv):
        env = env.base_env
    return env


def attribute(env: EnvBase, name: str) -> Any:
    """An attribute of an environment, None where it has none.

    ``SerialEnv`` and ``ParallelEnv`` are asked for their own attributes only, because a worker of the latter dies when
    it is asked for one that it lacks.

    Args:
        env: a base environment.
        name: of the attribute.

    Returns:
        Its value.
    """
    return env.__dict__.get(name) if isinstance(env, BatchedEnvBase) else getattr(env, name, None)


def transforms_of(env: EnvBase | None) -> Iterator[Transform]:
    """The transforms of an environment, from the base environment outwards.

    Args:
        env: any environment; None has none.

    Yields:
        Each transform, those in a ``Compose`` one by one.
    """
    if isinstance(env, TransformedEnv):
        yield from transforms_of(env.base_env)
        yield from _flat(env.transform)


def parent_of(transform: Transform) -> TransformedEnv | None:
    """The environment that a transform acts on: the base environment with copies of all earlier transforms.

    torchrl makes it on demand, and each of these copies would make another one in turn, so the time that specs take
    would double with every transform. Here a copy shares the parent of its original.

    Args:
        transform: one that is in an environment, or in none.

    Returns:
        Its parent; None where there is no environment.
    """
    parent: TransformedEnv | None = transform.__dict__.get("_parent")
    if parent is None:
        parent = Transform.parent.fget(transform)
        copies = list(transforms_of(parent))
        for original, copy in zip(transforms_of(transform.container) if copies else (), copies, strict=False):
            if copy is not original:
                copy.__dict__["_parent"] = parent_of(original)
    return parent


def transforms_after(transform: Transform) -> Iterator[Transform]:
    """The transforms that come after one in its environment, outwards.

    Args:
        transform: one that is in an environment, or in none.

    Yields:
        Each of them.
    """
    found = False
    for other in transforms_of(transform.container):
        if found:
            yield other
        found = found or other is transform


def step_inside(env: EnvBase, tensordict: TensorDictBase, takes_over: bool = False) -> TensorDictBase:
    """One step of an environment: ``env._step``, but that a ``_step`` mask goes down as it is.

    ``TransformedEnv`` looks at the mask first, to skip a step of nobody and to drop a mask of everybody. On a GPU the
    host would wait for its values. A batch-locked environment takes any mask, so here nobody looks; those that step in
    workers, and those without a lock, are left to torchrl.

    Args:
        env: any environment.
        tensordict: root of the step.
        takes_over: whether the transforms may write into this very tensordict, which nobody reads afterwards.

    Returns:
        What follows, as ``env._step`` returns it.
    """
    if not isinstance(env, TransformedEnv) or type(env)._step is not TransformedEnv._step:
        return env._step(tensordict)
    if not env.batch_locked or isinstance(base_of(env), BatchedEnvBase):
        return env._step(tensordict)
    base, transform = env.base_env, env.transform
    root = transform._inv_call(tensordict if takes_over else tensordict.copy())
    following = step_inside(base, root)
    base._complete_done(base.full_done_spec, following)
    return transform._step(root, following)


def _flat(transform: Transform | None) -> Iterator[Transform]:
    if isinstance(transform, Compose):
        for part in transform.transforms:
            yield from _flat(part)
    elif transform is not None:
        yield transform

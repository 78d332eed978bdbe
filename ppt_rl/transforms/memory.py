"""What the environment's side of a chain remembers from one step to the next."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from tensordict.utils import NestedKey
from torchrl.envs import EnvBase

from ppt_rl.transforms.chain import attribute, base_of

__all__ = ["Memory", "memory_of", "state_is_in_tensordict"]

#: Attribute of a base environment that holds the memories of its transforms, by the transform's token.
_MEMORIES = "_memories_of_transforms"


class Memory(NamedTuple):
    """What the environment's side remembers for one transform.

    Attributes:
        entries: by key, as the transform last wrote or read them. All clones of the transform share them.
        keys: what is kept.
        batch_size: of the environment, and of the entries.
    """

    entries: dict[NestedKey, Any]
    keys: list[NestedKey]
    batch_size: torch.Size


def state_is_in_tensordict(env: EnvBase) -> bool:
    """Whether an environment may be stepped again from any of its tensordicts, because they hold its whole state.

    That is so for environments that are not ``batch_locked`` (torchrl's convention) and for those with an attribute
    ``state_in_tensordict`` that is True. A simulator keeps its state inside: it is one moment further after each step,
    whatever a tensordict says.

    Args:
        env: any environment.

    Returns:
        Whether it is.
    """
    base = base_of(env)
    return not base.batch_locked or bool(attribute(base, "state_in_tensordict"))


def memory_of(env: EnvBase, token: str, keys: list[NestedKey]) -> Memory | None:
    """The memory of one transform, kept on the base environment, where neither a policy nor other transforms reach it.

    Args:
        env: the environment that the transform is in.
        token: names the transform; its clones have the same.
        keys: what is kept.

    Returns:
        The memory; None where the whole state is in the tensordict, which is then the only memory.
    """
    if state_is_in_tensordict(env):
        return None
    entries = base_of(env).__dict__.setdefault(_MEMORIES, {}).setdefault(token, {})
    return Memory(entries, keys, env.batch_size)

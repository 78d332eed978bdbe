"""Published policies: weights without code (safetensors), and a card that describes them."""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor, nn

from ppt_rl.evaluation.columns import COLUMNS
from ppt_rl.evaluation.tables import markdown, mean_and_interval
from ppt_rl.training.advice import in_one_line
from ppt_rl.training.checkpoint import CheckpointMismatch
from ppt_rl.training.logs import write_bytes_atomically, write_text_atomically

__all__ = [
    "card_digest",
    "is_pretrained",
    "load_pretrained",
    "pretrained_card",
    "published_policies",
    "published_table",
    "save_pretrained",
]

_WEIGHTS, _CARD = "policy.safetensors", "card.json"
#: What a card must hold.
_NEEDED = {"variant": str, "config": dict, "sha256": str}


def published_policies() -> dict[str, Path]:
    """Policies that come with the library.

    Returns:
        Their directories by name.
    """
    folder = Path(importlib.import_module("ppt_rl.pretrained").__path__[0])
    return {path.name: path for path in sorted(folder.iterdir()) if is_pretrained(path)}


def published_table() -> str:
    """The published policies with their figures as Markdown, a line for each and group of episodes.

    Returns:
        The table.
    """
    lines = []
    for name, path in published_policies().items():
        card = pretrained_card(path)
        evaluation = card["evaluation"]
        for group, summary in evaluation["summary"][card["variant"]].items():
            figures = [mean_and_interval(summary[metric]) for metric in COLUMNS]
            lines.append([name, group, str(evaluation["episodes"]), *figures])
    units = [f"{metric} [{column.unit}]" for metric, column in COLUMNS.items()]
    return markdown(["policy", "group", "episodes", *units], lines)


def is_pretrained(path: Path) -> bool:
    """Whether a path is a directory with a published policy.

    Args:
        path: any path.

    Returns:
        Whether it holds a card.
    """
    return (path / _CARD).is_file()


def save_pretrained(directory: Path, modules: Mapping[str, nn.Module], card: Mapping[str, Any]) -> None:
    """Write weights and card.

    Args:
        directory: target directory.
        modules: modules to save, by name: the actor, and those that its chain needs.
        card: JSON data with at least ``variant`` and ``config``. The digest of card and weights is added.
    """
    tensors = {f"{name}.{key}": value.contiguous() for name, module in modules.items() for key, value in _state(module)}
    data = save_tensors(tensors)
    write_bytes_atomically(directory / _WEIGHTS, data)
    record = {**card, "weights": _WEIGHTS}
    record["sha256"] = card_digest(record, data)
    write_text_atomically(directory / _CARD, json.dumps(record, indent=2) + "\n")


def _state(module: nn.Module) -> list[tuple[str, Tensor]]:
    return [(key, value.detach().cpu()) for key, value in module.state_dict().items()]


def card_digest(card: Mapping[str, Any], weights: bytes) -> str:
    """Digest of a published policy: of everything that its card says, and of its weights.

    Args:
        card: JSON data; its entry ``sha256`` does not count, nor does the order or the layout of the entries.
        weights: content of the file of weights.

    Returns:
        SHA-256 of the canonical JSON, a zero byte and the weights, in hexadecimal.
    """
    content = {key: value for key, value in card.items() if key != "sha256"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode() + b"\0" + weights).hexdigest()


def pretrained_card(directory: Path) -> dict[str, Any]:
    """The card of a published policy, after it was compared with its digest.

    Args:
        directory: a directory that :func:`save_pretrained` wrote.

    Returns:
        Its content.

    Raises:
        CheckpointMismatch: if it is unreadable or names no variant, or if card or weights were changed.
    """
    return _verified(directory)[0]


def _verified(directory: Path) -> tuple[dict[str, Any], bytes]:
    """Card and weights of a published policy, as its digest knows them."""
    try:
        card = json.loads((directory / _CARD).read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointMismatch(f"{directory / _CARD} cannot be read ({error}); take a fresh copy.") from error
    if not isinstance(card, dict) or not all(isinstance(card.get(name), kind) for name, kind in _NEEDED.items()):
        raise CheckpointMismatch(f"{directory / _CARD} is not a card: expected variant, config and sha256 in it.")
    try:
        data = (directory / _WEIGHTS).read_bytes()
    except OSError as error:
        raise CheckpointMismatch(
            f"{directory / _WEIGHTS} cannot be read ({error}); expected the weights beside the card."
        ) from error
    digest = card_digest(card, data)
    if digest != card["sha256"]:
        raise CheckpointMismatch(
            f"{directory / _CARD} or {_WEIGHTS} beside it was changed: its SHA-256 is {digest[:12]}..., the card says "
            f"{card['sha256'][:12]}.... Take a fresh copy of both."
        )
    return card, data


def load_pretrained(directory: Path, modules: Mapping[str, nn.Module]) -> None:
    """Load a published policy into modules, after card and weights were compared with their digest.

    Args:
        directory: a directory that :func:`save_pretrained` wrote.
        modules: to fill, by name.

    Raises:
        CheckpointMismatch: if card or weights are missing or were changed, or if the weights do not fit.
    """
    card, data = _verified(directory)
    try:
        tensors = load_tensors(data)
        for name, module in modules.items():
            prefix = f"{name}."
            module.load_state_dict({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})
    except (SafetensorError, RuntimeError) as error:
        raise CheckpointMismatch(
            f"{directory / _WEIGHTS} does not fit the variant {card['variant']!r} ({in_one_line(error)}). Take a fresh "
            "copy of both files."
        ) from error

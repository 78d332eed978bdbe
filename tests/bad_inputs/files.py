"""Folders of published policies and of runs, made once, and what breaks them."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from torch import nn

from ppt_rl.evaluation import pretrained_card, published_policies, save_pretrained
from ppt_rl.training.checkpoint import find_checkpoint, save_checkpoint
from tests.bad_inputs.shared import policy

__all__ = ["good_card", "good_checkpoint", "write_broken_files", "write_card"]

#: The step-wise policy: the smallest chain.
NAME = "s_push"
#: Folder of the run with the good checkpoint; removed at the end of the process.
_RUN = TemporaryDirectory()


@cache
def good_card() -> dict[str, Any]:
    """The card of a published policy."""
    return pretrained_card(published_policies()[NAME])


def write_card(folder: Path, changes: dict[str, Any]) -> Path:
    """A published policy whose card, as its digest knows it, says something else; None removes an entry.

    Args:
        folder: where to write it.
        changes: entries of the card; those of ``config`` are merged into its options.
    """
    card = {**good_card(), **{key: value for key, value in changes.items() if key != "config"}}
    options = changes.get("config", {})
    merged = isinstance(options, dict)
    card["config"] = {**card["config"], **options} if merged else options
    for record in (card, card["config"]) if merged else (card,):
        for name in [name for name, value in record.items() if value is None]:
            del record[name]
    save_pretrained(folder / "policy", {"actor": policy(NAME).actor}, card)
    return folder / "policy"


@cache
def good_checkpoint() -> Path:
    """A checkpoint of an untrained policy, in the folder of its run."""
    folder = Path(_RUN.name)
    metadata = {"variant": NAME, "config": good_card()["config"], "success": 0.0}
    save_checkpoint(folder, {"actor": policy(NAME).actor}, step=1, metadata=metadata)
    return find_checkpoint(folder)


def write_checkpoint(folder: Path, metadata: dict[str, Any]) -> Path:
    """A checkpoint of something else, with this metadata."""
    save_checkpoint(folder, {"actor": nn.Linear(2, 2)}, step=1, metadata={"success": 0.0, **metadata})
    return find_checkpoint(folder)


def write_broken_files(folder: Path) -> None:
    """Broken files for command lines.

    Args:
        folder: where to write them.
    """
    (folder / "empty").mkdir()
    (folder / "file.txt").write_text("no policy")
    (folder / "empty.torchrl").write_bytes(b"")
    (folder / "short.torchrl").write_bytes(good_checkpoint().read_bytes()[:-200])
    (folder / "broken.json").write_text('{"segments": [')
    (folder / "far.json").write_text(json.dumps({"segments": [{"kind": "straight", "length": 1.9}]}))
    (folder / "broken.py").write_text("def (")
    (folder / "other.py").write_text("x = 1")
    write_card(folder / "fly", {"variant": "ppt_fly"})
    write_card(folder / "two", {"config": {"p_max": "two"}})
    shutil.copytree(published_policies()[NAME], folder / "torn")
    (folder / "torn" / "policy.safetensors").write_bytes(b"torn")

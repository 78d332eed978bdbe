"""Damaged cards of published policies and damaged checkpoints."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import nn

from ppt_rl.evaluation import load_policy, load_pretrained, pretrained_card, published_policies
from ppt_rl.training import checkpoint_info, find_checkpoint, load_checkpoint
from tests.bad_inputs.entry import BadInput
from tests.bad_inputs.files import NAME, good_card, good_checkpoint, write_card, write_checkpoint

__all__ = ["ENTRIES"]


def _in_folder(name: str, match: str, make: Callable[[Path], object], pending: bool = False) -> BadInput:
    def run() -> object:
        with tempfile.TemporaryDirectory() as folder:
            return make(Path(folder))

    return BadInput(name, run, match, pending)


def _card(match: str, pending: bool = False, **changes: Any) -> BadInput:
    """A card whose digest is right and whose content is not."""
    name = f"card with {json.dumps(changes)[:90]}"
    return _in_folder(name, match, lambda folder: load_policy(write_card(folder, changes)), pending)


def _option(match: str, pending: bool = False, **options: Any) -> BadInput:
    return _card(match, pending, config=options)


def _damaged(name: str, match: str, file: str, data: bytes | None, pending: bool = False) -> BadInput:
    """A published policy of which one file was replaced, or removed where there is no data."""

    def load(folder: Path) -> object:
        shutil.copytree(published_policies()[NAME], folder / "policy")
        (folder / "policy" / file).unlink()
        if data is not None:
            (folder / "policy" / file).write_bytes(data)
        return load_pretrained(folder / "policy", {})

    return _in_folder(f"policy with {name}", match, load, pending)


def _edited(**changes: Any) -> bytes:
    return json.dumps({**good_card(), **changes}).encode()


_TORN, _CHANGED = "card.json cannot be read .*; take a fresh copy", "was changed: its SHA-256 is .*Take a fresh copy"
_CARD, _WEIGHTS = "card.json", "policy.safetensors"
_FILES = [
    _damaged("an empty card", _TORN, _CARD, b""),
    _damaged("a torn card", _TORN, _CARD, json.dumps(good_card())[:-9].encode()),
    _damaged("a binary card", _TORN, _CARD, bytes(range(256))),
    _damaged("a list for a card", "card.json is not a card: expected variant", _CARD, b"[1, 2]"),
    _damaged("a card nested without end", _TORN, _CARD, b"[" * 100_000),
    _damaged("an edited digest", "was changed: .*, the card says 000000000000", _CARD, _edited(sha256="0" * 64)),
    _damaged("an edited note", _CHANGED, _CARD, _edited(seed=7)),
    _damaged("an edited limit", _CHANGED, _CARD,
             _edited(config={**good_card()["config"], "p_max": 100.0})),
    _damaged("a digest that is a number", "card.json is not a card: expected", _CARD, _edited(sha256=7)),
    _damaged("no weights", "policy.safetensors cannot be read .*; expected the weights beside", _WEIGHTS, None),
    _damaged("empty weights", _CHANGED, _WEIGHTS, b""),
    _damaged("torn weights", _CHANGED, _WEIGHTS,
             (published_policies()[NAME] / _WEIGHTS).read_bytes()[:-100]),
    _in_folder("a folder without a card", _TORN, pretrained_card),
]  # fmt: skip
_CONTENTS = [
    _card("is not a card: expected variant, config and sha256", variant=None),
    _card("is not a card: expected variant, config and sha256", variant=7),
    _card("is not a card: expected variant, config and sha256", config="default"),
    _card("recipe 'ppt_fly' is unknown; expected one of", variant="ppt_fly"),
    _card("recipe '.*nowhere.py' is unknown; expected one of .* or the file", recipe="nowhere.py"),
    _card("names the recipe 7; expected the path of a file", recipe=7),
    _card(r"written by another version of s_push: .*PPOConfig .*unknown \['tempo'\]", config={"ppo": {"tempo": 1.0}}),
    _card(r"written by another version of s_push: .*unknown \['speed'\]", config={"speed": 1.0}),
    _option("p_max is 'two'; expected", p_max="two"),
    _option("p_max is -1.0; expected", p_max=-1.0),
    _option("p_max is nan; expected", p_max=math.nan),
    _option(r"p_max is \[2\]; expected", p_max=[2]),
    _option("arm 'octopus' is unknown; expected one of .*'panda'", arm="octopus"),
    _option("arm 7 is unknown; expected one of", arm=7),
    _option("duration is inf; expected", duration=math.inf),
    _option("duration.*'long'.*; expected", duration="long"),
    _option("duration is 1000000000000.0; expected a number from", duration=1e12),
    _option("physics_dt is 0.0; expected", physics_dt=0.0),
    _option("control_dt=0.0007 s is 1.4 times physics_dt=0.0005 s; expected", control_dt=0.0007),
    _option("stiffness.*-400.*; expected", stiffness=-400.0),
    _option("damping_ratio.*nan.*; expected", damping_ratio=math.nan),
    _option("box_sizes is 0.5; expected a number from", box_sizes=[0.5]),
    _option("box_sizes.*0.06.*; expected", box_sizes=0.06),
    _option("max_velocity.*0.0.*; expected", max_velocity=0.0),
    _option("max_lead.*-0.05.*; expected", max_lead=-0.05),
    _option("initial_scale is 0.0; expected", initial_scale=0.0),
    _option("num_threads.*-4.*; expected", num_threads=-4),
    _option("num_envs.*-1.*; expected", num_envs=-1),
    _option("seed.*'lucky'.*; expected", seed="lucky"),
    _option("epochs.*'all'.*; expected", ppo={**good_card()["config"]["ppo"], "epochs": "all"}),
    _option("gamma is 1.5; expected", ppo={**good_card()["config"]["ppo"], "gamma": 1.5}),
    _option("epochs is None; expected", ppo={**good_card()["config"]["ppo"], "epochs": None}),
    _option("ppo.*7.*; expected", ppo=7),
]


def _archive(name: str, match: str, damage: Callable[[bytes], bytes], pending: bool = False) -> BadInput:
    """A file that is no intact checkpoint: what the damage makes of an intact one."""

    def read(folder: Path) -> object:
        (folder / "a.torchrl").write_bytes(damage(good_checkpoint().read_bytes()))
        return checkpoint_info(folder / "a.torchrl")

    return _in_folder(f"checkpoint: {name}", match, read, pending)


def _metadata(name: str, match: str, metadata: dict[str, Any], pending: bool = False) -> BadInput:
    return _in_folder(
        f"checkpoint: {name}", match, lambda folder: load_policy(write_checkpoint(folder, metadata)), pending
    )


def _flipped(data: bytes) -> bytes:
    """One byte in the middle is another one."""
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 0xFF]) + data[middle + 1 :]


_UNFIT = "does not fit .*; expected a checkpoint of the same variant"
_UNREAD = "a.torchrl (cannot be read as a checkpoint|is damaged|is not a checkpoint).*(use another|expected)"
_CHECKPOINTS = [
    _archive("empty", "(?i)" + _UNREAD, lambda _: b""),
    _archive("a text", "(?i)" + _UNREAD, lambda _: b"no checkpoint"),
    _archive("half of one", "(?i)" + _UNREAD, lambda data: data[:5000]),
    _archive("all but its end", "(?i)" + _UNREAD, lambda data: data[:-100]),
    _archive("a flipped byte", "(?i)" + _UNREAD, _flipped),
    _archive("an empty archive", "(?i)" + _UNREAD, lambda _: b"PK\x05\x06" + bytes(18)),
    _in_folder("checkpoint: nowhere", "nothing does not exist; expected a checkpoint or a run's directory",
               lambda folder: find_checkpoint(folder / "nothing")),
    _in_folder("checkpoint: an empty folder", "holds no checkpoint; expected a checkpoint", find_checkpoint),
    _in_folder("checkpoint: a folder for a file", "(cannot be read|is not a checkpoint).*([Uu]se|expected)",
               checkpoint_info),
    BadInput("checkpoint: of another variant", lambda: checkpoint_info(good_checkpoint(), "ppt_push"),
             "is of variant 's_push'; expected 'ppt_push'. Use the recipe that trained it"),
    BadInput("checkpoint: a component of another shape", lambda: load_checkpoint(
        good_checkpoint(), {"actor": nn.Linear(2, 3)}), _UNFIT),
    BadInput("checkpoint: a component that is not in it", lambda: load_checkpoint(
        good_checkpoint(), {"promp": nn.Linear(2, 3)}), _UNFIT),
    _metadata("no variant", "is not a checkpoint of this library.*(names no variant|expected)", {"config": {}}),
    _metadata("no options", "is not a checkpoint of this library", {"variant": NAME}),
    _metadata("another library's variant", "recipe 'ppt_fly' is unknown; expected one of",
              {"variant": "ppt_fly", "config": {}}),
    _metadata("options of another version", "was written by another version of s_push: .*speed.*; expected the fields",
              {"variant": NAME, "config": {"speed": 1.0}}),
    _metadata("options that are none", "(is not a checkpoint|another version).*(expected|Use|names no)",
              {"variant": NAME, "config": "default"}),
    _metadata("another network", "does not fit .*; expected a checkpoint of the same variant",
              {"variant": NAME, "config": good_card()["config"]}),
]  # fmt: skip

ENTRIES = [*_FILES, *_CONTENTS, *_CHECKPOINTS]

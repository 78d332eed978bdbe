from __future__ import annotations

import json
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

from ppt_rl.evaluation import (
    is_pretrained,
    load_policy,
    load_pretrained,
    pretrained_card,
    published_policies,
    save_pretrained,
)
from ppt_rl.evaluation.published import card_digest
from ppt_rl.modules import ProMP, make_actor
from ppt_rl.training import CheckpointMismatch

CARD = {"variant": "ppt_push", "config": {"num_basis": 4, "e_max": 3.0}, "note": "of a test"}
WEIGHTS = "policy.safetensors"


def modules(seed: int, num_basis: int = 4, size: int = 12) -> dict[str, nn.Module]:
    """An actor and a primitive whose parameters and buffers are all drawn, some of them in double precision."""
    torch.manual_seed(seed)
    promp = ProMP(num_basis, 3, 3.0)
    parts = {"actor": make_actor(["pose"], 7, size), "promp": promp.double() if seed % 2 else promp}
    for part in parts.values():
        for value in part.state_dict().values():
            value.copy_(torch.randn_like(value))
    return parts


@pytest.fixture
def published(tmp_path: Path) -> Path:
    """Directory of a published policy."""
    save_pretrained(tmp_path / "policy", modules(1), CARD)
    return tmp_path / "policy"


def pretrained_record(directory: Path) -> dict[str, Any]:
    """What a card says, unchecked."""
    return json.loads((directory / "card.json").read_text())


def edit_card(directory: Path, **changes: object) -> None:
    card = pretrained_record(directory) | changes
    (directory / "card.json").write_text(json.dumps({key: value for key, value in card.items() if value is not None}))


def test_a_policy_and_its_primitive_come_back_to_the_bit(published):
    saved, loaded = modules(1), modules(3)
    load_pretrained(published, loaded)
    for name, part in saved.items():
        state = loaded[name].state_dict()
        assert state.keys() == part.state_dict().keys()
        assert len(state) > 3
        for key, value in part.state_dict().items():
            assert state[key].dtype == value.dtype
            assert torch.equal(state[key], value), f"{name}.{key}"


def test_the_card_says_what_it_was_given_and_the_digest_of_the_weights(published):
    card = pretrained_card(published)
    assert {key: card[key] for key in CARD} == CARD
    assert card["weights"] == WEIGHTS
    assert len(card["sha256"]) == 64
    assert {path.name for path in published.iterdir()} == {WEIGHTS, "card.json"}


def test_the_file_of_weights_holds_tensors_and_no_code(published):
    data = (published / WEIGHTS).read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    header.pop("__metadata__", None)
    names = {f"{name}.{key}" for name, part in modules(1).items() for key in part.state_dict()}
    assert set(header) == names
    ends = [entry["data_offsets"][1] for entry in header.values()]
    assert max(ends) == len(data) - 8 - length  # numbers, to the last byte
    for sign in (b"PK\x03\x04", b"\x80\x02", b"\x80\x04"):
        assert not data.startswith(sign)


def test_a_module_can_be_loaded_without_the_others(published):
    loaded = modules(3)
    load_pretrained(published, {"promp": loaded["promp"]})
    assert torch.equal(loaded["promp"].weights_cov, modules(1)["promp"].weights_cov)


def test_only_a_directory_with_a_card_is_a_published_policy(published, tmp_path):
    assert is_pretrained(published)
    assert not is_pretrained(tmp_path)
    assert not is_pretrained(published / WEIGHTS)
    assert not is_pretrained(tmp_path / "nothing")


@pytest.mark.parametrize("place", [0, 200, -1])
def test_a_flipped_byte_in_the_weights_is_refused(published, place):
    data = bytearray((published / WEIGHTS).read_bytes())
    data[place] ^= 0x01
    (published / WEIGHTS).write_bytes(data)
    loaded = modules(3)
    with pytest.raises(CheckpointMismatch, match=r"was changed: its SHA-256 is \w{12}\.\.\., the card says \w{12}"):
        load_pretrained(published, loaded)
    for name, part in modules(3).items():  # nothing was loaded
        for key, value in part.state_dict().items():
            assert torch.equal(loaded[name].state_dict()[key], value)


def test_weights_cut_short_are_refused(published):
    (published / WEIGHTS).write_bytes((published / WEIGHTS).read_bytes()[:-100])
    with pytest.raises(CheckpointMismatch, match="SHA-256"):
        load_pretrained(published, modules(3))


@pytest.mark.parametrize("digest", ["0" * 64, ""])
def test_a_card_with_another_digest_is_refused(published, digest):
    edit_card(published, sha256=digest)
    with pytest.raises(CheckpointMismatch, match=r"was changed: its SHA-256 is .* Take a fresh copy of both"):
        load_pretrained(published, modules(3))


def test_missing_weights_are_named(published):
    (published / WEIGHTS).unlink()
    with pytest.raises(CheckpointMismatch, match=r"policy\.safetensors cannot be read .* beside the card"):
        load_pretrained(published, modules(3))


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00"])
def test_a_card_that_is_not_readable_is_refused(published, content):
    (published / "card.json").write_bytes(content)
    with pytest.raises(CheckpointMismatch, match=r"card\.json cannot be read .*; take a fresh copy"):
        pretrained_card(published)


def test_a_missing_card_is_named(tmp_path):
    with pytest.raises(CheckpointMismatch, match=r"card\.json cannot be read"):
        load_pretrained(tmp_path, modules(3))


@pytest.mark.parametrize("value", [None, 7, ["ppt_push"]])
@pytest.mark.parametrize("name", ["variant", "config", "sha256"])
def test_a_card_with_an_entry_that_is_missing_or_of_another_kind_is_refused(published, name, value):
    edit_card(published, **{name: value})
    for read in (pretrained_card, lambda directory: load_pretrained(directory, modules(3))):
        with pytest.raises(CheckpointMismatch, match="is not a card: expected variant, config and sha256"):
            read(published)


@pytest.mark.parametrize("content", ["3", "null", '"variant"', '["variant", "config", "sha256"]'])
def test_json_that_is_no_record_is_no_card(published, content):
    (published / "card.json").write_text(content)
    with pytest.raises(CheckpointMismatch, match="is not a card"):
        load_pretrained(published, modules(3))


@pytest.mark.parametrize("other", [{"num_basis": 5}, {"size": 15}])
def test_weights_of_another_shape_do_not_fit(published, other):
    with pytest.raises(CheckpointMismatch, match=r"does not fit the variant 'ppt_push' [\s\S]*size mismatch"):
        load_pretrained(published, modules(3, **other))


def test_weights_without_a_module_that_is_asked_for_do_not_fit(tmp_path):
    save_pretrained(tmp_path, {"actor": modules(1)["actor"]}, CARD)
    with pytest.raises(CheckpointMismatch, match=r"does not fit the variant [\s\S]*Missing key"):
        load_pretrained(tmp_path, modules(3))


def test_a_file_that_is_no_safetensors_file_does_not_fit_even_if_the_card_knows_it(published):
    (published / WEIGHTS).write_bytes(b"something else")
    edit_card(published, sha256=card_digest(pretrained_record(published), b"something else"))
    with pytest.raises(CheckpointMismatch, match="does not fit the variant 'ppt_push'"):
        load_pretrained(published, modules(3))


# -- what the digest covers --------------------------------------------------------------------------------------------


def places(record: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of every value in a record."""
    if isinstance(record, dict) and record:
        return [place for key, value in record.items() for place in places(value, (*path, key))]
    if isinstance(record, list) and record:
        return [place for key, value in enumerate(record) for place in places(value, (*path, key))]
    return [path]


def changed(value: Any) -> Any:
    """Another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + (1 if isinstance(value, int) else 0.125)
    return "other" if isinstance(value, str) else [value]


@pytest.mark.parametrize("name", published_policies())
def test_no_field_of_the_card_of_a_shipped_policy_can_be_changed(tmp_path, name):
    copy = Path(shutil.copytree(published_policies()[name], tmp_path / name))
    card = pretrained_card(copy)
    every = places(card)
    assert len(every) > 60
    for path in every:
        record = json.loads(json.dumps(card))
        part = record
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = changed(part[path[-1]])
        (copy / "card.json").write_text(json.dumps(record))
        with pytest.raises(CheckpointMismatch):
            pretrained_card(copy)


@pytest.mark.parametrize("change", [{"added": 1}, {"note": None}])
def test_a_field_can_neither_be_added_to_a_card_nor_removed(published, change):
    edit_card(published, **change)
    with pytest.raises(CheckpointMismatch, match="was changed: its SHA-256"):
        pretrained_card(published)


def test_a_card_with_a_looser_limit_makes_no_policy(tmp_path):
    copy = Path(shutil.copytree(published_policies()["ppt_push"], tmp_path / "copy"))
    edit_card(copy, config=pretrained_record(copy)["config"] | {"p_max": 1e5})
    with pytest.raises(CheckpointMismatch, match=r"card\.json or policy\.safetensors beside it was changed"):
        load_policy(copy)


def test_the_order_and_the_layout_of_a_card_do_not_count(published):
    record = pretrained_record(published)
    (published / "card.json").write_text(json.dumps(dict(reversed(record.items())), indent=7))
    assert pretrained_card(published) == record


def test_a_card_whose_options_would_exhaust_the_machine_is_refused_before_anything_is_made(tmp_path):
    source = published_policies()["ppt_push"]
    card = pretrained_card(source)
    for name, value in (("num_basis", 10**9), ("duration", 1e9), ("physics_dt", 1e-9), ("num_envs", 10**9)):
        copy = Path(shutil.copytree(source, tmp_path / name))
        config = card["config"] | {name: value}
        edit_card(copy, config=config)
        sealed = card_digest(card | {"config": config}, (copy / WEIGHTS).read_bytes())
        edit_card(copy, sha256=sealed)
        with pytest.raises(CheckpointMismatch, match=rf"{name} is .*; expected a (whole )?number from"):
            load_policy(copy)

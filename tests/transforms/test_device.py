"""No transform makes the host wait for a GPU within a chunk.

Tensors on ``meta`` have no values, so whatever looks at one there fails. What the host may look at is decided in one
place, :func:`ppt_rl.functional.checks.is_readable`; denied, the whole chain takes the way that it takes on a GPU.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv, UnaryTransform

from ppt_rl.envs import PandaPushEnv
from ppt_rl.functional import checks
from ppt_rl.transforms import MacroStepTransform
from ppt_rl.transforms.chain import step_inside
from ppt_rl.transforms.chunk import ChunkMemory
from tests.engines import COARSE
from tests.transforms.cases import CASES, control_chain, make_env
from tests.transforms.mocks import MockArmEnv, actions_for, play


@pytest.fixture
def denied(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The host may not look at any value, as on a GPU."""
    for module in list(sys.modules.values()):
        if getattr(module, "is_readable", None) is checks.is_readable and module is not checks:
            monkeypatch.setattr(module, "is_readable", lambda value: False)
    monkeypatch.setattr(checks, "is_readable", lambda value: False)


@pytest.fixture
def without_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what looks at values before the first step: the bounds of specs, and the gains of a controller."""
    compare = torch.allclose
    monkeypatch.setattr("ppt_rl.transforms.impedance.warn_if_unstable", lambda *args: None)
    monkeypatch.setattr(torch, "allclose", lambda a, b, *args, **kwargs: a.is_meta or compare(a, b, *args, **kwargs))


def assert_close(reached: TensorDictBase, expected: TensorDictBase) -> None:
    assert set(reached.keys(True, True)) == set(expected.keys(True, True))
    for key, value in expected.items(True, True):
        torch.testing.assert_close(
            reached[key], value, rtol=1e-5, atol=1e-5, msg=lambda text, key=key: f"{key}: {text}"
        )


@pytest.mark.usefixtures("without_values")
@pytest.mark.parametrize("name", sorted(set(CASES) - {"MacroStepTransform"}))
def test_a_step_of_a_transform_looks_at_no_value(name: str) -> None:
    env = make_env(name, (3,), device="meta")
    root = env.fake_tensordict().exclude("next")
    for mask in (None, torch.ones(3, dtype=torch.bool, device="meta")):
        following = step_inside(env, root.copy() if mask is None else root.copy().set("_step", mask))
        assert all(value.is_meta for value in following.values(True, True))


@pytest.mark.usefixtures("without_values")
def test_a_chunk_looks_at_who_has_ended_once_in_sixteen_control_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[int] = []

    def look(memory: ChunkMemory) -> bool:
        looked.append(len(memory._held))
        memory._held.clear()
        memory.alive = None
        return False

    monkeypatch.setattr(ChunkMemory, "none_goes_on", look)
    base = MockArmEnv((3,), device="meta")
    env = TransformedEnv(base, Compose(*control_chain(), MacroStepTransform(41)))
    root = env.fake_tensordict().exclude("next")
    env.transform.inv(root)
    assert looked == [16, 16, 8]


HORIZONS = [(60,), (2, 4, 60), (17, 16, 60), (1, 3, 2), (16, 32, 33), (40, 39, 41), (20, 21, 60)]


@pytest.mark.parametrize("honours", [True, False], ids=["honours_step", "ignores_step"])
@pytest.mark.parametrize("horizons", HORIZONS, ids=str)
def test_looking_seldom_changes_nothing(request: pytest.FixtureRequest, horizons, honours) -> None:
    def episodes() -> TensorDictBase:
        base = MockArmEnv((3,), horizons=horizons, honours_step=honours)
        chain = [*control_chain(), MacroStepTransform(40, discount=0.9, trace_keys=["count"])]
        env = TransformedEnv(base, Compose(*chain))
        env.set_seed(3)
        return play(env, actions_for(env, 3, scale=0.1))

    expected = episodes()
    request.getfixturevalue("denied")
    reached = episodes()
    assert_close(reached, expected)


def interrupted(base, when) -> TransformedEnv:
    late = UnaryTransform(["count"], ["late"], fn=when)
    return TransformedEnv(base, Compose(late, MacroStepTransform(20, interrupt_key="late")))


@pytest.mark.parametrize("horizons", [(100,), (2, 100), (5, 7), (3, 4)], ids=str)
@pytest.mark.parametrize("count", [3, 4, 18])
def test_interrupted_chunks_are_the_same(request: pytest.FixtureRequest, horizons, count) -> None:
    def episodes() -> TensorDictBase:
        env = interrupted(MockArmEnv((2,), horizons=horizons), lambda n: (n % count == 0) & (n > 0))
        return play(env, actions_for(env, 5))

    expected = episodes()
    request.getfixturevalue("denied")
    reached = episodes()
    assert_close(reached, expected)


def test_a_simulator_stands_still_while_nobody_has_looked(request: pytest.FixtureRequest) -> None:
    def episode() -> TensorDictBase:
        base = PandaPushEnv(2, seed=0, duration=0.12, engine=COARSE)
        env = TransformedEnv(base, Compose(*control_chain(), MacroStepTransform(9)))
        root = env.reset()
        reference = torch.cat([root["pose"], torch.zeros(2, 6)], -1).unsqueeze(1).repeat(1, 9, 1)
        reference[..., 0] += 0.02
        played = env.rollout(2, lambda td: td.set("action", reference.clone()), break_when_any_done=False)
        env.close()
        return played

    expected = episode()
    request.getfixturevalue("denied")
    reached = episode()
    assert expected["next", "control_steps"].flatten().tolist() == [9, 3, 9, 3]
    assert_close(reached, expected)


@pytest.mark.usefixtures("denied")
def test_what_is_not_finite_fails_as_an_assertion_of_the_device() -> None:
    env = make_env("EnergyTankTransform", (2,))
    root = env.reset()
    root["action"] = torch.full((2, 7), torch.nan)
    with pytest.raises(RuntimeError, match="effort is not finite"):
        env.step(root)


@pytest.mark.usefixtures("denied")
def test_a_level_that_rose_fails_as_an_assertion_of_the_device() -> None:
    env = make_env("EnergyTankTransform", (2,))
    root = env.reset()
    root["action"], root["tank_energy"] = torch.zeros(2, 7), torch.full((2, 1), 9.0)
    with pytest.raises(RuntimeError, match="above the tank's own"):
        env.step(root)

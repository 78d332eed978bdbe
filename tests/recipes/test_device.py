"""Every recipe's chain, with its environment, on a device that the host cannot look at.

Tensors on ``meta`` stand for those on a GPU. A dispatch mode counts the values that the host asks for, each of which
would make it wait for the device, and the operations that mix tensors of two devices.
"""

from __future__ import annotations

import traceback
from collections import Counter
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten

from ppt_rl.envs import batch
from ppt_rl.envs.physics import PhysicsStep
from ppt_rl.envs.row_generators import RowGenerators
from ppt_rl.evaluation.recipe import find_recipe, shipped_recipes
from ppt_rl.modules.kinematics import Kinematics

META = torch.device("meta")
PUSHING = [name for name in shipped_recipes() if name.endswith("push")]
LOOK = torch.ops.aten._local_scalar_dense.default


class NoWorlds:
    """An engine without values."""

    def __init__(self, config, model, num_envs, substeps, device, *, written, every_substep):
        self.num_envs, self.device, self.size = num_envs, META, model.nsensordata
        self.substeps = substeps if every_substep else 1

    def write(self, rows, parameters):
        assert all(parameter.values.is_meta for parameter in parameters)

    def reset(self, rows, position):
        assert position.is_meta
        return torch.zeros(len(rows), self.size, device=META)

    def step(self, control, mask=None):
        assert control.is_meta
        diverged = torch.zeros(self.num_envs, dtype=torch.bool, device=META)
        return PhysicsStep(torch.zeros(self.num_envs, self.substeps, self.size, device=META), diverged)

    def close(self):
        pass


class Watch(TorchDispatchMode):
    """Counts, by the line of the library that is to blame, what a GPU would not do without waiting or at all."""

    def __init__(self) -> None:
        super().__init__()
        self.looks: Counter[str] = Counter()
        self.mixed: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        tensors = [leaf for leaf in tree_flatten((args, kwargs))[0] if isinstance(leaf, torch.Tensor)]
        if func is LOOK and tensors[0].is_meta:
            line = _line()
            self.looks[line] += 1
            return ".all(" in line if tensors[0].dtype == torch.bool else 1
        if "copy" not in str(func) and len({tensor.device for tensor in tensors if tensor.ndim}) > 1:
            self.mixed[f"{func}: {_line()}"] += 1
        return func(*args, **(kwargs or {}))


def _line() -> str:
    places = ("/ppt_rl/", "/recipes/ppo", "/torchrl/", "/tensordict/")
    frames = [frame for frame in traceback.extract_stack() if any(place in frame.filename for place in places)]
    return f"{frames[-1].filename}:{frames[-1].lineno}: {frames[-1].line}" if frames else "outside of the library"


@pytest.fixture
def no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Environments on ``meta`` have no physics; drawing an episode and inverse kinematics, which look, give nothing."""
    compare, inverse, draw, real = torch.allclose, Kinematics.inverse, RowGenerators.uniform, batch.make_engine

    def make(config, model, num_envs, substeps, device, **options):
        kind = NoWorlds if device.type == "meta" else real
        return kind(config, model, num_envs, substeps, device, **options)

    monkeypatch.setattr(batch, "make_engine", make)
    monkeypatch.setattr(torch, "allclose", lambda a, b, *args, **kw: a.is_meta or compare(a, b, *args, **kw))
    monkeypatch.setattr(torch, "_assert_async", lambda *args: None)
    monkeypatch.setattr("ppt_rl.transforms.impedance.warn_if_unstable", lambda *args: None)
    monkeypatch.setattr(
        Kinematics, "inverse", lambda self, pose, guess: guess.clone() if pose.is_meta else inverse(self, pose, guess)
    )
    monkeypatch.setattr(
        RowGenerators, "uniform",
        lambda self, rows, count: torch.zeros(len(rows), count, dtype=torch.float64, device=META) if rows.is_meta
        else draw(self, rows, count),
    )  # fmt: skip


@pytest.mark.usefixtures("no_device")
@pytest.mark.parametrize("audit", [False, True])
@pytest.mark.parametrize("variant", PUSHING)
def test_a_macro_step_of_a_recipe_stays_on_its_device_and_looks_at_few_values(variant: str, audit: bool) -> None:
    recipe = find_recipe(variant)
    config = recipe.config(duration=0.3, device="meta", num_envs=4)
    modules = recipe.make_modules(config)
    with torch.no_grad(), Watch():
        env = recipe.make_env(config, modules, num_envs=4, seed=1, audit=audit)
        actor, _ = recipe.make_policy(config, env)
        tensordict = env.rollout(2, actor)[:, -1].exclude("next")  # what is built at first use is built now
        with Watch() as watch:
            following = env.step(actor(tensordict))["next"]
    assert all(value.is_meta for value in following.values(True, True))
    assert not watch.mixed
    assert sum(watch.looks.values()) <= 2, watch.looks  # at most one in 16 control steps of the 30

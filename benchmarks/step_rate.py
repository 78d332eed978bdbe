"""Control steps a second: MuJoCo alone, the environment, the full chain, and the collector with the policy.

All four run in one process on the same models, from the same episodes, with the same substeps and threads, in turn;
a ratio is the median over the repeats, each against MuJoCo alone right before and right after.
``python benchmarks/step_rate.py --num-envs 128 --threads 2 --json``
"""

from __future__ import annotations

import json
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from mujoco import rollout
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType

from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.recipes.ppo_ppt_push import RECIPE
from ppt_rl.tasks.push import fit_push_prior
from ppt_rl.training import run_script


@dataclass(frozen=True)
class Config:
    """Measure control steps a second.

    Attributes:
        num_envs: environments that step together.
        threads: physics threads.
        torch_threads: threads of torch, as in the recipes.
        repeats: episodes of each kind.
        seconds: episode length [s].
        json: print one line of JSON only.
    """

    num_envs: int = 128
    threads: int = 2
    torch_threads: int = 1
    repeats: int = 5
    seconds: float = 3.0
    json: bool = False


def _timed(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _peak_memory() -> float:
    """Peak resident memory of this process [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@torch.no_grad()
def measure(run: Config) -> dict[str, float]:
    """Rates [control steps/s], their ratios to MuJoCo alone, and memory."""
    torch.set_num_threads(run.torch_threads)
    config = RECIPE.config(num_threads=run.threads, duration=run.seconds)
    promp = fit_push_prior(RECIPE.make_modules(config)["promp"], num_demonstrations=64)
    before = _peak_memory()
    env = RECIPE.make_env(config, {"promp": promp}, num_envs=run.num_envs, seed=1)
    actor, _ = RECIPE.make_policy(config, env)
    base, engine = env.base_env, env.base_env.engine
    env.reset()
    memory = (_peak_memory() - before) / run.num_envs
    torques = _reference_torques(env, actor)
    action = torch.from_numpy(torques).float()
    collector = Collector(
        env, actor, frames_per_batch=run.num_envs, total_frames=-1, trust_policy=True,
        auto_register_policy_transforms=False, exploration_type=ExplorationType.DETERMINISTIC,
    )  # fmt: skip
    batches = iter(collector)

    def restart() -> None:
        env.set_seed(1)
        env.reset()

    pool = rollout.Rollout(nthread=run.threads if run.threads > 1 else 0)
    data = [mujoco.MjData(engine.models[0]) for _ in range(run.threads)]
    held = np.ascontiguousarray(np.repeat(torques[:, :, None], base.substeps, 2))
    sensors = np.empty((run.num_envs, base.substeps, engine.models[0].nsensordata))

    def raw() -> None:
        state = np.stack([engine.state(row) for row in range(run.num_envs)])
        states = np.empty((run.num_envs, base.substeps, state.shape[-1]))
        for control in held:
            pool.rollout(
                engine.models, data, state, control, nstep=base.substeps, state=states, sensordata=sensors,
                skip_checks=True,
            )  # fmt: skip
            state = states[:, -1].copy()

    def environment() -> None:
        tensordict = base.fake_tensordict().exclude("next")
        for step in action:
            base._step(tensordict.set("action", step))

    tensordict = None

    def chain() -> None:
        env.step(tensordict)

    def prepare_chain() -> None:
        nonlocal tensordict
        env.set_seed(1)
        tensordict = actor(env.reset())

    def prepare_collector() -> None:
        env.set_seed(1)
        collector.reset()

    kinds: dict[str, tuple[Callable[[], None], Callable[[], Any]]] = {
        "base": (restart, environment),
        "chain": (prepare_chain, chain),
        "collector": (prepare_collector, lambda: next(batches)),
    }
    next(batches)
    times: dict[str, list[float]] = {name: [] for name in ("raw", *kinds)}
    ratios: dict[str, list[float]] = {name: [] for name in kinds}
    restart()
    times["raw"].append(_timed(raw))
    for _ in range(run.repeats):
        for name, (prepare, act) in kinds.items():
            prepare()
            times[name].append(_timed(act))
            restart()
            times["raw"].append(_timed(raw))
            # The machine's speed drifts, so each run is compared with MuJoCo alone just before and just after it.
            ratios[name].append(statistics.fmean(times["raw"][-2:]) / times[name][-1])
    if not bool((env.step(actor(env.reset()))["next", "control_steps"] == base.horizon).all()):
        raise RuntimeError("an episode ended early, so the four runs did not do the same work; take another seed.")
    steps = run.num_envs * base.horizon
    rates = {name: steps / statistics.median(values) for name, values in times.items()}
    result = {f"rate_{name}": rate for name, rate in rates.items()}
    result |= {f"ratio_{name}": statistics.median(values) for name, values in ratios.items()}
    return result | {"memory_per_env_mib": memory, "num_envs": run.num_envs, "threads": run.threads}


def _reference_torques(env: Any, actor: Any) -> np.ndarray:
    """Joint torques ``(T, num_envs, 7)`` that the chain sends in these episodes: all four do the same physics."""
    sent: list[np.ndarray] = []
    engine = env.base_env.engine
    step = engine.step

    def spy(control: np.ndarray, rows: Any = None) -> Any:
        sent.append(control.copy())
        return step(control, rows)

    env.set_seed(1)
    engine.step = spy
    env.step(actor(env.reset()))
    del engine.step
    return np.stack(sent)


def main(run: Config) -> None:
    """Measure and print."""
    result = measure(run)
    if run.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:>22} {value:10.3f}")


if __name__ == "__main__":
    run_script(main, Config)

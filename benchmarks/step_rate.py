"""Control steps a second: MuJoCo alone, the environment, the full chain, and the collector with the policy.

All four run in one process on the same models, from the same episodes, with the same substeps and threads, in turn;
a ratio is the median over the repeats, each against MuJoCo alone right before and right after.
``python benchmarks/step_rate.py --num-envs 128 --threads 2 --json``, and on a GPU, against MuJoCo Warp alone,
``python benchmarks/step_rate.py --device cuda --num-envs 4096 --goal pose --seconds 1.5 --json``
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
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType

from ppt_rl.envs import PushGoal
from ppt_rl.envs.mujoco_imports import mujoco
from ppt_rl.envs.physics import EngineName, WarpPhysics
from ppt_rl.recipes.ppo_ppt_push import RECIPE
from ppt_rl.tasks.push import fit_push_prior
from ppt_rl.training import run_script

#: Prepares an episode, and runs it.
Kind = tuple[Callable[[], Any], Callable[[], Any]]
Times = dict[str, list[float]]


@dataclass(frozen=True)
class Config:
    """Measure control steps a second.

    Attributes:
        num_envs: environments that step together.
        threads: physics threads.
        torch_threads: threads of torch, as in the recipes.
        repeats: episodes of each kind.
        seconds: episode length [s].
        goal: what has to be at the goal of a push.
        device: where the physics and the chain are.
        engine: engine of the physics.
        inference: run in torch's inference mode, as a loop that only executes a policy can.
        json: print one line of JSON only.
    """

    num_envs: int = 128
    threads: int = 2
    torch_threads: int = 1
    repeats: int = 5
    seconds: float = 3.0
    goal: PushGoal = "position"
    device: str = "cpu"
    engine: EngineName = "auto"
    inference: bool = False
    json: bool = False


def _wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


def _timed(run: Callable[[], Any], device: str) -> float:
    _wait(device)
    start = time.perf_counter()
    run()
    _wait(device)
    return time.perf_counter() - start


def _peak_memory(device: str) -> float:
    """Memory in use on a GPU, or peak resident memory of this process [MiB]."""
    if device != "cpu":
        free, total = torch.cuda.mem_get_info(device)
        return (total - free) / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@torch.no_grad()
def measure(run: Config) -> dict[str, float]:
    """Rates [control steps/s], their ratios to MuJoCo alone, and memory."""
    torch.set_num_threads(run.torch_threads)
    config = RECIPE.config(
        num_threads=run.threads, duration=run.seconds, goal=run.goal, device=run.device, engine=run.engine
    )
    promp = fit_push_prior(RECIPE.make_modules(config)["promp"], num_demonstrations=64)
    before = _peak_memory(run.device)
    env = RECIPE.make_env(config, {"promp": promp}, num_envs=run.num_envs, seed=1)
    actor, _ = RECIPE.make_policy(config, env)
    with torch.inference_mode() if run.inference else torch.no_grad():
        env.reset()
        memory = (_peak_memory(run.device) - before) / run.num_envs
        torques = _reference_torques(env, actor)
        kinds = _kinds(env, actor, torques)
        alone = _warp_alone if isinstance(env.base_env.engine, WarpPhysics) else _mujoco_alone
        times, ratios = _in_turn(run, env, alone(run, env, torques), kinds)
        if not bool((env.step(actor(env.reset()))["next", "control_steps"] == env.base_env.horizon).all()):
            raise RuntimeError("an episode ended early, so the four runs did not do the same work; take another seed.")
    steps = run.num_envs * env.base_env.horizon
    result = {f"rate_{name}": steps / statistics.median(values) for name, values in times.items()}
    result |= {f"ratio_{name}": statistics.median(values) for name, values in ratios.items()}
    return result | {"memory_per_env_mib": memory, "num_envs": run.num_envs, "threads": run.threads}


def _restart(env: Any) -> Any:
    env.set_seed(1)
    return env.reset()


def _mujoco_alone(run: Config, env: Any, torques: Tensor) -> Callable[[], None]:
    """The same physics without the library: the torques of an episode, held over the substeps."""
    base, engine = env.base_env, env.base_env.engine
    pool = rollout.Rollout(nthread=run.threads if run.threads > 1 else 0)
    data = [mujoco.MjData(engine.models[0]) for _ in range(run.threads)]
    held = np.ascontiguousarray(np.repeat(torques.numpy()[:, :, None], base.substeps, 2))
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

    return raw


def _warp_alone(run: Config, env: Any, torques: Tensor) -> Callable[[], None]:
    """The same physics without the library: a graph of the substeps, replayed for each control step."""
    worlds, substeps = env.base_env.engine.worlds, env.base_env.substeps
    controls = torques.float()

    def control_step() -> None:
        for _ in range(substeps):
            worlds.step(with_sensors=True)

    with worlds.on_stream():
        control_step()
    graph = worlds.record(control_step)

    def raw() -> None:
        for control in controls:
            worlds.control.copy_(control)
            worlds.replay(graph)

    return raw


def _kinds(env: Any, actor: Any, torques: Tensor) -> dict[str, Kind]:
    """What prepares and what runs an episode: of the bare environment, of the chain, through the collector."""
    base, action = env.base_env, torques.float()
    collector = Collector(
        env, actor, frames_per_batch=env.numel(), total_frames=-1, trust_policy=True,
        auto_register_policy_transforms=False, exploration_type=ExplorationType.DETERMINISTIC,
    )  # fmt: skip
    batches, start = iter(collector), {}

    def environment() -> None:
        tensordict = base.fake_tensordict().exclude("next")
        for step in action:
            base._step(tensordict.set("action", step))

    def prepare_chain() -> None:
        start["root"] = actor(_restart(env))

    def prepare_collector() -> None:
        env.set_seed(1)
        collector.reset()

    next(batches)
    return {
        "base": (lambda: _restart(env), environment),
        "chain": (prepare_chain, lambda: env.step(start["root"])),
        "collector": (prepare_collector, lambda: next(batches)),
    }


def _in_turn(run: Config, env: Any, raw: Callable[[], None], kinds: dict[str, Kind]) -> tuple[Times, Times]:
    """Times [s] of MuJoCo alone and of each kind, and the kinds' ratios to MuJoCo alone."""
    times: Times = {name: [] for name in ("raw", *kinds)}
    ratios: Times = {name: [] for name in kinds}
    _restart(env)
    times["raw"].append(_timed(raw, run.device))
    for _ in range(run.repeats):
        for name, (prepare, act) in kinds.items():
            prepare()
            times[name].append(_timed(act, run.device))
            _restart(env)
            times["raw"].append(_timed(raw, run.device))
            # The machine's speed drifts, so each run is compared with MuJoCo alone just before and just after it.
            ratios[name].append(statistics.fmean(times["raw"][-2:]) / times[name][-1])
    return times, ratios


def _reference_torques(env: Any, actor: Any) -> Tensor:
    """Joint torques ``(T, num_envs, n)`` that the chain sends in these episodes: all four do the same physics."""
    sent: list[Tensor] = []
    engine = env.base_env.engine
    step = engine.step

    def spy(control: Tensor, mask: Tensor | None = None) -> Any:
        sent.append(control.clone())
        return step(control, mask)

    env.set_seed(1)
    engine.step = spy
    env.step(actor(env.reset()))
    del engine.step
    return torch.stack(sent)


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

"""Time of one PPO update, ours and rsl_rl's, on the same batch, networks, epochs and minibatches, in turn.

rsl_rl (the package ``rsl-rl-lib``) is the PPO that fast simulators train with. Its part is what it does between two
rollouts: returns, epochs, statistics of the inputs. Ours is the same, and the values of the batch too, which rsl_rl
computed while it collected. Both run alone, then beside one process that keeps a CPU busy.
``python benchmarks/update.py --json``

rsl_rl is no dependency of the library. All that the benchmark needs of it comes with
``pip install --no-deps -c constraints.txt rsl-rl-lib``
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.modules.actor_critic import HIDDEN, make_actor, make_critic, update_input_norm
from ppt_rl.training import Learner, PPOConfig, run_script

#: Runs an update.
Update = Callable[[], Any]


@dataclass(frozen=True)
class Config:
    """Measure one update of PPO.

    Attributes:
        num_envs: environments in the batch.
        steps: policy steps of each.
        observations: numbers that actor and critic read.
        actions: numbers of an action.
        epochs: passes over the batch.
        minibatches: minibatches in a pass.
        repeats: updates of each, in turn.
        threads: threads of both, rsl_rl's those of torch; 0 takes one for each CPU.
        busy: whether to measure beside a busy process too.
        device: device of batch and networks.
        json: print one line of JSON only.
    """

    num_envs: int = 64
    steps: int = 128
    observations: int = 48
    actions: int = 12
    epochs: int = 5
    minibatches: int = 4
    repeats: int = 5
    threads: int = 0
    busy: bool = True
    device: str = "cpu"
    json: bool = False


def make_batch(run: Config, actor: Any) -> TensorDictBase:
    """What a collector returns: ``(num_envs, steps)``, with episodes that end here and there."""
    shape = (run.num_envs, run.steps)
    generator = torch.Generator().manual_seed(0)
    path = torch.randn(run.num_envs, run.steps + 1, run.observations, generator=generator).to(run.device)
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        batch = actor(TensorDict({"observation": path[:, :-1]}, shape, names=(None, "time"), device=run.device))
    done = (torch.rand(*shape, 1, generator=generator) < 0.02).to(run.device)
    following = {
        "observation": path[:, 1:],
        "reward": torch.randn(*shape, 1, generator=generator).to(run.device),
        "done": done,
        "terminated": done,
        "truncated": torch.zeros_like(done),
    }
    return batch.set("next", TensorDict(following, shape, device=run.device))


def ours(run: Config) -> Update:
    """The library's update."""
    actor = make_actor(["observation"], run.observations, run.actions).to(run.device)
    critic = make_critic(["observation"], run.observations).to(run.device)
    # No early stop, so that both make every pass.
    config = PPOConfig(
        epochs=run.epochs, minibatches=run.minibatches, target_kl=1e9, gamma=0.99, max_learning_rate=3e-4
    )
    learner, batch = Learner(actor, critic, config, run.threads or None), make_batch(run, actor)

    def update() -> None:
        learner.update(batch.copy())
        for network in (actor, critic):
            update_input_norm(network, batch)

    return update


def theirs(run: Config) -> Update:
    """rsl_rl's update, of the same batch and networks."""
    if importlib.util.find_spec("rsl_rl") is None:
        raise ValueError("rsl_rl is missing; expected it beside the library. pip install --no-deps rsl-rl-lib")
    from rsl_rl.algorithms import PPO
    from rsl_rl.models import MLPModel
    from rsl_rl.storage import RolloutStorage

    batch = make_batch(run, make_actor(["observation"], run.observations, run.actions).to(run.device))
    example = batch.select("observation")[:, 0]
    groups = {"actor": ["observation"], "critic": ["observation"]}
    common = {"hidden_dims": HIDDEN, "activation": "relu", "obs_normalization": True}
    gaussian = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "std_type": "log"}
    actor = MLPModel(example, groups, "actor", run.actions, distribution_cfg=gaussian, **common)
    critic = MLPModel(example, groups, "critic", 1, **common)
    storage = RolloutStorage("rl", run.num_envs, run.steps, example, [run.actions], run.device)
    algorithm = PPO(
        actor, critic, storage, num_learning_epochs=run.epochs, num_mini_batches=run.minibatches, entropy_coef=0.0,
        learning_rate=3e-4, device=run.device,
    )  # fmt: skip
    algorithm.train_mode()
    with torch.inference_mode():
        for step in range(run.steps):
            now = batch[:, step]
            algorithm.act(now.select("observation"))
            following = now["next"]
            algorithm.process_env_step(
                following.select("observation"), following["reward"].squeeze(-1), following["done"].squeeze(-1), {}
            )
    last = batch[:, -1]["next"].select("observation")

    def update() -> None:
        storage.step = run.steps
        algorithm.learning_rate = 3e-4
        with torch.inference_mode():
            algorithm.compute_returns(last)
        algorithm.update()

    return update


@contextlib.contextmanager
def busy_process() -> Iterator[Any]:
    """One process that keeps a CPU busy, beside this one."""
    process = multiprocessing.get_context("spawn").Process(target=_spin, daemon=True)
    process.start()
    time.sleep(1.0)
    try:
        yield process
    finally:
        process.terminate()
        process.join()


def _spin() -> None:
    while True:
        pass


def _timed(run: Config, update: Update, threads: int) -> float:
    torch.set_num_threads(threads)
    start = time.perf_counter()
    update()
    if run.device != "cpu":
        torch.cuda.synchronize(run.device)
    return time.perf_counter() - start


def in_turn(run: Config, updates: dict[str, tuple[Update, int]]) -> dict[str, list[float]]:
    """Times [s] of some updates, each with its number of torch's threads, in turn."""
    times: dict[str, list[float]] = {name: [] for name in updates}
    for _ in range(run.repeats):
        for name, (update, threads) in updates.items():
            times[name].append(_timed(run, update, threads))
    return times


def measure(run: Config) -> dict[str, float]:
    """Median times [s] and their ratios; ``ratio`` below 1 is faster than rsl_rl."""
    threads = run.threads or len(os.sched_getaffinity(0))
    updates = {"ours": (ours(run), 1), "rsl_rl": (theirs(run), threads)}
    for update, count in updates.values():
        _timed(run, update, count)
    result: dict[str, float] = {}
    for name in ("quiet", "busy") if run.busy else ("quiet",):
        with busy_process() if name == "busy" else contextlib.nullcontext():
            times = in_turn(run, updates)
        pairs = zip(times["ours"], times["rsl_rl"], strict=True)
        result |= {f"{who}_{name}_s": statistics.median(values) for who, values in times.items()}
        result[f"ratio_{name}"] = statistics.median(one / other for one, other in pairs)
    if run.busy:
        result |= {f"{who}_busy_over_quiet": result[f"{who}_busy_s"] / result[f"{who}_quiet_s"] for who in updates}
    return result


def main(run: Config) -> None:
    """Measure and print."""
    result = measure(run)
    if run.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:>22} {value:9.3f}")


if __name__ == "__main__":
    run_script(main, Config)

"""What a control step in the maze costs, as a multiple of one of box pushing: ``python benchmarks/maze_step.py``.

Both environments with the same chain (joint torque, tank, impedance, metrics) and batch, the tool in contact: on the
floor of a maze, or pushing a box. They run in turn, so that what else the machine does meets both.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv

from ppt_rl.envs import ArmEnv, EngineConfig, MazeEnv, PushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.training import run_script
from ppt_rl.transforms import EnergyTankTransform, EpisodeMetricsTransform, ImpedanceTransform, JointTorqueTransform


@dataclass(frozen=True)
class Config:
    """Compare the cost of a control step in the maze with one of box pushing.

    Attributes:
        num_envs: environments that step together.
        num_threads: physics threads; 0 takes one per CPU.
        steps: control steps of a repeat.
        repeats: of either, in turn.
    """

    num_envs: int = 64
    num_threads: int = 0
    steps: int = 200
    repeats: int = 5


def chained(base: ArmEnv) -> TransformedEnv:
    """The chain that the recipes of both tasks share."""
    return TransformedEnv(
        base,
        Compose(
            JointTorqueTransform(Kinematics(base.arm, base.tool_length)),
            EnergyTankTransform(),
            ImpedanceTransform(CartesianImpedanceController()),
            EpisodeMetricsTransform(),
        ),
    )


@torch.no_grad()
def seconds(env: TransformedEnv, steps: int) -> float:
    """Time of a control step, the tool dragged forward from its start [s]."""
    tensordict = env.reset()
    reference = torch.cat([tensordict["pose"], torch.zeros(env.numel(), 6)], -1)
    reference[:, 2] -= 0.003
    way = _way(tensordict, env)
    begin = time.perf_counter()
    for _ in range(steps):
        reference[:, :2] = tensordict["pose"][:, :2] + 0.01 * way
        tensordict = env.step_mdp(env.step(tensordict.set("action", reference.clone())))
    return (time.perf_counter() - begin) / steps


def _way(tensordict: TensorDictBase, env: TransformedEnv) -> torch.Tensor:
    """Unit vectors ``(B, 2)`` to drag along."""
    if "start_heading" in tensordict.keys():
        heading = tensordict["start_heading"]
        return torch.cat([heading.cos(), heading.sin()], -1)
    return torch.tensor([1.0, 0.0]).expand(env.numel(), 2)


def main(run: Config) -> None:
    """Time both in turn."""
    engine = EngineConfig(num_threads=run.num_threads or None)
    envs = {
        "push": chained(PushEnv(run.num_envs, seed=0, engine=engine)),
        "maze": chained(MazeEnv.mazes(run.num_envs, seed=0, engine=engine)),
    }
    times: dict[str, list[float]] = {name: [] for name in envs}
    for env in envs.values():
        seconds(env, 20)
    for _ in range(run.repeats):
        for name, env in envs.items():
            times[name].append(seconds(env, run.steps))
    ratios = np.asarray(times["maze"]) / np.asarray(times["push"])
    for name, values in times.items():
        print(f"{name}: {1e3 * np.median(values):.2f} ms a step of {run.num_envs} environments")
    print(f"ratio_maze {np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f} over {run.repeats} repeats)")
    for env in envs.values():
        env.close()


if __name__ == "__main__":
    torch.set_num_threads(1)
    run_script(main, Config)

"""Independent computations of walls and centre lines, to compare the library's with."""

from __future__ import annotations

import functools
import math

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from ppt_rl.envs import PandaMazeEnv
from ppt_rl.envs.maze.geometry import Corridor, Face, Floor, build_corridor
from ppt_rl.envs.maze.layout import Disc, MazeLayout, Straight, Turn
from ppt_rl.envs.maze.sampling import random_maze, random_straight
from ppt_rl.modules.impedance import CartesianImpedanceController
from tests.engines import model_of, write_state
from tests.envs.scenes import act, forwarded, impedance_chain

Array = NDArray[np.float64]
Built = list[tuple[MazeLayout, Corridor]]

#: Two turns, a disc, a ramp up and a ramp down.
SHORT = MazeLayout(
    (
        Straight(0.10), Turn(0.6), Straight(0.16, rise=0.02), Disc(0.09, -0.3), Straight(0.16, rise=-0.02), Turn(-0.5),
        Straight(0.10),
    ),
    width=0.056, start=(0.50, -0.25), heading=1.5,
)  # fmt: skip
#: A level straight corridor across the front of the arm.
LEVEL = MazeLayout((Straight(0.40),), width=0.056, start=(0.50, -0.20))


def built(*layouts: MazeLayout) -> Built:
    """Layouts with their corridors."""
    return [(layout, build_corridor(layout)) for layout in layouts]


@functools.cache
def random_mazes() -> Built:
    """Thirty mazes of the test set."""
    rng = np.random.default_rng(0)
    return built(*(random_maze(rng) for _ in range(30)))


@functools.cache
def random_straights() -> Built:
    """Twenty corridors of the training set."""
    rng = np.random.default_rng(0)
    return built(*(random_straight(rng) for _ in range(20)))


def unit(angle: float | Array) -> Array:
    """Unit vectors at angles counter-clockwise from the x axis."""
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def walk(layout: MazeLayout) -> list[tuple[Straight, Array, float]]:
    """The straights of a maze, each with its middle on the map [m] and its heading [rad]."""
    point, heading, straights = np.asarray(layout.start), layout.heading, []
    for segment in layout.segments:
        if isinstance(segment, Straight):
            straights.append((segment, point + 0.5 * segment.length * unit(heading), heading))
            point = point + segment.length * unit(heading)
        elif isinstance(segment, Turn):
            heading += segment.angle
        else:
            depth = math.sqrt(0.25 * segment.diameter**2 - 0.25 * layout.width**2)
            point = point + depth * (unit(heading) + unit(heading + segment.angle))
            heading += segment.angle
    return straights


def line_length(layout: MazeLayout) -> float:
    """Length of a maze's centre line: the straights, and the discs from entrance to exit [m]."""
    discs = [part.diameter for part in layout.segments if isinstance(part, Disc)]
    straights = [part.length for part in layout.segments if isinstance(part, Straight)]
    return sum(straights) + sum(math.sqrt(diameter**2 - layout.width**2) for diameter in discs)


def along(corridor: Corridor, count: int = 6) -> tuple[Array, Array, Array]:
    """Points of a centre line away from its corners: ``(N, 3)`` points, their ``(N,)`` headings and pieces."""
    share = (np.arange(count) + 0.5) / count
    begin, edge = corridor.centre[:-1, None], np.diff(corridor.centre, axis=0)[:, None]
    heading = np.arctan2(edge[..., 1], edge[..., 0])
    points = (begin + share[:, None] * edge).reshape(-1, 3)
    return points, np.repeat(heading, count), np.repeat(np.arange(len(edge)), count)


def gaps(points: Array, faces: tuple[Face, ...]) -> Array:
    """``(N, F)`` distances on the map from points to walls [m]."""
    begin, end = (np.asarray([face[i] for face in faces]) for i in (0, 1))
    edge = end - begin
    share = ((points[:, None, :2] - begin) * edge).sum(-1) / (edge**2).sum(-1)
    return np.linalg.norm(points[:, None, :2] - begin - share.clip(0, 1)[..., None] * edge, axis=-1)


def seen(point: Array, angle: float | Array, begin: Array, end: Array) -> Array:
    """Distance along rays from a point to the nearest of ``(F, 2)`` lines on the map; infinite if there is none [m]."""
    ray, edge, to = np.atleast_2d(unit(angle))[:, None], end - begin, begin - point[:2]
    cross = ray[..., 0] * edge[:, 1] - ray[..., 1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (to[:, 0] * edge[:, 1] - to[:, 1] * edge[:, 0]) / cross
        share = (to[:, 0] * ray[..., 1] - to[:, 1] * ray[..., 0]) / cross
    met = (np.abs(cross) > 1e-12) & (distance >= 0) & (share >= -1e-9) & (share <= 1 + 1e-9)
    return np.where(met, distance, np.inf).min(-1)


def seen_walls(point: Array, angle: float | Array, corridor: Corridor) -> Array:
    """Distance from a point to the wall at each angle; infinite where there is none [m]."""
    return seen(point, angle, *(np.asarray([face[i] for face in corridor.faces]) for i in (0, 1)))


def open_end(corridor: Corridor) -> tuple[Array, Array]:
    """The line from wall to wall at a maze's end, ``(1, 2)`` each."""
    ends = [[face.end for face in corridor.faces[1:] if face.outward == side][-1] for side in (1.0, -1.0)]
    return ends[0][None], ends[1][None]


def height_on(floors: tuple[Floor, ...], points: Array) -> Array:
    """``(N,)`` heights of the highest floor at points on the map; minus infinity where there is none [m]."""
    highest = np.full(len(points), -np.inf)
    for floor in floors:
        length = np.linalg.norm(floor.end - floor.begin)
        along, off = (floor.end - floor.begin) / length, points - floor.begin[:2]
        run = np.linalg.norm(along[:2])
        ahead, aside = off @ along[:2] / run**2, (along[0] * off[:, 1] - along[1] * off[:, 0]) / run
        on = (ahead >= -floor.over_begin - 1e-9) & (ahead <= length + floor.over_end + 1e-9)
        height = np.where(on & (np.abs(aside) <= floor.half_width), floor.begin[2] + ahead * along[2], -np.inf)
        highest = np.maximum(highest, height)
    return highest


def travelled(centre: Array) -> Array:
    """``(P,)`` distances along a centre line from its first corner to each [m]."""
    return np.concatenate([[0.0], np.linalg.norm(np.diff(centre[:, :2], axis=0), axis=1).cumsum()])


def layouts_of(env: PandaMazeEnv) -> list[MazeLayout]:
    """The present mazes of a batch of environments."""
    return [layout for layout in env.layouts if layout is not None]


def put_tool(env: PandaMazeEnv, row: int, position: Array) -> None:
    """Move the upright tool of one environment behind its back; the tool is at rest afterwards."""
    pose = torch.tensor([[*position, *env.start_pose[3:]]], dtype=torch.float64)
    write_state(env, row, slice(1, 8), env._arm_position(pose)[0].numpy())
    write_state(env, row, slice(8, 15), 0.0)  # the velocities


def drag(env: PandaMazeEnv, speed: float, depth: list[float], seconds: float) -> TensorDict:
    """Observations while tools are dragged along their centre lines, until all episodes are over.

    Args:
        env: the maze environment.
        speed: on the map [m/s].
        depth: of each reference below the floor [m].
        seconds: the longest time.

    Returns:
        The reset and all steps, ``(T, num_envs)``.
    """
    controller = CartesianImpedanceController((250.0,) * 3 + (30.0,) * 3, 1.0)
    chain = impedance_chain(env, controller, posture_stiffness=2.0)
    run = [chain.reset().set("reward", torch.zeros(env.num_envs, 1, dtype=env.dtype))]
    lines = [build_corridor(layout).centre for layout in layouts_of(env)]
    done = float(run[0]["progress"].min()) * travelled(lines[0])[-1]
    for _ in range(round(seconds / env.control_dt)):
        done += speed * env.control_dt
        reference = np.zeros((env.num_envs, 13))
        for row, line in enumerate(lines):
            at, edges = travelled(line), np.diff(line, axis=0)
            piece = min(int(np.searchsorted(at, done, "right")), len(edges)) - 1
            slope = edges[piece] / (at[piece + 1] - at[piece])  # per metre on the map
            position = line[piece] + (done - at[piece]) * slope - [0.0, 0.0, depth[row]]
            reference[row] = [*position, *env.start_pose[3:], *(speed * slope), 0.0, 0.0, 0.0]
        run.append(act(chain, run[-1], torch.tensor(reference, dtype=env.dtype)))
        if run[-1]["done"].all():
            break
    return torch.stack([step.select(*run[0].keys()) for step in run])


class RayScene:
    """Casts rays in the model of one environment.

    Args:
        env: the maze environment.
        row: index of the environment.
    """

    def __init__(self, env: PandaMazeEnv, row: int) -> None:
        self.model = model_of(env, row)
        names = [self.model.geom(i).name for i in range(self.model.ngeom)]
        self.model.geom_group[:] = [1 if n.startswith("wall") else 2 if n.startswith("floor") else 0 for n in names]
        self.data = forwarded(self.model, env.engine.state(row))

    def wall(self, point: Array, angle: float) -> float:
        """Distance from a point to the wall at an angle [m]; infinite where there is none."""
        return self._cast(point, np.asarray([*unit(angle), 0.0]), 1)

    def floor(self, point: Array) -> float:
        """Height of the floor under a point [m]; minus infinity where there is none."""
        return float(point[2]) - self._cast(point, np.asarray([0.0, 0.0, -1.0]), 2)

    def _cast(self, point: Array, direction: Array, group: int) -> float:
        groups = np.asarray([index == group for index in range(6)], dtype=np.uint8)
        found = np.zeros(1, dtype=np.int32)
        distance = mujoco.mj_ray(self.model, self.data, point, direction, groups, 1, -1, found)
        return math.inf if found[0] < 0 else float(distance)

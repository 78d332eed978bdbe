"""Wiping: the paddle passes along a line with a wanted normal force, on a board whose height is only roughly known."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.envs import ArmEnv
from ppt_rl.envs.episodes import Episodes
from ppt_rl.envs.models import table_scene
from ppt_rl.envs.physics import Parameter
from ppt_rl.envs.rewards import reward_spec, total_reward, work_penalty, zero_rewards
from ppt_rl.envs.specs import SpecMaker

#: Ranges of what is drawn for each episode, uniformly; the last two are hidden from the policy.
RANGES = {
    "begin_x": (0.40, 0.46),  # of the line [m]
    "begin_y": (-0.12, 0.12),  # [m]
    "length": (0.15, 0.20),  # [m]
    "direction": (-0.6, 0.6),  # of the line in the plane [rad]
    "wanted_force": (5.0, 10.0),  # normal force on the board [N]
    "height": (-0.008, 0.008),  # of the board's top above where the robot believes it to be [m]
    "friction": (0.1, 0.5),  # sliding friction of the paddle on the board [-]
}
#: The line is wiped where the force is this close to the wanted one [N] and the paddle this close to the line [m].
FORCE_BAND, PATH_BAND = 1.5, 0.01
#: Share of the line that must be wiped for success [-].
WIPED_SHARE = 0.9
#: Believed height of the board's top [m], and stiffness by which the reference turns a force into a depth [N/m].
BOARD, STIFFNESS = 0.02, 400.0
#: The paddle lands this far before the line and leaves it this far behind, so that it moves on all of it [m].
_RUN_UP = 0.015
#: Phases of the via-points (above the landing, landing, end), and their standard deviation [m].
_VIA_PHASE, _VIA_STD = (0.0, 0.35, 0.96), 1e-3
#: Contact of a felt-like pad: soft enough to land and to glide without hopping (MuJoCo's ``solref`` and ``solimp``).
_SOLREF, _SOLIMP = (0.05, 1.0), (0.0, 0.95, 0.004)
_GROUPS = ("progress", "force", "path", "power")


class WipeEpisodes(Episodes):
    """What was drawn for each environment, and how far it has wiped."""

    def _allocate(self) -> None:
        self.drawn = self.zeros(len(RANGES))
        self.begin, self.along, self.via_position = self.zeros(2), self.zeros(2), self.zeros(3, 3)
        self.front, self.wiped = self.zeros(1), self.zeros(1)  # shares of the line: reached, wiped
        self.via_phase = self.zeros(3) + torch.tensor(_VIA_PHASE, dtype=self.dtype, device=self.device)
        self.via_cov = self.zeros(3, 3, 3) + _VIA_STD**2 * torch.eye(3, dtype=self.dtype, device=self.device)

    def __getattr__(self, name: str) -> Tensor:
        """A drawn quantity, ``(num_envs, 1)``."""
        if name not in RANGES:
            raise AttributeError(name)
        column = list(RANGES).index(name)
        return self.drawn[:, column : column + 1]


class WipeEnv(ArmEnv):
    """Wipe along a line on a board while pressing on it with a wanted force.

    The reference presses by its depth under the believed board, so a board that is higher or lower gets too much or too
    little force: the policy must feel it and correct. Success: at least 90 % of the line was wiped within 1.5 N of the
    wanted force. The observations are those of :class:`ArmEnv` and

    * ``line`` 4 [m]: its begin and end (x, y); ``wanted_force`` 1 [N]: constant in an episode;
    * ``board`` 2: error of the believed height [m] and friction [-]; privileged, for critics;
    * ``via_phase`` 3, ``via_position`` (3, 3), ``via_cov`` (3, 3, 3): via-points (x, y, z) of the reference;
    * ``progress`` 1: share of the line that is wiped; ``success`` 1 (bool); ``reward_terms``.
    """

    horizon_terminates = True
    _written = ("body_pos", "pair_friction")
    start_pose = (0.40, 0.0, BOARD + 0.018, 0.0, 1.0, 0.0, 0.0)

    def _scene(self) -> Any:
        root = table_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt)
        board = root.worldbody.add("body", name="board", pos=[0, 0, BOARD])
        board.add("geom", name="board", type="plane", size=[1, 1, 0.1], contype=4, conaffinity=0, group=4)
        looks: dict[str, Any] = {"type": "box", "conaffinity": 0, "group": 2}
        size, white, red = [0.22, 0.32, 0.5 * BOARD], [0.93, 0.95, 0.97, 1], [0.8, 0.16, 0.16, 1]
        board.add("geom", pos=[0.52, 0, -0.5 * BOARD], size=size, rgba=white, contype=0, **looks)
        # With a contact type (to which nothing answers) the line stays in the physics' model, where it is written.
        board.add("geom", name="line", pos=[0.5, 0, 2e-4], size=[0.1, 0.005, 2e-4], rgba=red, contype=8, **looks)
        root.contact.add(
            "pair", geom1="bar", geom2="board", condim=3, friction=[0.3, 0.3, 0, 0, 0], solref=_SOLREF, solimp=_SOLIMP
        )
        return root

    def _prepare(self, model: Any) -> None:
        self._episode = WipeEpisodes(self.num_envs, self.dtype, self.place)

    def _begin(self, rows: Tensor) -> Tensor:
        episode = self._episode
        low, high = torch.tensor(list(RANGES.values()), dtype=torch.float64, device=self.place).T
        drawn = low + (high - low) * self._generators.uniform(rows, len(RANGES))
        episode.replace(rows, drawn=drawn, front=0.0, wiped=0.0)
        along = torch.cat([episode.direction.cos(), episode.direction.sin()], -1)
        begin = torch.cat([episode.begin_x, episode.begin_y], -1)
        depth = BOARD + self.tool.half_thickness - episode.wanted_force / STIFFNESS  # of the paddle's centre [m]
        landing, end = begin - _RUN_UP * along, begin + (episode.length + _RUN_UP) * along
        above = torch.full_like(depth, self.start_pose[2])
        via = torch.stack([torch.cat(point, -1) for point in ((landing, above), (landing, depth), (end, depth))], 1)
        episode.replace(rows, begin=begin[rows], along=along[rows], via_position=via[rows])
        self.engine.write(rows, self._episode_parameters())
        pose = self._start_poses(rows)
        return self._arm_position(torch.cat([landing[rows].to(pose), pose[:, 2:]], -1))

    def _episode_parameters(self) -> list[Parameter]:
        top = torch.nn.functional.pad(BOARD + self._episode.height, (2, 0)).unsqueeze(1)  # x and y are 0
        friction = self._episode.friction.expand(-1, 2).unsqueeze(1)
        return [Parameter("body_pos", ("board",), top), Parameter("pair_friction", (), friction)]

    def _write_parameters(self, model: Any, row: int) -> None:
        super()._write_parameters(model, row)
        drawn = dict(zip(RANGES, self._episode.drawn[row].tolist(), strict=True))
        line, half, turn = model.geom("line"), 0.5 * drawn["length"], drawn["direction"]
        line.pos[:2] = drawn["begin_x"] + half * math.cos(turn), drawn["begin_y"] + half * math.sin(turn)
        line.quat[:] = math.cos(0.5 * turn), 0.0, 0.0, math.sin(0.5 * turn)
        line.size[0] = half

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        zeros = zero_rewards(self.num_envs, self.dtype, _GROUPS, device=self.place)
        return self._task_observation(zeros, self._elapsed < 0)

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        episode, wrench = self._episode, observation["wrench"]
        offset = observation["pose"][:, :2] - episode.begin
        reached = (offset * episode.along).sum(-1, keepdim=True) / episode.length
        across = episode.along[:, :1] * offset[:, 1:] - episode.along[:, 1:] * offset[:, :1]  # to the left [m]
        passed = (reached.clamp_max(1.0) - episode.front).clamp_min(0.0)  # share of the line in this control step
        force_error = (-wrench[:, 2:3] - episode.wanted_force).abs() / FORCE_BAND
        path_error = across.abs() / PATH_BAND
        wiped = passed * ((force_error < 1.0) & (path_error < 1.0))
        episode.front, episode.wiped = episode.front + passed, episode.wiped + wiped
        success = ended & (episode.wiped >= WIPED_SHARE)
        # Errors cost where the line is passed: a mean along the line, whatever the speed.
        terms = {
            "progress": wiped + success.to(self.dtype),
            "force": -0.75 * passed * force_error.clamp_max(4.0),
            "path": -0.2 * passed * path_error.clamp_max(4.0),
            "power": work_penalty(0.1, wrench=wrench, twist=observation["twist"], dt=self.control_dt),
        }
        return self._task_observation(terms, success) | {"reward": total_reward(terms)}

    def _task_observation(self, terms: dict[str, Tensor], success: Tensor) -> dict[str, Any]:
        episode = self._episode
        return {
            "line": torch.cat([episode.begin, episode.begin + episode.length * episode.along], -1),
            "wanted_force": episode.wanted_force,
            "board": torch.cat([episode.height, episode.friction], -1),
            "via_phase": episode.via_phase,
            "via_position": episode.via_position,
            "via_cov": episode.via_cov,
            "progress": episode.wiped,
            "success": success,
            "reward_terms": terms,
        }

    def _task_spec(self, make: SpecMaker) -> Composite:
        real, flag = make.real, make.flag
        return make.nest(
            line=real(4), wanted_force=real(1), board=real(2), via_phase=real(3), via_position=real(3, 3),
            via_cov=real(3, 3, 3), progress=real(1), success=flag(), reward_terms=reward_spec(make, _GROUPS),
        )  # fmt: skip

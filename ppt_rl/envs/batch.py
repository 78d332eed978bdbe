"""Environments that step together: the engine, masks, the end of an episode and divergence, whatever is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import EnvBase

from ppt_rl.envs.audit import AuditedPhysics
from ppt_rl.envs.hook_checks import require_observations, require_over, require_positions
from ppt_rl.envs.lifetime import Lifetime
from ppt_rl.envs.limits import require_count, require_device, require_real, require_within
from ppt_rl.envs.models import remove_looks
from ppt_rl.envs.mujoco_imports import mjcf
from ppt_rl.envs.physics import EngineConfig, EngineName, Parameter, make_engine, substeps_per_control_step, write_model
from ppt_rl.envs.rendering import RenderedScenes
from ppt_rl.envs.row_generators import RowGenerators
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.checks import none_true, require_positive
from ppt_rl.functional.constants import constant

__all__ = ["BatchedEnv"]

#: Most environments of a batch: each has a model of its own, of about 100 kB.
_MOST_ENVS = 16_384


class BatchedEnv(Lifetime, RenderedScenes, EnvBase):
    """A batch of simulated scenes, ``batch_locked``. A subclass says what they contain and what is observed.

    An episode is truncated after ``duration`` (or terminated, see ``horizon_terminates``), and at once where the
    physics diverges. A diverged environment keeps its last good readings, so no NaN reaches a collector.

    Every environment has its own random generator, so the episodes of row ``i`` do not depend on the size of the batch.
    To repeat row 817 alone, set ``env.first_row = 817`` on a batch of one, then seed it: ``env.set_seed(0)``.

    A copy (``copy.deepcopy``, ``pickle``) continues like the original; see :class:`~ppt_rl.envs.lifetime.Lifetime`.

    Args:
        num_envs: number of environments.
        duration: episode length [s].
        control_dt: time between actions [s].
        dtype: precision of what the environment returns.
        device: device of what the environment returns.
        engine: options of the physics, or the name of an engine.

    Raises:
        ValueError: if a number is out of range, an argument is of another type, or ``control_dt`` is no multiple of the
            physics' time step.
        ImportError: if the engine is not installed.
    """

    #: Whether the horizon is the end of the task (``terminated``, so that nothing is bootstrapped beyond it) or only
    #: the end of the record (``truncated``).
    horizon_terminates = False
    #: Row of the first environment, whose random numbers it draws; 0 but where one row of a larger batch is repeated.
    first_row = 0
    #: Random stream: environments of different streams draw different numbers from the same seed.
    _stream = 0
    #: Fields of the model that an episode writes, see :meth:`_episode_parameters`.
    _written: tuple[str, ...] = ()
    #: Whether something follows the readings of every substep, and not only those of the last one.
    _every_substep = False

    def __init__(
        self,
        num_envs: int,
        *,
        duration: float,
        control_dt: float,
        dtype: torch.dtype,
        device: torch.device | str,
        engine: EngineConfig | EngineName | None,
    ) -> None:
        num_envs = require_count("num_envs", num_envs, _MOST_ENVS)
        engine = EngineConfig.of(engine)
        super().__init__(device=require_device("device", device), batch_size=torch.Size([num_envs]))
        self.num_envs = num_envs
        self.dtype = require_real("dtype", dtype)
        self.engine_config = engine
        self.control_dt = require_positive("control_dt", control_dt, "s")
        require_within("control_dt", control_dt, (1e-4, 1.0, "s"))
        self.duration = require_positive("duration", duration, "s")
        require_within("duration", duration, (0.0, 3600.0, "s"))
        self.substeps = substeps_per_control_step(control_dt, engine.physics_dt)
        self.horizon = max(1, round(duration / control_dt))

    def _start_engine(self) -> Any:
        """Compile the scene without its looks, start the engine on it and return the compiled model."""
        root = self._scene()
        remove_looks(root)
        model = mjcf.Physics.from_mjcf_model(root).model.ptr
        audit = self.engine_config.audit
        physics = make_engine(
            self.engine_config, model, self.num_envs, self.substeps, self.device, written=self._written,
            every_substep=audit or self._every_substep,
        )  # fmt: skip
        self.engine: Any = AuditedPhysics(physics, model) if audit else physics
        self._positions, self._looked_at = int(model.nq), set[str]()
        #: Where the environment computes: the device of its engine.
        self.place = self.engine.device
        self._sensors = torch.zeros(self.num_envs, model.nsensordata, dtype=self.dtype, device=self.place)
        self._elapsed = torch.zeros(self.num_envs, 1, dtype=torch.int64, device=self.place)
        self._diverged = torch.zeros(self.num_envs, 1, dtype=torch.bool, device=self.place)
        self._open(self.place)
        return model

    # -- hooks, in the order of time ----------------------------------------------------------------------------------

    def _scene(self) -> Any:
        """MJCF of the scene, with looks."""
        raise NotImplementedError

    def _task_spec(self, make: SpecMaker) -> Composite:
        """Specs of the observations that the task adds."""
        return make.nest()

    def _prepare(self, model: Any) -> None:
        """Look up in the compiled model what the task needs of it."""

    def _begin(self, rows: Tensor) -> Tensor:
        """Draw an episode for ``rows``, write its parameters into their models and return ``(R, nq)`` positions."""
        raise NotImplementedError

    def _observation(self) -> dict[str, Any]:
        """Observations ``(num_envs, ...)`` that every task shares, from the present readings."""
        raise NotImplementedError

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        """Observations of the task, ``(num_envs, ...)``, after ``rows`` began an episode."""
        return {}

    def _checked_action(self, action: Tensor, mask: Tensor | None) -> Tensor:
        """The action as the engine takes it, where it computes; only the environments in ``mask`` must be valid."""
        raise NotImplementedError

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        """Observations of the task and ``reward`` after a control step; ``ended`` marks episodes at their horizon."""
        return {"reward": torch.zeros(self.num_envs, 1, dtype=self.dtype, device=self.place)}

    def _task_over(self) -> Tensor | None:
        """``(num_envs, 1)`` True where the task is over before its horizon; None where it never is."""
        return None

    def _episode_parameters(self) -> Sequence[Parameter]:
        """What the episodes write into the models; every field is among ``_written``."""
        return ()

    def _write_parameters(self, model: Any, row: int) -> None:
        """Write the episode's parameters of environment ``row`` into the model of the renderer."""
        write_model(model, self._episode_parameters(), row)

    # -- EnvBase ------------------------------------------------------------------------------------------------------

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        self._require_open()
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            rows = torch.arange(self.num_envs, device=self.place)
        else:
            mask = mask.reshape(self.num_envs).to(self.place)
            rows = mask.nonzero().squeeze(-1)
        if len(rows):
            position = self._begin(rows)
            require_positions(type(self).__name__, position, len(rows), self._positions)
            self._sensors = self._sensors.clone()  # observations are views, so that of earlier ones is left as it is
            self._sensors[rows] = self.engine.reset(rows, position).to(self.dtype)
            self._elapsed[rows] = 0
            self._diverged = self._diverged.index_fill(0, rows, False)
            self._mark_begun(mask)
        observation = self._observation()
        observation |= self._look_at("_task_reset", self._task_reset(rows))
        return self._pack(observation | self._done(self._elapsed >= self.horizon))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._pack(self.plain_step(tensordict))

    @property
    def can_step_plainly(self) -> bool:
        """Whether :meth:`plain_step` does all that a step does: nobody has changed ``_step``, or what it returns."""
        return type(self)._step is BatchedEnv._step and "_step" not in vars(self) and self.device == self.place

    def plain_step(self, root: Any) -> dict[str, Any]:
        """One control step, for those who need no TensorDict of it.

        Args:
            root: has ``action`` and maybe ``_step``, and is read with ``get``.

        Returns:
            What follows by name, ``(num_envs, ...)`` each, those in a nest in a mapping of their own.
        """
        self._require_open()
        mask = root.get("_step", None)
        mask = None if mask is None else mask.reshape(self.num_envs).to(self.place)
        self._require_begun(mask)
        step = self.engine.step(self._checked_action(root.get("action"), mask), mask)
        self._take(step.sensors[:, -1], step.diverged, mask)
        observation = self._observation()
        ended = self._elapsed >= constant(self.horizon, self._elapsed)
        observation |= self._look_at("_task_step", self._task_step(observation, ended))
        if mask is not None:
            self._silence(observation, mask)
        return observation | self._done(ended)

    def _look_at(self, hook: str, observation: dict[str, Any]) -> dict[str, Any]:
        """What a hook of the task returned, whose shapes are compared with its spec the first time."""
        if hook not in self._looked_at:
            require_observations(type(self).__name__, hook, observation, self.observation_spec)
            self._looked_at.add(hook)
        return observation

    def _take(self, sensors: Tensor, diverged: Tensor, mask: Tensor | None) -> None:
        """Take over the readings of a step; what diverged or did not step keeps its own."""
        moved = sensors.to(self.dtype, copy=True)  # the engine reuses its buffer
        if mask is None:
            self._diverged = diverged.unsqueeze(-1)
            self._elapsed += constant(1, self._elapsed)
            kept = self._diverged
        else:
            column = mask.unsqueeze(-1)
            self._diverged = torch.where(column, diverged.unsqueeze(-1), self._diverged)
            self._elapsed += column
            kept = self._diverged | ~column
        self._sensors = moved if none_true(kept) else torch.where(kept, self._sensors, moved)

    @staticmethod
    def _silence(observation: dict[str, Any], mask: Tensor) -> None:
        """Give no reward to environments that did not step."""
        column = mask.unsqueeze(-1)
        observation["reward"] = observation["reward"] * column
        terms = observation.get("reward_terms", {})
        for name, value in terms.items():
            terms[name] = value * column

    def _done(self, ended: Tensor) -> dict[str, Tensor]:
        over = self._task_over()
        terminal = ended if self.horizon_terminates else torch.zeros_like(ended)
        if over is not None:
            require_over(type(self).__name__, over, self.num_envs)
            terminal, ended = terminal | over, ended | over
        done = ended | self._diverged
        terminated = terminal > self._diverged  # and not diverged
        return {"done": done, "terminated": terminated, "truncated": done > terminated}

    def _pack(self, observation: dict[str, Any]) -> TensorDict:
        if self.device != self.place:
            return TensorDict(observation, batch_size=self.batch_size).to(self.device)
        return TensorDict(observation, batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:  # as torchrl's environments do, so that torch.manual_seed governs it
            seed = int(torch.empty((), dtype=torch.int64).random_())
        self._generators = RowGenerators(
            seed, self.num_envs, stream=self._stream, first_row=self.first_row, device=self.place
        )

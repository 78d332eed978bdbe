"""Engines that step a batch of models, behind one interface: :class:`PhysicsEngine`."""

from ppt_rl.envs.physics.base import PhysicsEngine, PhysicsStep, substeps_per_control_step
from ppt_rl.envs.physics.config import EngineConfig, EngineName
from ppt_rl.envs.physics.make import make_engine
from ppt_rl.envs.physics.parameters import Parameter, write_model
from ppt_rl.envs.physics.threads import ThreadedPhysics
from ppt_rl.envs.physics.warp import WarpPhysics

__all__ = [
    "EngineConfig", "EngineName", "Parameter", "PhysicsEngine", "PhysicsStep", "ThreadedPhysics", "WarpPhysics",
    "make_engine", "substeps_per_control_step", "write_model",
]  # fmt: skip

"""Engines that step a batch of models, behind one interface: :class:`PhysicsEngine`."""

from ppt_rl.envs.physics.base import PhysicsEngine, PhysicsStep, substeps_per_control_step
from ppt_rl.envs.physics.config import EngineConfig
from ppt_rl.envs.physics.threads import ThreadedPhysics

__all__ = ["EngineConfig", "PhysicsEngine", "PhysicsStep", "ThreadedPhysics", "substeps_per_control_step"]

"""Modules with parameters: movement primitive, impedance controller, kinematics, actor, critic and multiplier."""

from ppt_rl.modules.actor_critic import Mirror, make_actor, make_critic, update_input_norm
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.modules.joint_space import JointSpace
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.modules.lagrangian import PIDMultiplier
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace

__all__ = [
    "CartesianImpedanceController",
    "JointSpace",
    "Kinematics",
    "Mirror",
    "PIDMultiplier",
    "ProMP",
    "TaskSpace",
    "make_actor",
    "make_critic",
    "update_input_norm",
]

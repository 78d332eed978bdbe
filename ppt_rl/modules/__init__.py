"""Modules with parameters: movement primitive, impedance controller, kinematics, actor and critic."""

from ppt_rl.modules.actor_critic import Mirror, make_actor, make_critic
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.modules.joint_space import JointSpace
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.modules.promp import ProMP
from ppt_rl.modules.task_space import TaskSpace

__all__ = [
    "CartesianImpedanceController",
    "JointSpace",
    "Kinematics",
    "Mirror",
    "ProMP",
    "TaskSpace",
    "make_actor",
    "make_critic",
]

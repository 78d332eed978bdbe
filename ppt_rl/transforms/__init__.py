"""The stages of the method as TorchRL transforms.

Those that work with time take the control step from the attribute ``control_dt`` [s] of the environment. Every
environment of this library has it; where another has not, pass ``dt=``.
"""

from ppt_rl.transforms.action_map import ActionMapTransform
from ppt_rl.transforms.barrier import BarrierTransform
from ppt_rl.transforms.cartesian_velocity import CartesianVelocityTransform
from ppt_rl.transforms.contact_via_point import ContactViaPointTransform
from ppt_rl.transforms.energy_aware_impedance import EnergyAwareImpedanceTransform
from ppt_rl.transforms.energy_budget import EnergyBudgetTransform
from ppt_rl.transforms.energy_penalty import EnergyPenaltyTransform
from ppt_rl.transforms.energy_tank import EnergyTankTransform
from ppt_rl.transforms.episode_metrics import EpisodeMetricsTransform
from ppt_rl.transforms.heading_frame import HeadingFrameTransform
from ppt_rl.transforms.hold_action import HoldActionTransform
from ppt_rl.transforms.impedance import ImpedanceTransform
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from ppt_rl.transforms.macro_step import MacroStepTransform
from ppt_rl.transforms.motion_memory import MotionMemoryTransform
from ppt_rl.transforms.pd_tracking import PDTrackingTransform
from ppt_rl.transforms.power_limit import PowerLimitTransform
from ppt_rl.transforms.promp import ProMPTransform
from ppt_rl.transforms.receding_promp import RecedingKeys, RecedingProMPTransform
from ppt_rl.transforms.reference_governor import ReferenceGovernorTransform
from ppt_rl.transforms.reference_velocity import ReferenceVelocityTransform
from ppt_rl.transforms.via_point import ViaPointTransform

__all__ = [
    "ActionMapTransform",
    "BarrierTransform",
    "CartesianVelocityTransform",
    "ContactViaPointTransform",
    "EnergyAwareImpedanceTransform",
    "EnergyBudgetTransform",
    "EnergyPenaltyTransform",
    "EnergyTankTransform",
    "EpisodeMetricsTransform",
    "HeadingFrameTransform",
    "HoldActionTransform",
    "ImpedanceTransform",
    "JointTorqueTransform",
    "MacroStepTransform",
    "MotionMemoryTransform",
    "PDTrackingTransform",
    "PowerLimitTransform",
    "ProMPTransform",
    "RecedingKeys",
    "RecedingProMPTransform",
    "ReferenceGovernorTransform",
    "ReferenceVelocityTransform",
    "ViaPointTransform",
]

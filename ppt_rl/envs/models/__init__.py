"""MJCF models of an arm, its tools and the table, composed with ``dm_control.mjcf`` from numbers alone."""

from ppt_rl.envs.models.arm import CYLINDER, PADDLE, Tool, arm_model, attach_tool, remove_looks
from ppt_rl.envs.models.table import table_scene

__all__ = ["CYLINDER", "PADDLE", "Tool", "arm_model", "attach_tool", "remove_looks", "table_scene"]

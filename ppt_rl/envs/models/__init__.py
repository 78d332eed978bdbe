"""MJCF models, composed with ``dm_control.mjcf``. No file is read and no mesh is needed."""

from ppt_rl.envs.models.panda import PADDLE, Tool, attach_tool, panda_model, remove_visual_geoms
from ppt_rl.envs.models.push_scene import PUSH_BOX, push_scene, table_scene

__all__ = [
    "PADDLE",
    "PUSH_BOX",
    "Tool",
    "attach_tool",
    "panda_model",
    "push_scene",
    "remove_visual_geoms",
    "table_scene",
]

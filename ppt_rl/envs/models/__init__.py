"""MJCF models, composed with ``dm_control.mjcf``. No file is read and no mesh is needed."""

from ppt_rl.envs.models.maze_geometry import WALL_HEIGHT, Corridor, build_corridor, check_corridor
from ppt_rl.envs.models.maze_layout import Disc, MazeLayout, Segment, Straight, Turn, paper_layout
from ppt_rl.envs.models.maze_random import MazeRanges, StraightRanges, random_maze, random_straight
from ppt_rl.envs.models.maze_scene import check_pieces, maze_scene, write_corridor
from ppt_rl.envs.models.panda import CYLINDER, PADDLE, Tool, attach_tool, panda_model, remove_visual_geoms
from ppt_rl.envs.models.push_scene import PUSH_BOX, push_scene, table_scene

__all__ = [
    "CYLINDER",
    "PADDLE",
    "PUSH_BOX",
    "WALL_HEIGHT",
    "Corridor",
    "Disc",
    "MazeLayout",
    "MazeRanges",
    "Segment",
    "Straight",
    "StraightRanges",
    "Tool",
    "Turn",
    "attach_tool",
    "build_corridor",
    "check_corridor",
    "check_pieces",
    "maze_scene",
    "panda_model",
    "paper_layout",
    "push_scene",
    "random_maze",
    "random_straight",
    "remove_visual_geoms",
    "table_scene",
    "write_corridor",
]

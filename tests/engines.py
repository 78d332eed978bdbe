"""Physics options that several test files use."""

from ppt_rl.envs import EngineConfig

#: The physics of the tasks, on one thread.
ONE_THREAD = EngineConfig(num_threads=1)
#: A time step four times as long, for tests that do not look at contact closely.
COARSE = EngineConfig(physics_dt=0.002, num_threads=1)

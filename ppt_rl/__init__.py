"""Contact-safe reinforcement learning in TorchRL: ProMPs, PPO and an energy tank on a simulated Panda."""

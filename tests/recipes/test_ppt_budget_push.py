"""The recipe whose policy asks for its energy: bounds on the simulated arm, whatever the policy puts out."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torchrl.envs import EnvBase

from ppt_rl.evaluation import evaluate, load_policy
from ppt_rl.recipes.ppo_ppt_budget_push import RECIPE, Config
from ppt_rl.training import PPOConfig
from ppt_rl.training.logs import read_scalar

NUM, STEPS = 4, 20  # environments, and control steps of an episode


def tiny(run_dir: Path = Path("unused"), **changes: object) -> Config:
    ppo = PPOConfig(total_control_steps=2 * NUM * STEPS, epochs=2, minibatches=2)
    settings = {"num_envs": NUM, "num_threads": 1, "duration": 0.2, "physics_dt": 0.002, "num_basis": 4, "ppo": ppo}
    return Config(run_dir=run_dir, **{**settings, **changes})


def make_env(config: Config, seed: int = 0) -> EnvBase:
    return RECIPE.make_env(config, RECIPE.make_modules(config), num_envs=NUM, seed=seed)


def attack(env: EnvBase, steps: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Work [J] and budgets of an episode in which every number that a policy may write is absurd."""
    td, first = env.reset(), torch.zeros(NUM, 1)
    for step in range(steps):
        action = 30.0 * torch.randn(NUM, env.full_action_spec["action"].shape[-1], generator=generator)
        action[:, -1] = torch.tensor([-1e30, 1e30, 0.0, 3.0])[torch.randperm(NUM, generator=generator)]
        for key in ("e_max", "energy_budget"):
            td[key] = 1e9 * torch.randn(NUM, 1, generator=generator)
        after = env.step(td.set("action", action))["next"]
        first = after["energy_budget"].clone() if step == 0 else first
        assert torch.equal(after["energy_budget"], first)
        assert (after["metrics", "work"] <= first * (1 + 1e-5)).all()
        td = env._step_mdp(td.set("next", after))
    assert bool(after["done"].all())
    return after["metrics", "work"], first


@pytest.mark.parametrize("mode", ["paper", "rate"])
@pytest.mark.parametrize("replan_steps", [0, 5])
def test_no_action_does_more_work_than_was_granted_nor_is_granted_more_than_the_hard_bound(mode, replan_steps):
    config = tiny(e_max=0.02, tank_mode=mode, replan_steps=replan_steps)
    env, generator = make_env(config), torch.Generator().manual_seed(0)
    for _ in range(3):
        work, granted = attack(env, config.batch_steps, generator)
        assert (granted <= 0.02).all()
        assert (granted >= 0.1 * 0.02 * (1 - 1e-6)).all()
        assert (
            work > (0.9 if mode == "paper" else 0.3) * granted
        ).any()  # the attack does work; rate charges the worst case


def test_left_and_right_ask_for_the_same_energy_and_other_episodes_for_another():
    config = tiny()
    env = make_env(config)
    actor, _ = RECIPE.make_policy(config, env)
    with torch.no_grad():
        for parameter in actor.parameters():  # a policy that has learnt something
            parameter.add_(0.05 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1)))
        root = env.reset()
        mirrored = root.clone()
        twist, pose = torch.tensor([1.0, -1, 1, -1, 1, -1]), torch.tensor([1.0, -1, 1, -1, 1, -1, 1])
        for key, signs in {
            "box_start": twist[:2], "goal": twist[:2], "goal_yaw": -twist[:1], "pose": pose, "twist": twist,
            "wrench": twist,
        }.items():  # fmt: skip
            mirrored[key] = signs * mirrored[key]
        one, other = actor(root)["loc"], actor(mirrored)["loc"]
    torch.testing.assert_close(one[:, -1], other[:, -1])
    torch.testing.assert_close(one[:, :4], other[:, :4])  # weights of x
    torch.testing.assert_close(one[:, 4:-1], -other[:, 4:-1])
    assert one[:, -1].unique().numel() == NUM


def test_the_reward_of_training_pays_for_the_budget_and_an_evaluation_keeps_it(tmp_path):
    rewards = []
    for weight in (0.0, 2.0):
        config = tiny(tmp_path / str(weight), budget_weight=weight, validate_every=0)
        policy = load_policy(RECIPE.train(config))
        rewards.append(read_scalar(config.run_dir, "reward")[1][0])
    rows = evaluate(policy, episodes=NUM, seed=5, num_envs=NUM).rows["ppt_budget_push"]["all"]
    assert ((rows["energy_budget"] > 0.13) & (rows["energy_budget"] < 1.3)).all()
    assert (rows["work"] <= rows["energy_budget"] * (1 + 1e-5)).all()
    # The first batch is that of the same untrained policy, which asks for about 1.07 J.
    assert rewards[0] - rewards[1] == pytest.approx(2.0 * 1.07, abs=0.15)

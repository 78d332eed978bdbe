"""A settled account: what the tank pays is at least what the held effort delivered, whatever happens in the step."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from benchmarks import attacks
from ppt_rl.arms import PANDA
from ppt_rl.envs.push import WALL, Obstacle, ObstructedPushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.tasks import damping_key, motor_tank
from ppt_rl.transforms import EnergyTankTransform, ImpedanceTransform, JointTorqueTransform
from tests.engines import ON_THREADS
from tests.transforms.mocks import MockArmEnv


def settled(mode: str = "passive", e_max: float = 1.0, **kwargs) -> EnergyTankTransform:
    return EnergyTankTransform(
        2.0, e_max, mode=mode, flow_key="joint_velocity", position_key="joint_position", **kwargs
    )


@pytest.mark.parametrize("mode", ["passive", "parallel"])
def test_into_a_wall_the_net_energy_delivered_is_at_most_what_the_level_has_lost(mode):
    base = ObstructedPushEnv(8, obstacle=Obstacle((WALL,)), goal="pose", duration=1.2, seed=0, engine=ON_THREADS)
    key, keys = damping_key(mode), ("motor_tank_energy", "motor_valve")
    chain = [
        motor_tank(1.0, 1.0, mode, PANDA),
        JointTorqueTransform(Kinematics(base.arm, base.tool_length), damping_key=key),
        ImpedanceTransform(CartesianImpedanceController(), damping_key=key),
    ]
    env = TransformedEnv(base, Compose(*chain))
    executed, td = attacks._watched(base), env.reset()
    net = torch.zeros(8, 1, dtype=torch.float64)
    heading = torch.as_tensor(base._heading, dtype=torch.float32)
    ahead = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
    rest = td["pose"].clone()
    for step in range(119):
        pose = torch.cat([td["pose"][:, :2], rest[:, 2:]], -1)
        pose[:, :3] += (0.1 if step % 50 < 40 else -0.1) * ahead
        before = td["joint_position"].double()
        td = env._step_mdp(env.step(td.set("action", torch.cat([pose, 0.5 * ahead, 0 * ahead], -1))))
        net += (executed[0].double() * (td["joint_position"].double() - before)).sum(-1, keepdim=True)
        level, debt = td[keys[0]].double(), td["motor_tank_energy_debt"].double()
        assert (net <= 1.0 - level + debt + 1e-4).all()
        assert ((level == 0) | (debt == 0)).all()
    assert (td["peak_force"] > 30).all()
    assert (debt < 0.02).all()


def test_what_the_law_did_not_foresee_is_paid_afterwards_and_a_debt_by_later_income():
    env = TransformedEnv(MockArmEnv((2,)), settled(e_max=0.05))
    check_env_specs(env)
    td = env.reset()
    assert not td["tank_energy_debt"].any()
    net, indebted = torch.zeros(2, 1), False
    for step in range(6):  # its positions move by tenths of a radian, whatever its velocities are
        action = torch.full((2, 7), 3.0 if step < 3 else -3.0)
        position = td["joint_position"].clone()
        td = env._step_mdp(env.step(td.set("action", action)))
        net += (td["executed"] * (td["joint_position"] - position)).sum(-1, keepdim=True)
        assert (net <= 0.05 - td["tank_energy"] + td["tank_energy_debt"] + 1e-5).all()
        assert ((td["tank_energy"] >= 0) & (td["tank_energy"] <= 0.05)).all()
        indebted |= bool((td["tank_energy_debt"] > 0).any())
    assert indebted


def test_the_price_of_the_law_stands_where_it_is_the_larger_one():
    plain, account = EnergyTankTransform(2.0, 1.0, flow_key="joint_velocity"), settled("paper")
    levels = []
    for tank in (plain, account):
        env = TransformedEnv(MockArmEnv((2,)), tank)
        td = env.reset().set("action", torch.zeros(2, 7))
        td["action"][:, 0] = -20.0
        levels.append((env.step(td)["next"], td["joint_position"]))
    after, start = levels[1]
    delivered = (after["executed"] * (after["joint_position"] - start)).sum(-1, keepdim=True)
    paid = [1.0 - level["tank_energy"] for level, _ in levels]
    torch.testing.assert_close(paid[1], torch.maximum(paid[0], delivered), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("honours_step", [True, False])
def test_a_row_that_does_not_step_or_that_resets_keeps_or_loses_its_debt_alone(honours_step):
    base = MockArmEnv((2,), horizons=(12,), honours_step=honours_step)
    env = TransformedEnv(base, settled(e_max=1e-3))
    td, generator = env.reset(), torch.Generator().manual_seed(0)
    for _ in range(6):
        td = env._step_mdp(env.step(td.set("action", 5.0 * torch.randn(2, 7, generator=generator))))
    debt = td["tank_energy_debt"].clone()
    assert (debt > 0).all()
    td["_step"] = torch.tensor([True, False])
    td = env._step_mdp(env.step(td.set("action", -50 * td["joint_velocity"].sign())))
    assert td["tank_energy_debt"][1] == debt[1]
    td = env.reset(td.exclude("_step").set("_reset", torch.tensor([[False], [True]])))
    assert td["tank_energy_debt"][1] == 0.0
    assert td["tank_energy"][1] == pytest.approx(1e-3)


def test_without_an_environment_there_is_nothing_to_settle():
    td = TensorDict({"action": torch.ones(3, 7), "joint_velocity": torch.ones(3, 7)}, [3])
    out = settled(dt=0.01).inv(td)
    assert "tank_energy_debt" not in out.keys()
    assert (out["action"] < 1).all()

"""The guarantee of the tank, attacked: what reaches the motors, whatever the policy and other transforms do."""

from __future__ import annotations

import copy

import pytest
import torch
from torchrl.data import Unbounded
from torchrl.envs import Compose, ObservationNorm, RewardSum, Transform, TransformedEnv, VecNormV2
from torchrl.envs.utils import check_env_specs

from benchmarks import attacks
from ppt_rl.arms import UR5E
from ppt_rl.envs import PandaPushEnv, PushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.tasks import motor_tank
from ppt_rl.transforms import EnergyTankTransform, ImpedanceTransform, JointTorqueTransform, MacroStepTransform
from tests.engines import ONE_THREAD
from tests.transforms.cases import control_chain, make_promp_transform
from tests.transforms.mocks import MockArmEnv, actions_for, play

READINGS = ["twist", "pose", "joint_position", "joint_velocity", "wrench"]


def armed(
    *transforms: Transform, tank: EnergyTankTransform | None = None, num_envs: int = 2, **kwargs
) -> TransformedEnv:
    """The pushing task with a tank at the motors and transforms after it."""
    base = PandaPushEnv(num_envs, duration=0.3, seed=0, engine=ONE_THREAD, **kwargs)
    return TransformedEnv(base, Compose(motor_tank(0.5, 0.05) if tank is None else tank, *transforms))


def controlled(*more: Transform, **kwargs) -> TransformedEnv:
    return armed(*control_chain(), *more, **kwargs)


# -- what is executed --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(attacks.ATTACKS))
def test_an_attack_gets_no_more_executed_than_the_tank_allows(name):
    run = attacks.Config(steps=3200, num_envs=16, threads=1, p_max=1.0, e_max=0.4)
    result = attacks.attack(name, run)
    assert result["power"] <= 1 + 1e-5
    assert result["work"] <= 1 + 1e-5


@pytest.mark.parametrize("name", ["1e10 N m", "perpendicular", "posture 1000 N m/rad"])
@pytest.mark.parametrize(("mode", "most"), [("passive", 1.0), ("parallel", 1.0), ("rate", 1.002), ("impact", 1.002)])
def test_what_an_attack_gets_delivered_in_the_closed_loop_stays_below_what_was_in_the_tank(mode, most, name):
    run = attacks.Config(steps=1600, num_envs=16, threads=1, p_max=1.0, e_max=0.8, mode=mode)
    assert attacks.attack(name, run)["net_energy"] <= most  # only a settled account sees all


@pytest.mark.parametrize("mode", ["passive", "parallel"])
def test_without_an_inertia_an_attack_gets_more_delivered_than_was_in_the_tank(mode, monkeypatch):
    keys = ("motor_tank_energy", "motor_valve")
    read = {"damping_key": "damping"} if mode == "parallel" else {}
    monkeypatch.setattr(
        attacks,
        "motor_tank",
        lambda p_max, e_max, mode, arm: EnergyTankTransform(
            p_max, e_max, mode=mode, flow_key="joint_velocity", out_keys=keys, **read
        ),
    )
    run = attacks.Config(steps=1600, num_envs=16, threads=1, p_max=1.0, e_max=0.8, mode=mode)
    assert attacks.attack("1e10 N m", run)["net_energy"] > 2


@pytest.mark.parametrize("name", sorted(set(attacks.ATTACKS) - {"1e10 N m", "perpendicular"}))
def test_the_same_attack_without_the_tank_exceeds_its_limits(name, monkeypatch):
    monkeypatch.setattr(attacks, "motor_tank", lambda p_max, e_max: motor_tank(1e9, 1e9))
    result = attacks.attack(name, attacks.Config(steps=800, num_envs=16, threads=1, p_max=1.0, e_max=0.4))
    assert result["power"] > 2.0


def test_a_tank_on_the_bare_arm_meters_the_torque_after_the_limits():
    env = armed(tank=EnergyTankTransform(1.0, 3.0))
    executed, td = attacks._watched(env.base_env), env.reset()
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        torque = 1e9 * torch.randn(2, 7, generator=generator)
        velocity = td["joint_velocity"]
        td = env._step_mdp(env.step(td.set("action", torque)))
        power = (executed[0] * velocity).sum(-1, keepdim=True)
        assert (power.abs() <= 1.0).all()
        torch.testing.assert_close(executed[0].float(), td["valve"] * torque, rtol=1e-4, atol=1e-4)


# -- readings of its own -----------------------------------------------------------------------------------------------


def normalisers() -> list[Transform]:
    return [ObservationNorm(3.0, 0.1, in_keys=[key]) for key in READINGS]


@pytest.mark.parametrize("scrambled", [normalisers, lambda: [VecNormV2(in_keys=READINGS)]], ids=["affine", "running"])
def test_normalising_observations_in_place_changes_nothing_of_what_is_executed(scrambled):
    plain, normalised = controlled(), controlled(*scrambled())
    watched = [attacks._watched(env.base_env) for env in (plain, normalised)]
    tds = [env.reset() for env in (plain, normalised)]
    assert not torch.equal(tds[0]["twist"], tds[1]["twist"]) or not torch.equal(tds[0]["pose"], tds[1]["pose"])
    reference = torch.cat([tds[0]["pose"], torch.zeros(2, 6)], -1)
    reference[:, 0] += 0.1
    for _ in range(10):
        tds = [
            env._step_mdp(env.step(td.set("action", reference)))
            for env, td in zip((plain, normalised), tds, strict=True)
        ]
        assert torch.equal(watched[0][0], watched[1][0])
    for key in ("motor_tank_energy", "tank_energy", "power"):
        assert torch.equal(tds[0][key], tds[1][key])


def test_changing_a_reading_in_place_in_the_tensordict_changes_nothing():
    env, other = controlled(), controlled()
    watched = attacks._watched(env.base_env), attacks._watched(other.base_env)
    td, clean = env.reset(), other.reset()
    reference = torch.cat([td["pose"] + 0.0, torch.zeros(2, 6)], -1)
    reference[:, 1] += 0.05
    for key in ("pose", "twist"):
        td[key] = td[key] * 0.0 + 7.0
    env.step(td.set("action", reference))
    other.step(clean.set("action", reference))
    assert torch.equal(watched[0][0], watched[1][0])


# -- level -------------------------------------------------------------------------------------------------------------


def started(env: TransformedEnv, steps: int = 3):
    """A tensordict to step from, after some steps that cost energy, and the one before it."""
    td, before = env.reset(), None
    for _ in range(steps):
        before = td.clone()
        td = env._step_mdp(env.step(td.set("action", torch.full((2, 7), 20.0))))
    return td.set("action", torch.full((2, 7), 20.0)), before.set("action", torch.full((2, 7), 20.0))


def test_a_missing_level_is_an_error_in_an_environment_and_not_a_full_tank():
    env = armed()
    td, _ = started(env)
    with pytest.raises(
        KeyError, match=r"no level 'motor_tank_energy'.*expected the one that reset or the last step returned"
    ):
        env.step(td.select("action", "twist", "joint_velocity"))


@pytest.mark.parametrize("level", [0.06, 1e6, 0.0499])
def test_a_level_that_a_policy_raised_is_refused(level):
    env = armed()
    td, _ = started(env)
    with pytest.raises(ValueError, match=r"level 'motor_tank_energy' in the tensordict is above the tank's own"):
        env.step(td.set("motor_tank_energy", torch.full((2, 1), level)))
    td, _ = started(env)
    td["motor_tank_energy"].fill_(level)
    with pytest.raises(ValueError, match="above the tank's own"):
        env.step(td)


def test_a_lower_level_counts():
    env = armed()
    td, _ = started(env)
    reached = env.step(td.set("motor_tank_energy", torch.zeros(2, 1)))["next"]
    assert not reached["motor_valve"].any()


def test_stepping_again_from_an_old_tensordict_gives_no_energy_back():
    env = armed()
    _, before = started(env)
    with pytest.raises(ValueError, match="above the tank's own"):
        env.step(before)


def test_the_work_of_an_episode_stays_within_the_capacity_of_a_policy_that_tries_every_old_tensordict():
    env = armed()
    executed, td, work = attacks._watched(env.base_env), env.reset(), torch.zeros(2, dtype=torch.float64)
    old = []
    for _ in range(25):
        velocity = env.base_env._observation()["joint_velocity"].double()
        torque = torch.where(velocity < 0, -30.0, 30.0).float()
        for root in [*old[::-3], td]:
            try:
                following = env.step(root.clone().set("action", torque))
            except ValueError:
                continue
            work += 0.01 * (executed[0].double() * velocity).sum(-1).abs()
            td = env._step_mdp(following)
            break
        old.append(td.clone())
    assert work.max() <= 0.05 * (1 + 1e-5)


def test_a_partial_reset_gives_no_energy_back_to_the_other_rows():
    env = armed()
    td, before = started(env)
    mask = torch.tensor([[True], [False]])
    level = td["motor_tank_energy"][1].clone()
    with pytest.raises(ValueError, match="above the tank's own"):
        env.step(env.reset(before.set("_reset", mask)).set("action", torch.zeros(2, 7)))
    reset = env.reset(td.set("_reset", mask))
    torch.testing.assert_close(reset["motor_tank_energy"], torch.stack([torch.tensor([0.05]), level]))
    env.step(reset.set("action", torch.zeros(2, 7)))


def test_without_an_environment_a_level_above_the_capacity_is_refused():
    td = MockArmEnv((2,)).reset().set("action", torch.ones(2, 7)).set("tank_energy", torch.full((2, 1), 9.0))
    with pytest.raises(ValueError, match=r"at most e_max=3\.0 J"):
        EnergyTankTransform(dt=0.01).inv(td)


def test_where_the_whole_state_is_in_the_tensordict_old_ones_may_be_stepped_again():
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform(p_max=0.2, e_max=0.1))
    root = env.reset().set("action", torch.ones(2, 7))
    first = env.step(root.clone())
    env.step(env._step_mdp(first.clone()).set("action", torch.ones(2, 7)))
    torch.testing.assert_close(env.step(root.clone())["next", "tank_energy"], first["next", "tank_energy"])


def test_a_copied_environment_goes_on_with_its_own_memory():
    env = armed()
    td, _ = started(env)
    other = copy.deepcopy(env)
    first = env.step(td.clone())["next"]
    torch.testing.assert_close(other.step(td.clone())["next", "motor_tank_energy"], first["motor_tank_energy"])
    with pytest.raises(ValueError, match="above the tank's own"):
        other.step(td.clone())


# -- place in the chain ------------------------------------------------------------------------------------------------


def test_two_tanks_with_the_same_keys_are_refused_with_the_remedy():
    env = armed(*control_chain(), tank=EnergyTankTransform(flow_key="joint_velocity"))
    with pytest.raises(ValueError, match=r"already writes \['tank_energy', 'valve'\].*Pass other out_keys="):
        env.reset()


def test_a_transform_that_would_overwrite_the_level_is_refused():
    env = armed(ObservationNorm(0.0, 2.0, in_keys=["motor_tank_energy"]))
    with pytest.raises(
        ValueError, match=r"\['ObservationNorm'\] would overwrite the level 'motor_tank_energy'.*out_keys"
    ):
        env.reset()
    env = armed(ObservationNorm(0.0, 2.0, in_keys=["motor_tank_energy"], out_keys=["shown"]), RewardSum())
    assert env.rollout(3)["next", "shown"].shape == (2, 3, 1)


def test_on_an_arm_of_six_joints_the_velocity_has_to_be_named():
    def env(**kwargs):
        base = PushEnv(2, arm=UR5E, duration=0.1, seed=0, engine=ONE_THREAD)
        return TransformedEnv(base, EnergyTankTransform(**kwargs))

    with pytest.raises(ValueError, match=r"both have the size 6 .*Pass flow_key='twist' for a wrench"):
        env().rollout(2)
    check_env_specs(env(flow_key="joint_velocity"))


@pytest.mark.parametrize("basis", [2, 4])
def test_a_chunk_of_weights_with_the_tank_outermost_is_refused_even_if_it_has_the_size_of_a_wrench(basis):
    promp = make_promp_transform()
    chain = [ImpedanceTransform(CartesianImpedanceController()), MacroStepTransform(5), promp]
    base = PandaPushEnv(2, duration=0.1, seed=0, engine=ONE_THREAD)
    torque = JointTorqueTransform(Kinematics(base.arm, base.tool_length))
    env = TransformedEnv(base, Compose(torque, *chain, EnergyTankTransform(flow_key="twist")))
    with pytest.raises(ValueError, match=r"EnergyTankTransform stands after a MacroStepTransform.*append it before"):
        env.reset()


def test_actions_of_less_precision_than_the_observations_work_as_in_gymnasium():
    class Mixed(MockArmEnv):
        def __init__(self) -> None:
            super().__init__((2,), dtype=torch.float64)
            self.action_spec = Unbounded(shape=(2, 7), dtype=torch.float32)
            self.observation_spec["executed"] = Unbounded(shape=(2, 7), dtype=torch.float32)

        def _observe(self, count, offset, push, executed):
            return super()._observe(count, offset, push, executed).set("executed", executed.float())

        def _step(self, tensordict):
            assert tensordict["action"].dtype == torch.float32
            return super()._step(tensordict)

    env = TransformedEnv(Mixed(), EnergyTankTransform(p_max=0.2, e_max=0.1))
    check_env_specs(env)
    steps = play(env, actions_for(env, 5, scale=3.0))
    assert steps["action"].dtype == torch.float32
    assert ((steps["next", "executed"].double() * steps["joint_velocity"]).sum(-1).abs() <= 0.2).all()

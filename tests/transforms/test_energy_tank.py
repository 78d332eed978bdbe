from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import PendulumEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.functional.energy_tank import TANK_LAWS, EnergyTankStep
from ppt_rl.modules import Kinematics
from ppt_rl.transforms import EnergyTankTransform, JointTorqueTransform, MacroStepTransform
from tests.engines import ONE_THREAD
from tests.transforms.cases import push_env
from tests.transforms.mocks import MockArmEnv, NestedEffortEnv, actions_for, play

NESTED = {
    "effort_key": ("agent", "action"),
    "flow_key": ("agent", "twist"),
    "out_keys": (("agent", "tank_energy"), ("agent", "valve")),
}


def test_the_default_tank_limits_the_joint_power_of_the_simulated_arm():
    env = TransformedEnv(PandaPushEnv(num_envs=4, duration=0.1, seed=0, engine=ONE_THREAD), EnergyTankTransform())
    check_env_specs(env)
    steps = play(env, actions_for(env, 10, scale=20.0))
    nominal = (steps["action"] * steps["joint_velocity"]).sum(-1, keepdim=True).abs()
    assert (nominal > 2.0).any()
    assert (steps["next", "valve"] * nominal <= 2.0).all()


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)
def test_the_tank_limits_the_torque_on_torchrls_own_pendulum(batch):
    env = TransformedEnv(PendulumEnv(), EnergyTankTransform(p_max=0.5, e_max=0.3, dt=0.05, flow_key="thdot"))
    td = env.reset(TensorDict(batch_size=batch))
    level, spent = td["tank_energy"], torch.zeros(*batch, 1)
    assert level.shape == (*batch, 1)
    for action in 5.0 * torch.randn(30, *batch, 1):
        flow = td["thdot"].unsqueeze(-1)
        td = env.step(td.set("action", action))
        power = td["next", "valve"] * (action * flow).abs()
        spent = spent + 0.05 * power
        assert (power <= 0.5).all()
        td = env._step_mdp(td)
    assert (spent <= level).all()
    torch.testing.assert_close(td["tank_energy"], level - spent, rtol=0, atol=1e-5)


def test_specs_hold_on_torchrls_own_pendulum():
    check_env_specs(TransformedEnv(PendulumEnv(), EnergyTankTransform(flow_key="thdot", dt=0.05)))


def test_without_a_flow_the_error_says_to_pass_flow_key_and_lists_what_there_is():
    env = TransformedEnv(PendulumEnv(), EnergyTankTransform(dt=0.05))
    with pytest.raises(KeyError, match=r"Pass flow_key=.*thdot"):
        env.rollout(1)


def test_a_flow_key_that_is_not_there_is_named_in_the_error():
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform(flow_key="absent"))
    with pytest.raises(KeyError, match="absent"):
        env.rollout(1)


def test_a_flow_of_another_shape_than_the_effort_is_refused():
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform(flow_key="twist"))
    with pytest.raises(ValueError, match="expected the same shape"):
        env.rollout(1)


@pytest.mark.parametrize("name", ["p_max", "e_max", "dt", "eps"])
@pytest.mark.parametrize("value", [-1.0, 0.0, float("nan"), float("inf")])
def test_a_number_out_of_range_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        EnergyTankTransform(**{name: value})


@pytest.mark.parametrize("keys", [(), ("tank_energy",), ("a", "b", "c")])
def test_other_than_two_keys_to_write_are_refused(keys):
    with pytest.raises(ValueError, match="expected two: where the level and the valve are written"):
        EnergyTankTransform(out_keys=keys)


def test_an_unknown_mode_is_refused_with_the_names_of_the_laws(monkeypatch):
    with pytest.raises(
        ValueError, match=r"mode is 'half'; expected one of \['paper', 'passive', 'parallel', 'rate', 'impact'\]"
    ):
        EnergyTankTransform(mode="half")
    monkeypatch.setitem(TANK_LAWS, "half", half)
    with pytest.raises(
        ValueError,
        match=r"mode is 'third'; expected one of \['paper', 'passive', 'parallel', 'rate', 'impact', 'half'\]",
    ):
        EnergyTankTransform(mode="third")


def half(effort, flow, energy, *, p_max, e_max, dt, eps):
    """A law of a user's own: half of the effort passes, at a millijoule a step, as long as there is energy."""
    valve = torch.where(energy > 0, 0.5, 0.0)
    return EnergyTankStep(valve, (energy - 1e-3).clamp_min(0.0), valve * (effort * flow).sum(-1, keepdim=True).abs())


def test_a_law_that_is_registered_by_a_user_acts_through_the_transform(monkeypatch):
    monkeypatch.setitem(TANK_LAWS, "half", half)
    env = TransformedEnv(MockArmEnv((2,), horizons=(8,)), EnergyTankTransform(e_max=5e-3, mode="half"))
    check_env_specs(env)
    steps = play(env, actions_for(env, 8))
    valve = torch.tensor([0.5] * 5 + [0.0] * 3).reshape(1, 8, 1)
    assert torch.equal(steps["next", "executed"], valve * steps["action"])
    level = (5e-3 - 1e-3 * torch.arange(1, 9)).clamp_min(0.0).reshape(1, 8, 1).expand(2, 8, 1)
    torch.testing.assert_close(steps["next", "tank_energy"], level, rtol=0, atol=1e-6)


def test_the_transform_gives_the_law_all_of_its_numbers(monkeypatch):
    seen = []

    def law(effort, flow, energy, **numbers):
        seen.append(numbers)
        return half(effort, flow, energy, **numbers)

    monkeypatch.setitem(TANK_LAWS, "watched", law)
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform(1.5, 2.5, mode="watched", eps=1e-4))
    play(env, actions_for(env, 1))
    assert seen == [{"p_max": 1.5, "e_max": 2.5, "dt": 0.01, "eps": 1e-4}]


def _returning(*parts):
    return lambda effort, flow, energy, *, p_max, e_max, dt, eps: EnergyTankStep(
        *(part(effort, energy) for part in parts)
    )


def _one(effort, energy):
    return torch.ones_like(energy)


#: Faulty laws, and what the error says of each.
FAULTY = {
    "a tuple": (
        lambda effort, flow, energy, *, p_max, e_max, dt, eps: (energy, energy, energy),
        r"returned tuple; expected an Ene",
    ),
    "a flat valve": (_returning(lambda f, e: e[..., 0], _one, _one), r"valve of shape \(7,\); expected \(7, 1\)"),
    "a valve for each joint": (_returning(lambda f, e: f, _one, _one), r"valve of shape \(7, 7\); expected \(7, 1\)"),
    "a valve of two": (_returning(lambda f, e: e + 2, _one, _one), r"a valve outside of \[0, 1\]"),
    "a valve that is no number": (_returning(lambda f, e: e * torch.nan, _one, _one), r"a valve outside of \[0, 1\]"),
    "a level above the capacity": (_returning(_one, lambda f, e: e + 60, _one), r"a level outside of \[0, 3.0\] J"),
}


@pytest.mark.parametrize("fault", sorted(FAULTY))
def test_a_faulty_law_is_refused_by_name(fault, monkeypatch):
    law, message = FAULTY[fault]
    monkeypatch.setitem(TANK_LAWS, "faulty", law)
    env = TransformedEnv(MockArmEnv((7,)), EnergyTankTransform(2.0, 3.0, mode="faulty"))  # as many rows as joints
    with pytest.raises(ValueError, match=rf"the law mode='faulty' returned .*{message.removeprefix('returned ')}"):
        env.step(env.reset().set("action", torch.ones(7, 7)))


def test_a_law_that_cannot_be_called_is_refused_before_it_is_used(monkeypatch):
    monkeypatch.setitem(TANK_LAWS, "warm", lambda effort, flow, energy, *, p_max, e_max, dt, eps, temperature: None)
    with pytest.raises(ValueError, match=r"mode='warm' cannot be called .*'temperature'.*damping, inertia and stored"):
        EnergyTankTransform(mode="warm")
    monkeypatch.setitem(TANK_LAWS, "short", lambda effort, flow, energy, *, p_max, e_max, dt: None)
    with pytest.raises(ValueError, match=r"mode='short' cannot be called as law\(effort, flow, energy.*'eps'"):
        EnergyTankTransform(mode="short")


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_effort_that_is_not_finite_is_refused(bad):
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform())
    td = env.reset()
    td["action"] = torch.zeros(2, 7)
    td["action"][0, 3] = bad
    with pytest.raises(ValueError, match="holds 1 NaN or infinite"):
        env.step(td)


@pytest.mark.parametrize("effort", ["wrench", "torque"])
@pytest.mark.parametrize(("p_max", "e_max"), [(2.0, 3.0), (0.5, 0.02)])
def test_adversarial_efforts_keep_power_and_work_within_the_budget_on_the_simulated_arm(effort, p_max, e_max):
    tank = EnergyTankTransform(p_max=p_max, e_max=e_max)
    chain = [JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)), tank] if effort == "wrench" else [tank]
    env = push_env(3, *chain, duration=0.6)
    size, scale = (6, 200.0) if effort == "wrench" else (7, 100.0)
    flow_key = "twist" if effort == "wrench" else "joint_velocity"
    actions = torch.empty(59, 3, size).uniform_(-scale, scale, generator=torch.Generator().manual_seed(5))
    steps = play(env, actions)
    nominal = (steps["action"] * steps[flow_key]).sum(-1, keepdim=True).abs()
    power = steps["next", "valve"] * nominal
    assert (nominal > 5 * p_max).any()
    assert (power <= p_max).all()
    assert (0.01 * power.double().sum(1) <= e_max).all()
    assert (steps["next", "valve"] >= 0).all()
    assert (steps["next", "valve"] <= 1).all()
    level = e_max - 0.01 * power.double().cumsum(1)
    torch.testing.assert_close(steps["next", "tank_energy"].double(), level, rtol=0, atol=1e-4)
    if effort == "wrench":
        torch.testing.assert_close(steps["next", "power"].abs(), power, rtol=1e-4, atol=1e-5)


def test_the_environment_executes_valve_times_effort():
    env = TransformedEnv(MockArmEnv((2,)), EnergyTankTransform(p_max=0.2, e_max=0.01))
    steps = play(env, actions_for(env, 5))
    assert (steps["next", "valve"] < 1).any()
    assert torch.equal(steps["next", "executed"], steps["next", "valve"] * steps["action"])


def test_an_episode_begins_with_a_full_tank_and_an_open_valve():
    env = TransformedEnv(MockArmEnv((2,), horizons=(3,)), EnergyTankTransform(p_max=0.2, e_max=0.4))
    steps = play(env, actions_for(env, 5))
    assert torch.equal(steps["tank_energy"][:, [0, 3]], torch.full((2, 2, 1), 0.4))
    assert torch.equal(steps["valve"][:, [0, 3]], torch.ones(2, 2, 1))
    assert (steps["tank_energy"][:, [1, 2, 4]] < 0.4).all()


@pytest.mark.parametrize("agents", [(), (3,)], ids=str)
@pytest.mark.parametrize("batch", [(), (2,)], ids=str)
def test_nested_keys_limit_every_agent_by_its_own_tank(batch, agents):
    env = TransformedEnv(NestedEffortEnv(batch, agents), EnergyTankTransform(p_max=0.3, e_max=0.01, **NESTED))
    check_env_specs(env)
    steps = play(env, actions_for(env, 8, scale=3.0))
    nominal = (steps["agent", "action"] * steps["agent", "twist"]).sum(-1, keepdim=True).abs()
    power = steps["next", "agent", "valve"] * nominal
    assert power.shape == (*batch, 8, *agents, 1)
    assert (power <= 0.3).all()
    assert (0.01 * power.double().sum(len(batch)) <= 0.01).all()


@pytest.mark.parametrize("agents", [(), (3,)], ids=str)
def test_a_partial_reset_refills_only_the_tanks_of_its_rows_under_nested_keys(agents):
    env = TransformedEnv(NestedEffortEnv((3,), agents), EnergyTankTransform(**NESTED))
    td = env.reset()
    for key in (("agent", "tank_energy"), ("agent", "valve")):
        td[key] = torch.full_like(td[key], 0.123)
    td["_reset"] = torch.tensor([[True], [False], [True]])
    reached = env._reset(td)
    ones = torch.ones(2, *agents, 1)
    assert torch.equal(reached["agent", "tank_energy"][[0, 2]], 3.0 * ones)
    assert torch.equal(reached["agent", "valve"][[0, 2]], ones)
    assert torch.equal(reached["agent", "tank_energy"][1], 0.123 * ones[0])
    assert torch.equal(reached["agent", "valve"][1], 0.123 * ones[0])


def test_before_the_macro_step_the_tank_limits_every_control_step_of_a_chunk():
    trace = ["executed", "joint_velocity", "valve", "tank_energy"]
    env = TransformedEnv(MockArmEnv((2,), horizons=(20,)), EnergyTankTransform(p_max=0.2, e_max=3.0))
    env.append_transform(MacroStepTransform(5, trace_keys=trace))
    root = env.reset()
    chunk = actions_for(env, 1, scale=5.0)[0]
    reached = env.step(root.clone().set("action", chunk))["next", "trace"]
    flow = torch.cat([root["joint_velocity"].unsqueeze(1), reached["joint_velocity"][:, :-1]], 1)
    nominal = (chunk * flow).sum(-1, keepdim=True).abs()
    assert (nominal > 0.2).any()
    assert (reached["valve"] * nominal <= 0.2).all()
    assert torch.equal(reached["executed"], reached["valve"] * chunk)
    assert (reached["tank_energy"].diff(dim=1) < 0).all()


@pytest.mark.parametrize("length", [1, 2, 3])
def test_after_the_macro_step_the_tank_refuses_to_act_and_says_where_it_belongs(length):
    env = TransformedEnv(MockArmEnv((2,)), MacroStepTransform(length))
    env.append_transform(EnergyTankTransform())
    with pytest.raises(ValueError, match=r"stands after a MacroStepTransform.*append it before"):
        env.rollout(1)


def test_without_an_environment_a_stored_effort_is_scaled_from_its_stored_level():
    tank = EnergyTankTransform(p_max=1.0, e_max=3.0, dt=0.1)
    base = MockArmEnv((4,))
    td = base.reset().set("action", torch.ones(4, 7)).set("joint_velocity", torch.ones(4, 7))
    torch.testing.assert_close(tank.inv(td)["action"], torch.full((4, 7), 1 / 7))
    td["tank_energy"] = torch.tensor([[0.0], [0.05], [0.2], [3.0]])
    torch.testing.assert_close(tank.inv(td)["action"][:, :1] * 7, torch.tensor([[0.0], [0.5], [1.0], [1.0]]))

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaPushEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics, TaskSpace
from ppt_rl.transforms import CartesianVelocityTransform, ImpedanceTransform, JointTorqueTransform
from tests.engines import COARSE
from tests.transforms.cases import AXES, ORIGIN, push_env
from tests.transforms.mocks import MockArmEnv, ScriptedEnv, play

F64 = torch.float64
DT = 0.01
SPEED = torch.tensor((0.4, 0.25, 1.5)).double()  # as the transform keeps them: in single precision
LEAD = torch.tensor((0.05, 0.02, 0.3)).double()
SPACE = TaskSpace(AXES, ORIGIN)
START = torch.tensor((0.4, -0.1, 0.2), dtype=F64)
LAWS = settings(max_examples=20, deadline=None, derandomize=True)
EXACT = {"rtol": 0, "atol": 1e-12}


def columns(*limits):
    """Six steps of three coordinates, each within its limit."""
    row = st.tuples(*(st.floats(-limit, limit) for limit in limits))
    return st.lists(row, min_size=6, max_size=6).map(lambda rows: torch.tensor(rows, dtype=F64))


ACTIONS = columns(3.0, 3.0, 3.0)
MOVES = columns(0.1, 0.02, 0.4)  # of the tool in one control step: up to 10 m/s, slower than the reference or faster


def make_transform(**kwargs):
    return CartesianVelocityTransform(
        SPACE, **{"max_velocity": SPEED.tolist(), "max_lead": LEAD.tolist(), "dt": DT, **kwargs}
    )


def follow(tool, actions, **kwargs):
    """Steps of an arm whose tool is at ``(T + 1, 3)`` coordinates, whatever the reference, under ``(T, 3)`` actions."""
    env = TransformedEnv(ScriptedEnv(13, pose=SPACE.pose(tool).unsqueeze(0)), make_transform(**kwargs))
    steps = play(env, actions.unsqueeze(1))[0]
    steps["measured"] = SPACE.project(steps["pose"])
    steps["velocity"] = steps["next", "executed"][:, [7, 8, 12]]
    return steps


def moved(moves):
    return torch.cat([START.unsqueeze(0), START + moves.cumsum(0)])


def blocked(steps):
    return START.expand(steps + 1, 3)


# -- laws --------------------------------------------------------------------------------------------------------------


@LAWS
@given(moves=MOVES, actions=ACTIONS)
def test_the_reference_is_never_farther_than_the_lead_from_the_measured_pose(moves, actions):
    steps = follow(moved(moves), actions)
    reference = SPACE.project(steps["next", "executed"][:, :7])
    assert ((reference - steps["measured"]).abs() <= LEAD + 1e-12).all()
    assert_close(reference, steps["next", "reference_position"], **EXACT)


@LAWS
@given(moves=MOVES, actions=ACTIONS)
def test_the_reference_is_the_integrated_one_wherever_that_is_within_the_lead(moves, actions):
    steps = follow(moved(moves), actions)
    wanted = steps["reference_position"] + DT * SPEED * actions.clamp(-1, 1)
    near = (wanted - steps["measured"]).abs() <= LEAD
    reached = steps["next", "reference_position"]
    assert_close(reached[near], wanted[near], **EXACT)
    assert_close((reached - steps["measured"])[~near].abs(), LEAD.expand(6, 3)[~near], **EXACT)


@LAWS
@given(moves=MOVES, actions=ACTIONS)
def test_the_twist_is_that_of_the_reference_within_the_largest_velocity(moves, actions):
    steps = follow(moved(moves), actions)
    executed = steps["next", "executed"]
    motion = (steps["next", "reference_position"] - steps["reference_position"]) / DT
    slow = motion.abs() <= SPEED
    assert (steps["velocity"].abs() <= SPEED).all()
    assert_close(steps["velocity"][slow], motion[slow], rtol=0, atol=1e-10)
    assert_close(steps["velocity"][~slow], (motion.sign() * SPEED)[~slow], **EXACT)
    assert not executed[:, 9:12].any()


@LAWS
@given(actions=ACTIONS)
def test_while_the_tool_is_blocked_the_reference_moves_exactly_by_its_twist(actions):
    steps = follow(blocked(6), 4.0 * actions, max_lead=0.01)
    motion = (steps["next", "reference_position"] - steps["reference_position"]) / DT
    assert_close(steps["velocity"], motion, rtol=0, atol=1e-10)


@LAWS
@given(moves=MOVES, actions=ACTIONS)
def test_an_action_beyond_one_acts_like_one(moves, actions):
    beyond, within = (follow(moved(moves), a)["next", "executed"] for a in (actions, actions.clamp(-1, 1)))
    assert torch.equal(beyond, within)


@LAWS
@given(action=st.tuples(*[st.floats(-1.0, 1.0)] * 3), lag=st.tuples(*[st.floats(-0.015, 0.015)] * 3))
def test_a_constant_action_in_free_motion_is_exactly_a_constant_velocity(action, lag):
    velocity = SPEED * torch.tensor(action, dtype=F64)
    time = DT * torch.arange(13, dtype=F64).unsqueeze(-1)
    tool = START + velocity * time
    tool[1:] -= torch.tensor(lag, dtype=F64)  # a tool that is behind or ahead, within the lead
    steps = follow(tool, torch.tensor(action, dtype=F64).expand(12, 3))
    assert_close(steps["next", "reference_position"], START + velocity * time[1:], **EXACT)
    assert_close(steps["velocity"], velocity.expand(12, 3), rtol=0, atol=1e-10)


@LAWS
@given(moves=columns(0.003, 0.003, 0.003))
def test_a_zero_action_keeps_the_reference_at_rest(moves):
    steps = follow(moved(moves), torch.zeros(6, 3, dtype=F64))
    assert_close(steps["next", "reference_position"], START.expand(6, 3), **EXACT)
    assert_close(steps["velocity"], torch.zeros(6, 3, dtype=F64), rtol=0, atol=1e-10)


# -- examples ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("pushing", [25, 60])
def test_before_a_blocked_tool_the_reference_stops_at_the_lead_and_turns_back_at_once(pushing, sign):
    actions = sign * torch.cat([torch.ones(pushing, 3), -torch.ones(1, 3)]).double()
    steps = follow(blocked(pushing + 1), actions)
    ahead = sign * (steps["next", "reference_position"] - START)
    arrival = (LEAD / (DT * SPEED)).ceil().long()
    for axis in range(3):
        stop = int(arrival[axis])
        assert (ahead[: stop - 1, axis].diff() > 0).all()
        assert_close(ahead[stop:pushing, axis], LEAD[axis].expand(pushing - stop), **EXACT)
        assert_close(steps["velocity"][stop:pushing, axis], torch.zeros(pushing - stop, dtype=F64), rtol=0, atol=1e-10)
    assert_close(ahead[-1], LEAD - DT * SPEED, **EXACT)
    assert_close(steps["velocity"][-1], -sign * SPEED, rtol=0, atol=1e-10)


def test_a_tool_pulled_away_takes_the_reference_along_without_a_twist_above_the_largest_velocity():
    pull = torch.tensor((0.2, -0.1, 0.6), dtype=F64)
    steps = follow(moved(pull.expand(2, 3)), torch.zeros(2, 3, dtype=F64))
    assert_close(steps["next", "reference_position"][1], START + pull - pull.sign() * LEAD, **EXACT)
    assert_close(steps["velocity"][1], pull.sign() * SPEED, **EXACT)


@pytest.mark.parametrize("axes", [("y",), ("yaw",), ("z", "x"), ("x", "y")], ids="-".join)
def test_coordinates_outside_the_task_space_stay_at_the_origin_pose_at_rest(axes):
    space = TaskSpace(axes, ORIGIN)
    elsewhere = TaskSpace(("x", "y", "z", "yaw"), ORIGIN).pose(torch.tensor([[[0.5, 0.2, 0.3, 0.4]] * 4] * 2))
    env = TransformedEnv(ScriptedEnv(13, pose=elsewhere), CartesianVelocityTransform(space, dt=DT))
    executed = play(env, torch.ones(3, 2, len(axes)))["next", "executed"]
    numbers = [*(i for i, axis in enumerate("xyz") if axis not in axes), *(() if "yaw" in axes else range(3, 7))]
    assert torch.equal(executed[..., numbers], torch.tensor(ORIGIN)[numbers].expand(2, 3, len(numbers)))
    still = [7 + i for i, axis in enumerate(("x", "y", "z", "roll", "pitch", "yaw")) if axis not in axes]
    assert not executed[..., still].any()
    driven = [i for i in range(7, 13) if i not in still]
    assert_close(executed[..., driven], torch.full((2, 3, len(axes)), 0.4), rtol=0, atol=1e-4)
    assert_close(space.project(executed[:, 0, :7]), space.project(elsewhere[:, 0]) + 0.004, rtol=0, atol=1e-6)


def test_one_number_bounds_every_coordinate():
    actions = torch.ones(30, 3, dtype=F64)
    one, three = (
        follow(blocked(30), actions, max_velocity=v, max_lead=m) for v, m in ((0.3, 0.04), ([0.3] * 3, [0.04] * 3))
    )
    assert torch.equal(one["next", "executed"], three["next", "executed"])
    assert_close(one["velocity"][0], torch.full((3,), 0.3, dtype=F64), rtol=0, atol=1e-7)
    assert_close(one["next", "reference_position"][-1], START + 0.04, rtol=0, atol=1e-7)


def test_the_action_outside_is_a_velocity_between_minus_one_and_one():
    env = TransformedEnv(MockArmEnv((2,), action_shape=(13,)), make_transform())
    assert torch.equal(env.action_spec.space.low, -torch.ones(2, 3))
    assert torch.equal(env.action_spec.space.high, torch.ones(2, 3))


def test_a_partial_reset_starts_the_reference_at_the_measured_pose_only_in_its_rows():
    tool = torch.stack([START + 0.01 * i for i in range(3)]).unsqueeze(1).expand(3, 9, 3)
    env = TransformedEnv(ScriptedEnv(13, pose=SPACE.pose(tool)), make_transform())
    action = torch.tensor((0.5, -0.5, 1.0), dtype=F64).expand(3, 3)
    ahead = DT * SPEED * action[0]
    last = env._step_mdp(play(env, action.expand(4, 3, 3))[:, -1])
    assert_close(last["reference_position"], tool[:, 0] + 4 * ahead, **EXACT)
    last["_reset"] = torch.tensor([[False], [True], [False]])
    own, root = env._reset(last.clone()), env.reset(last.clone())
    following = env.step(root.clone().set("action", action))["next"]
    for row, steps in enumerate((4, 0, 4)):
        assert_close(own["reference_position"][row], tool[row, 0] + steps * ahead, **EXACT)
        assert_close(root["reference_position"][row], tool[row, 0] + steps * ahead, **EXACT)
        assert_close(following["reference_position"][row], tool[row, 0] + (steps + 1) * ahead, **EXACT)


def test_without_an_environment_the_stored_reference_goes_on_and_where_there_is_none_the_measured_pose_does():
    transform = make_transform()
    td = ScriptedEnv(13, pose=SPACE.pose(blocked(1)).unsqueeze(0)).reset()
    td["action"] = torch.tensor([[1.0, -1.0, 0.5]], dtype=F64)
    step = DT * SPEED * td["action"]
    assert_close(SPACE.project(transform.inv(td)["action"][:, :7]), START + step, **EXACT)
    td["reference_position"] = START.unsqueeze(0) + 0.01
    assert_close(SPACE.project(transform.inv(td)["action"][:, :7]), START + 0.01 + step, **EXACT)


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 2, 4, 13])
def test_an_action_of_another_size_than_the_task_space_is_refused_with_both_sizes(size):
    env = TransformedEnv(MockArmEnv((2,), action_shape=(13,)), make_transform())
    with pytest.raises(ValueError, match=rf"velocity\) has shape \(2, {size}\); expected \(\*batch, 3\)"):
        env.step(env.reset().set("action", torch.zeros(2, size)))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_an_action_that_is_not_finite_is_refused(bad):
    env = TransformedEnv(MockArmEnv((2,), action_shape=(13,)), make_transform())
    action = torch.zeros(2, 3)
    action[1, 2] = bad
    with pytest.raises(ValueError, match=r"velocity\) holds 1 NaN or infinite entries of 6 .*expected finite"):
        env.step(env.reset().set("action", action))


@pytest.mark.parametrize("name", ["max_velocity", "max_lead"])
@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf"), (), (0.1, 0.2), (0.1, 0.2, 0.0), (0.1,) * 4])
def test_a_bound_that_is_not_positive_or_of_another_size_is_refused_with_what_came(name, value):
    with pytest.raises(ValueError, match=r"expected 1 or 3 positive numbers") as error:
        make_transform(**{name: value})
    assert str(error.value).startswith(f"{name} is {value};")


@pytest.mark.parametrize("dt", [0.0, -0.01, float("nan"), float("inf")])
def test_a_control_step_that_is_not_positive_is_refused_with_what_came(dt):
    with pytest.raises(ValueError, match=rf"dt is {dt}; expected a finite number above 0 s"):
        make_transform(dt=dt)


def test_a_missing_pose_is_named():
    td = MockArmEnv((2,)).reset().exclude("pose").set("action", torch.zeros(2, 3))
    with pytest.raises(KeyError, match=r"CartesianVelocityTransform needs .*pose.* holds .*twist"):
        make_transform().inv(td)


# -- the simulated arm -------------------------------------------------------------------------------------------------


def push_velocity_env():
    return push_env(
        2,
        JointTorqueTransform(Kinematics(PANDA, PandaPushEnv.tool.length)),
        ImpedanceTransform(CartesianImpedanceController()),
        CartesianVelocityTransform(SPACE, max_velocity=0.4),
        duration=0.3,
        engine=COARSE,
    )


def test_a_constant_velocity_moves_the_simulated_tool_by_velocity_times_time():
    steps = play(push_velocity_env(), torch.tensor((0.0, 0.25, 0.0)).expand(30, 2, 3))
    assert steps["next", "done"].flatten(1).tolist() == [[False] * 29 + [True]] * 2
    start, end = SPACE.project(steps["pose"][:, 0]), steps["next"][:, -1]
    assert_close(end["reference_position"], start + torch.tensor((0.0, 0.03, 0.0)), rtol=0, atol=1e-5)
    assert_close(SPACE.project(end["pose"]), end["reference_position"], rtol=0, atol=3e-3)
    assert_close(end["twist"][:, :3], torch.tensor((0.0, 0.1, 0.0)).expand(2, 3), rtol=0, atol=0.01)


def test_specs_hold_on_the_simulated_arm():
    check_env_specs(push_velocity_env())


def test_where_yaw_wraps_round_the_reference_stays_where_it_is():
    space = TaskSpace(("yaw",), ORIGIN)
    transform = CartesianVelocityTransform(space, max_velocity=1.5, max_lead=0.3, dt=DT)
    held, beyond = torch.tensor([[torch.pi - 0.01]]), torch.tensor([[torch.pi + 0.01]])
    tensordict = TensorDict(
        {"action": torch.zeros(1, 1), "pose": space.pose(beyond), "reference_position": held}, batch_size=[1]
    )
    reference = transform.inv(tensordict)["action"]
    assert_close(reference[..., 7:], torch.zeros(1, 6), rtol=0.0, atol=1e-4)
    assert_close((reference[..., 3:7] * space.pose(held)[..., 3:]).sum(-1).abs(), torch.ones(1))

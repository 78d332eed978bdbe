"""Pushing to a pose: yaw, its reward, the offset centre of mass and the error of the known position."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.envs import PushEnv, PushRandomisation, PushReference
from ppt_rl.envs.push.reference import push_via_points
from ppt_rl.envs.push.rewards import PushRewards, pose_arrival, turn
from tests.engines import model_of
from tests.envs.scenes import act, forwarded, put_box, rollout, torques

F64 = torch.float64


def turned(yaw: float) -> tuple[float, float, float, float]:
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def at_goal(env: PushEnv, row: int, yaw: float, distance: float = 0.0) -> None:
    """Put the box of one environment near its goal, turned by ``yaw`` from that of the goal."""
    (x, y), goal_yaw = env._episode.goal[row].tolist(), float(env._episode.goal_yaw[row])
    put_box(env, row, (x - distance, y, float(env._episode.half[row])), turned(goal_yaw + yaw))


# -- success and reward ------------------------------------------------------------------------------------------------


def test_success_needs_the_yaw_as_well_as_the_position():
    env = PushEnv(6, goal="pose", duration=0.01, seed=0)
    observation = env.reset()
    for row, (yaw, distance) in enumerate(
        [(0.0, 0.0), (0.19, 0.0), (-0.19, 0.019), (0.21, 0.0), (-0.21, 0.0), (0.0, 0.03)]
    ):
        at_goal(env, row, yaw, distance)
    assert act(env, observation)["success"].squeeze(-1).tolist() == [True, True, True, False, False, False]


def test_a_goal_for_the_position_does_not_look_at_the_yaw():
    env = PushEnv(1, goal="position", duration=0.01, seed=0)
    observation = env.reset()
    at_goal(env, 0, 1.0)
    following = act(env, observation)
    assert bool(following["success"])
    assert not {"goal_yaw", "yaw_error"} & set(following.keys())


@pytest.mark.parametrize("turns", [0, 1, -1])
def test_the_yaw_error_takes_the_shorter_way_round(turns):
    env = PushEnv(2, goal="pose", seed=0, dtype=F64, randomisation=PushRandomisation(goal_yaw=(3.0, 3.0)))
    observation = env.reset()
    for row, yaw in enumerate((0.5, -0.5)):  # 3.5 rad is beyond half a turn
        at_goal(env, row, yaw + 2 * math.pi * turns)
    assert_close(act(env, observation)["yaw_error"], torch.full((2, 1), 0.5, dtype=F64), atol=1e-3, rtol=0)


def test_turning_towards_the_goal_earns_what_turning_away_costs():
    weights = PushRewards(turn=0.5)
    errors = [torch.tensor([[value]], dtype=F64) for value in (0.6, 0.2, 0.4, 0.1)]
    terms = [turn(weights, error=now, previous=before) for before, now in pairwise(errors)]
    assert_close(sum(terms), torch.tensor([[0.25]], dtype=F64))


def test_the_reward_for_the_pose_is_one_at_the_goal_and_asks_for_both_position_and_yaw():
    def at(distance: float, error: float, ended: bool = True) -> float:
        column = [torch.tensor([[value]], dtype=F64) for value in (distance, error)]
        return float(pose_arrival(PushRewards(), distance=column[0], error=column[1], ended=torch.tensor([[ended]])))

    assert at(0.0, 0.0) == 1.0
    assert at(0.06, 0.2) == pytest.approx(math.exp(-2))
    assert at(0.0, 0.0, ended=False) == 0.0
    assert at(0.3, 0.0) < 0.01


def test_the_rewards_of_an_episode_add_up_to_the_turn_that_was_made():
    """Only the yaw has a weight, and the box is turned by hand between two steps."""
    off = PushRewards(0.0, 0.0, 0.0, turn=2.0, pose=0.0, free_space=0.0, contact=0.0, power=0.0)
    env = PushEnv(1, goal="pose", seed=0, dtype=F64, rewards=off)
    observation = env.reset()
    first = float(observation["yaw_error"])
    at_goal(env, 0, 0.1)
    following = act(env, observation)
    assert float(following["reward"]) == pytest.approx(2 * (first - 0.1), abs=2e-3)


def test_an_observed_yaw_error_does_not_change_when_another_episode_begins():
    env = PushEnv(2, goal="pose", duration=0.02, seed=0)
    following = env.step(env.reset().set("action", torques(env, 1)[:, 0]))["next"]
    before = following["yaw_error"].clone()
    env.reset()
    assert_close(following["yaw_error"], before, atol=0, rtol=0)


# -- what is drawn -----------------------------------------------------------------------------------------------------


def test_the_goal_mark_is_turned_as_the_goal_is():
    env = PushEnv(1, goal="pose", seed=3)
    env.reset()
    quat = env.physics(0).model.ptr.body("goal").quat
    assert 2 * math.atan2(quat[3], quat[0]) == pytest.approx(float(env._episode.goal_yaw[0]), abs=1e-6)


def test_new_ranges_leave_the_first_episode_of_a_seed_as_it_was():
    plain, hard = (
        PushEnv(8, seed=5, randomisation=ranges).reset()
        for ranges in (PushRandomisation(), PushRandomisation(com=(-0.015, 0.015), error=(-0.01, 0.01)))
    )
    assert_close(plain["goal"], hard["goal"], atol=0, rtol=0)
    assert_close(plain["box_pose"], hard["box_pose"], atol=0, rtol=0)


def test_the_known_position_differs_from_the_true_one_by_the_error_in_x_and_in_y():
    env = PushEnv(256, seed=0, randomisation=PushRandomisation(error=(-0.01, 0.01)))
    reset = env.reset()
    error = reset["box_start"] - reset["box_pose"][:, :2]
    assert float(error.abs().max()) <= 0.01 + 1e-5
    assert_close(error.std(0), torch.full((2,), 0.02 / math.sqrt(12)), atol=8e-4, rtol=0)
    assert abs(float(torch.corrcoef(error.T)[0, 1])) < 0.2


def test_an_offset_moves_the_centre_of_mass_and_not_the_observed_position():
    offset = 0.015
    env = PushEnv(
        1, seed=0, dtype=F64, box_sizes=(0.06,), duration=0.2,
        randomisation=PushRandomisation(com=(offset, offset), box_yaw=(0.0, 0.0), mass=(1.0, 1.0)),
    )  # fmt: skip
    reset = env.reset()
    assert_close(reset["box_pose"][0, :2], reset["box_start"][0], atol=1e-4, rtol=0)
    body = forwarded(model_of(env, 0), env.engine.state(0)).body("box")
    assert_close(torch.from_numpy(body.xipos - body.xpos), torch.tensor([offset, offset, 0.0], dtype=F64))


def test_environments_with_an_offset_are_drawn_anew_and_step():
    env = PushEnv(2, seed=1, randomisation=PushRandomisation(com=(-0.015, 0.015)), duration=0.05)
    first, second = ((env.reset(), env._episode.physical["com"].clone())[1] for _ in range(2))
    assert (first != second).all()
    assert not rollout(env, torques(env, 5))["next", "diverged"].any()


# -- the reference -----------------------------------------------------------------------------------------------------


def via(goal_yaw: float | None, counter_turn: float = 0.5, goal: tuple[float, float] = (0.3, 0.0)) -> torch.Tensor:
    place = [torch.tensor([value], dtype=F64) for value in ((-0.1, 0.0), (0.0, 0.0), goal)]
    return push_via_points(
        PushReference(counter_turn=counter_turn), tool=place[0], box=place[1], goal=place[2],
        goal_yaw=None if goal_yaw is None else torch.tensor([[goal_yaw]], dtype=F64),
        offset=torch.tensor([[0.04]], dtype=F64),
    )[0]  # fmt: skip


def test_the_reference_of_a_position_pushes_along_the_line_to_the_goal():
    points = via(None)
    assert_close(points[1], torch.tensor([-0.06, 0.0, 0.0], dtype=F64))
    assert_close(points[2], torch.tensor([0.26, 0.0, 0.0], dtype=F64))


@pytest.mark.parametrize("yaw", [0.4, -0.4])
def test_a_box_that_has_to_turn_is_approached_from_the_other_side_and_left_square_to_the_paddle(yaw):
    points = via(yaw)
    assert float(points[1, 1]) * yaw > 0  # behind the box, on the side whose push turns it towards the goal
    assert float(points[1, 2]) == pytest.approx(-0.5 * yaw * 0.7)
    assert_close(points[2], torch.tensor([0.3 - 0.04 * math.cos(yaw), -0.04 * math.sin(yaw), yaw], dtype=F64))
    assert_close(via(yaw, counter_turn=0.0)[1], via(None)[1])


def test_left_and_right_are_mirror_images():
    left, right = via(0.3, goal=(0.3, 0.1)), via(-0.3, goal=(0.3, -0.1))
    assert_close(left, right * torch.tensor([1.0, -1.0, -1.0], dtype=F64))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PushEnv(goal="angle"), "goal is 'angle'; expected one of"),
        (lambda: PushEnv(goal=None), "goal is None; expected one of"),
        (lambda: PushEnv(goal="pose", success_yaw=0.0), "success_yaw is 0.0; expected a number from"),
        (lambda: PushEnv(goal="pose", success_yaw=math.nan), "success_yaw is nan"),
        (lambda: PushEnv(reference="straight"), "reference is 'straight'"),
        (lambda: PushReference(counter_turn=math.inf), "PushReference.counter_turn is inf"),
        (lambda: PushReference(gap=-0.01), "PushReference.gap is -0.01"),
        (lambda: PushRandomisation(com=(-0.5, 0.5)), "PushRandomisation.com"),
        (lambda: PushRandomisation(error=(0.1, -0.1)), "PushRandomisation.error"),
        (lambda: PushRandomisation(goal_yaw=(0.0, 7.0)), "PushRandomisation.goal_yaw"),
    ],
)
def test_impossible_options_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()

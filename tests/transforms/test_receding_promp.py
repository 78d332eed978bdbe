from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.testing import assert_close
from torchrl.envs import TransformedEnv

from ppt_rl.functional.heading import from_heading, to_heading
from ppt_rl.modules import ProMP, TaskSpace
from ppt_rl.tasks.maze.config import RecedingConfig, make_maze_promp, maze_space
from ppt_rl.transforms import RecedingProMPTransform
from tests.sampling import normal
from tests.transforms.cases import ORIGIN
from tests.transforms.mocks import TowedEnv, actions_for, play

F64 = torch.float64
RECIPE = RecedingConfig()
DT = 0.01
REPLAN, TOTAL = RECIPE.replan_steps, round(RECIPE.promp_duration / DT)
LEAD = (0.01, 0.002, 0.0)
SPEED = 0.06
START = torch.tensor([[0.5, -0.1, 0.02], [0.4, 0.2, 0.05]], dtype=F64)
HEADING = torch.tensor([[0.7], [-2.0]], dtype=F64)


def line(speed: float = SPEED) -> ProMP:
    """The recipe's primitive with a prior that goes straight ahead."""
    promp = make_maze_promp(RECIPE)
    promp.weights_mean[:, 0] = speed * promp.duration * promp.centres
    return promp


def towed(
    promp: ProMP,
    share: float,
    *,
    start: Tensor = START,
    heading: Tensor = HEADING,
    replan_steps: int = REPLAN,
    **kwargs: Any,
) -> TransformedEnv:
    """A tool that goes this share of the way with its references; at 0 it is blocked."""
    base = TowedEnv(maze_space().pose(start), heading, steps=replan_steps, share=share)
    return TransformedEnv(base, RecedingProMPTransform(promp, maze_space(), replan_steps=replan_steps, **kwargs))


def rested(env: TransformedEnv, steps: int) -> TensorDictBase:
    """Steps without a residual."""
    return play(env, torch.zeros(steps, *env.action_spec.shape, dtype=F64))["next"]


def hand_over_map(replan_steps: int) -> Tensor:
    """What a blocked tool's reference does from one policy step to the next, ``(2, 2)``.

    The columns are offset from the tool and velocity at the start, times the duration; the rows the same at the end.
    """
    promp = make_maze_promp(RECIPE)  # its mean is zero: it stays
    env = towed(promp, 0.0, replan_steps=replan_steps, max_lead=(0.0, 0.0, 0.0))
    td = env.reset()
    way = torch.cat([HEADING.cos(), HEADING.sin(), 0 * HEADING], -1)
    td["reference_position"] = START + torch.tensor([[1e-2], [0.0]], dtype=F64) * way
    td["reference_velocity"] = torch.tensor([[0.0], [1e-2]], dtype=F64) / promp.duration * way
    after = env.step(td.set("action", env.full_action_spec["action"].zero()))["next"]
    offset, velocity = after["reference_position"] - START, promp.duration * after["reference_velocity"]
    return torch.stack([(offset * way).sum(-1), (velocity * way).sum(-1)]) / 1e-2


def spectral_radius(matrix: Tensor) -> float:
    return float(torch.linalg.eigvals(matrix).abs().max())


# -- the hand-over -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [1.0, 0.9, 0.0])
def test_position_and_velocity_of_the_reference_go_on_where_the_last_chunk_ended(share: float) -> None:
    env = towed(line(), share)
    steps = play(env, actions_for(env, 6))["next"]
    first = steps["executed"][:, 1:, 0]
    assert (steps["weights"].diff(dim=1).abs().amax((-1, -2)) > 1e-3).all()
    assert_close(first[..., :3], steps["reference_position"][:, :-1], rtol=0.0, atol=1e-6)
    assert_close(first[..., 7:10], steps["reference_velocity"][:, :-1], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_the_velocity_is_that_of_the_positions_within_and_between_the_chunks(share: float) -> None:
    env = towed(line(), share)
    references = play(env, actions_for(env, 6))["next", "executed"].flatten(1, 2)
    moved = references[..., :3].diff(dim=1) / DT
    meant = 0.5 * (references[:, 1:, 7:10] + references[:, :-1, 7:10])
    assert meant.abs().max() > 0.03
    assert_close(moved, meant, rtol=0.0, atol=2e-3)


def test_the_first_reference_of_an_episode_is_the_measured_position_at_rest() -> None:
    env = towed(line(), 1.0)
    first = play(env, actions_for(env, 1))["next", "executed"][:, 0, 0]
    assert_close(first[:, :3], START, rtol=0.0, atol=1e-6)
    assert_close(first[:, 7:], torch.zeros(2, 6, dtype=F64), rtol=0.0, atol=1e-6)


def test_a_primitive_begins_at_the_reference_within_the_lead_and_at_the_lead_beyond_it() -> None:
    lead = torch.tensor(LEAD, dtype=F64)
    env = towed(line(), 1.0, max_lead=LEAD)
    td = env.reset()
    ahead = torch.tensor([[0.006, -0.001, 0.0], [0.03, -0.01, 0.004]], dtype=F64)  # in heading axes
    td["reference_position"] = START + from_heading(ahead, HEADING)
    chunk = env.step(td.set("action", env.full_action_spec["action"].zero()))["next"]
    phases = torch.arange(REPLAN) / TOTAL
    way = line().decode(chunk["weights"], phases.double())[0]
    origin = chunk["executed"][..., :3] - from_heading(way, HEADING.unsqueeze(-2))
    offset = to_heading(origin - START.unsqueeze(-2), HEADING.unsqueeze(-2))
    expected = ahead.clamp(-lead, lead).unsqueeze(-2).expand(2, REPLAN, 3)
    assert_close(offset, expected, rtol=0.0, atol=1e-6)


# -- at a wall ---------------------------------------------------------------------------------------------------------


def touching(
    slip: float | None, velocity: Tensor, twist: Tensor, *, contact: bool = True, angle: float = 0.4
) -> Tensor:
    """Velocity at the beginning of a chunk along a wall at an angle to the heading, in axes along, across and up."""
    env = towed(line(), 1.0, max_slip=slip)
    td, wall = env.reset(), HEADING + angle
    td["reference_velocity"] = from_heading(velocity, wall)
    td["twist"] = torch.cat([from_heading(twist, wall), torch.zeros_like(twist)], -1)
    td["contact"] = torch.full((2, 1), contact)
    td["via_tangent"] = torch.cat([wall.cos(), wall.sin()], -1)
    chunk = env.step(td.set("action", env.full_action_spec["action"].zero()))["next"]
    return to_heading(chunk["executed"][:, 0, 7:10], wall)


def test_in_contact_a_primitive_begins_along_the_wall_as_fast_as_before_and_across_it_near_the_tool() -> None:
    velocity = torch.tensor([[0.04, 0.03, 0.001], [0.06, 0.002, -0.001]], dtype=F64)
    twist = torch.tensor([[0.01, 0.001, 0.0], [0.048, 0.0, 0.0]], dtype=F64)
    expected = torch.tensor([[0.05, 0.006, 0.001], [0.060033, 0.002, -0.001]], dtype=F64)
    assert_close(touching(0.005, velocity, twist), expected, rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("contact", [True, False])
def test_a_primitive_begins_to_climb_and_to_descend_as_the_tool_does(contact: bool) -> None:
    velocity = torch.tensor([[0.05, 0.0, 0.0], [0.05, 0.0, -0.03]], dtype=F64)
    twist = torch.tensor([[0.05, 0.0, 0.02], [0.05, 0.0, -0.01]], dtype=F64)
    expected = torch.tensor([[0.05, 0.0, 0.015], [0.05, 0.0, -0.015]], dtype=F64)
    assert_close(touching(0.005, velocity, twist, contact=contact), expected, rtol=0.0, atol=2e-6)


def test_away_from_walls_the_velocity_of_the_reference_goes_on_on_the_map() -> None:
    velocity, twist = 0.05 * normal(2, 3), 0.05 * normal(2, 3)
    begun = touching(0.005, velocity, twist, contact=False)
    assert_close(begun[..., :2], velocity[..., :2], rtol=0.0, atol=1e-6)


def test_without_a_limit_of_slip_all_of_the_velocity_goes_on() -> None:
    velocity, twist = 0.05 * normal(2, 3), 0.05 * normal(2, 3)
    assert_close(touching(None, velocity, twist), velocity, rtol=0.0, atol=1e-6)


def test_a_slip_without_the_measured_twist_is_refused_by_the_key() -> None:
    env = towed(line(), 1.0, max_slip=0.01)
    td = env.reset()
    with pytest.raises(KeyError, match=r"RecedingProMPTransform needs \['twist', 'contact', 'via_tangent'\]"):
        env.step(td.set("action", env.full_action_spec["action"].zero()))


@pytest.mark.parametrize("slip", [-0.01, math.nan, math.inf])
def test_an_impossible_slip_is_refused(slip: float) -> None:
    with pytest.raises(ValueError, match=r"max_slip is .*; expected a finite number of at least 0 m/s, or None"):
        RecedingProMPTransform(line(), maze_space(), max_slip=slip)


# -- stability ---------------------------------------------------------------------------------------------------------


def test_the_recipes_hand_over_of_a_blocked_tool_is_stable() -> None:
    assert spectral_radius(hand_over_map(REPLAN)) < 0.9


def test_with_chunks_of_two_steps_out_of_eighty_the_hand_over_would_be_unstable() -> None:
    assert spectral_radius(hand_over_map(2)) > 1.0


def test_the_reference_of_a_blocked_tool_does_not_run_away() -> None:
    steps = rested(towed(line(), 0.0), 80)
    away = (steps["reference_position"] - START.unsqueeze(1)).norm(dim=-1)
    assert away.max() < 0.03
    assert_close(away[:, 60:].amax(1), away[:, 40:60].amax(1), rtol=0.0, atol=1e-4)
    assert 80 * REPLAN * DT * SPEED > 0.7  # how far it would have gone


def test_a_straight_prior_is_followed_straight_and_after_the_start_at_its_own_velocity_to_a_twentieth() -> None:
    steps = rested(towed(line(), 1.0), 12)
    references = steps["executed"][:, 5:].flatten(1, 2)
    velocity = to_heading(references[..., 7:10], HEADING.unsqueeze(-2))
    straight = torch.tensor((SPEED, 0.0, 0.0), dtype=F64).expand_as(velocity)
    assert_close(velocity, straight, rtol=0.0, atol=0.05 * SPEED)
    across = to_heading(steps["executed"][..., :3].flatten(1, 2) - START.unsqueeze(1), HEADING.unsqueeze(1))[..., 1:]
    assert_close(across, torch.zeros_like(across), rtol=0.0, atol=1e-6)


# -- the frame ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [1.0, 0.3])
@pytest.mark.parametrize("angle", [-2.2, 0.4, math.pi])
def test_moving_and_turning_the_world_moves_and_turns_every_reference(angle: float, share: float) -> None:
    turn, shift = torch.full((2, 1), angle, dtype=F64), torch.tensor((0.1, -0.3, 0.05), dtype=F64)
    here = towed(line(), share)
    there = towed(line(), share, start=from_heading(START, turn) + shift, heading=HEADING + angle)
    actions = actions_for(here, 5)
    one, other = (play(env, actions)["next", "executed"] for env in (here, there))
    turn = turn[:, None, None]
    assert_close(other[..., :3], from_heading(one[..., :3], turn) + shift, rtol=0.0, atol=1e-6)
    assert_close(other[..., 7:10], from_heading(one[..., 7:10], turn), rtol=0.0, atol=1e-6)
    assert torch.equal(other[..., 3:7], one[..., 3:7])
    assert not other[..., 10:].any()


@pytest.mark.parametrize("replan_steps", [1, 20, 80])
def test_the_first_chunk_is_the_decoded_primitive_placed_at_the_tool_for_the_steps_to_the_next(
    replan_steps: int,
) -> None:
    promp = line()
    env = towed(promp, 1.0, replan_steps=replan_steps)
    step = play(env, actions_for(env, 1))["next"][:, 0]
    position, velocity, _ = promp.decode(step["weights"], torch.arange(replan_steps, dtype=F64) / TOTAL)
    assert step["executed"].shape == (2, replan_steps, 13)
    placed = START.unsqueeze(1) + from_heading(position, HEADING.unsqueeze(1))
    assert_close(step["executed"][..., :3], placed, rtol=0.0, atol=1e-6)
    assert_close(step["executed"][..., 7:10], from_heading(velocity, HEADING.unsqueeze(1)), rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_residual_moves_the_reference_ahead_to_the_left_or_up_by_its_own_scale(axis: int) -> None:
    scale = (0.01, 0.02, 0.004)
    env = towed(make_maze_promp(RECIPE), 1.0, replan_steps=TOTAL, residual_scale=scale)
    residual = torch.zeros(3, RECIPE.num_basis, dtype=F64)
    residual[axis] = 1.0
    step = play(env, residual.flatten().expand(1, 2, -1))["next"][:, 0]
    moved = to_heading(step["reference_position"] - START, HEADING)
    expected = torch.eye(3, dtype=F64)[axis] * scale[axis]
    assert_close(moved, expected.expand(2, 3), rtol=0.0, atol=0.05 * scale[axis])


def test_the_weights_that_are_observed_replace_the_prior() -> None:
    env, seen = towed(line(), 1.0), 0.01 * normal(2, RECIPE.num_basis, 3)
    other = line()
    other.weights_mean.copy_(seen[0])
    action = env.full_action_spec["action"].zero()
    chunk = env.step(env.reset().set("weights_mean", seen).set("action", action))["next", "executed"]
    expected = towed(other, 1.0)
    assert_close(
        chunk[0], expected.step(expected.reset().set("action", action))["next", "executed"][0], rtol=0.0, atol=1e-6
    )


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", [("x", "y", "yaw"), ("y", "x", "z")])
def test_a_task_space_of_other_coordinates_than_x_y_z_is_refused(axes: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"task_space has the coordinates .*expected \('x', 'y', 'z'\)"):
        RecedingProMPTransform(ProMP(4, 3, 0.8), TaskSpace(axes, ORIGIN))


@pytest.mark.parametrize("lead", [(0.01,), (0.01, 0.01), (0.01,) * 4, (0.01, -0.001, 0.0), (0.0, float("nan"), 0.0)])
def test_a_lead_that_is_not_three_numbers_of_at_least_zero_is_refused_with_what_came(lead: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected three numbers of at least 0 m") as error:
        towed(line(), 1.0, max_lead=lead)
    assert str(error.value).startswith(f"max_lead is {lead};")


@pytest.mark.parametrize("key", ["pose", "heading"])
def test_a_missing_observation_is_named(key: str) -> None:
    td = towed(line(), 1.0).base_env.reset().exclude(key).set("action", torch.zeros(2, 24, dtype=F64))
    with pytest.raises(KeyError, match=rf"RecedingProMPTransform needs \['{key}'\]; the tensordict holds .*executed"):
        RecedingProMPTransform(line(), maze_space()).inv(td)

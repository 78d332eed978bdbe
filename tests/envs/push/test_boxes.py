"""Boxes of any size and mass."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from ppt_rl.envs import PushEnv, PushRandomisation
from ppt_rl.envs.push.box import Boxes
from ppt_rl.envs.push.episode import draw_episodes
from ppt_rl.envs.row_generators import RowGenerators
from tests.engines import COARSE, models_of

LARGE = {"box_sizes": (0.10,), "box_masses": (0.2,)}


def test_without_masses_the_boxes_are_those_of_the_paper():
    assert Boxes.of((0.08, 0.06)) == Boxes((0.08, 0.06), (0.080, 0.050))


def test_a_box_of_ten_centimetres_and_two_hundred_grams_is_in_the_model_and_in_the_observations():
    env = PushEnv(4, seed=0, engine=COARSE, **LARGE)
    observation = env.reset()
    assert torch.allclose(observation["box_size"], torch.tensor(0.10))
    assert torch.allclose(observation["box_pose"][:, 2], torch.tensor(0.05))
    for model in models_of(env):
        np.testing.assert_allclose(model.geom("box").size, 0.05)
        assert 0.85 * 0.2 <= model.body("box").mass[0] <= 1.15 * 0.2
        np.testing.assert_allclose(model.body("box").inertia, model.body("box").mass[0] * 0.1**2 / 6)
        assert model.geom_rbound[model.geom("box").id] == pytest.approx(0.05 * 3**0.5)
    env.close()


def test_the_via_points_touch_the_box_that_was_drawn():
    env = PushEnv(64, seed=0, engine=COARSE, box_sizes=(0.06, 0.1), box_masses=(0.05, 0.2))
    observation = env.reset()
    distance = (observation["via_position"][:, 2, :2] - observation["goal"]).norm(dim=-1)
    torch.testing.assert_close(distance, 0.5 * observation["box_size"].squeeze(-1) + env.tool.half_thickness)
    assert observation["box_size"].unique().numel() == 2
    env.close()


def test_each_size_has_the_mass_that_was_given_for_it():
    boxes = Boxes.of((0.05, 0.1, 0.05), (0.1, 0.4, 0.2))
    drawn = draw_episodes(RowGenerators(0, 400), torch.arange(400), PushRandomisation(mass=(1.0, 1.0)), boxes)
    assert set(map(tuple, torch.cat([drawn["size"], drawn["mass"]], -1).tolist())) == {
        (0.05, 0.1),
        (0.1, 0.4),
        (0.05, 0.2),
    }


def test_success_of_a_large_box_needs_it_to_lie_at_its_own_height():
    env = PushEnv(1, seed=0, engine=COARSE, **LARGE)
    env.reset()
    box = torch.tensor([[0.6, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]])
    assert env._is_flat(box)
    box[:, 2] = 0.03
    assert not env._is_flat(box)
    env.close()


def test_a_box_whose_place_leaves_room_for_it_may_be_larger():
    env = PushEnv(
        2,
        seed=0,
        engine=COARSE,
        box_sizes=(0.2,),
        box_masses=(1.0,),
        randomisation=PushRandomisation(box_x=(0.5, 0.52)),
    )
    env.rollout(3)
    assert env.reset()["progress"].max() < 1e-6
    env.close()

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.record import CSVLogger, PixelRenderTransform, VideoRecorder

from ppt_rl.envs import PushEnv
from ppt_rl.transforms import MacroStepTransform
from tests.engines import COARSE
from tests.envs.scenes import opengl

SMALL = {"width": 32, "height": 24}
pytestmark = opengl


def filmed(num_envs, logger, *further, **kwargs):
    base = PushEnv(num_envs, duration=0.05, seed=0, engine=COARSE)
    transforms = PixelRenderTransform(**kwargs), VideoRecorder(logger, tag="film"), *further
    return TransformedEnv(base, Compose(*transforms))


def test_a_picture_is_contiguous_so_that_torch_accepts_it():
    env = PushEnv(1, seed=0, engine=COARSE)
    env.reset()
    picture = env.render(**SMALL)
    assert picture.flags.c_contiguous
    assert torch.equal(torch.as_tensor(picture), torch.from_numpy(picture.copy()))
    env.close()


@pytest.mark.parametrize("num_envs", [1, 4])
def test_torchrls_recorder_films_an_environment_with_its_defaults(num_envs, tmp_path):
    env = filmed(num_envs, CSVLogger("run", log_dir=str(tmp_path)))
    assert env.rollout(2).shape == (num_envs, 2)
    env.transform[1].dump()
    (film,) = tmp_path.rglob("*.pt")
    frames = torch.load(film)
    assert frames.shape[-3:] == (3, 480, 640)
    assert frames.float().std() > 10
    env.close()


def test_specs_hold_with_pictures_across_the_ends_of_episodes():
    env = filmed(2, None, **SMALL)
    check_env_specs(env)
    steps = env.rollout(7, break_when_any_done=False)  # episodes of five control steps
    assert steps["next", "done"].sum() == 2
    first = [step.get(("next", "pixels")).data for step in steps[0].unbind(0)]
    assert len(first) == 7
    assert not np.array_equal(first[0], first[-1])
    env.close()


def test_an_argument_of_the_transform_picks_the_environment_and_the_camera():
    env = filmed(2, None, index=1, camera="top", **SMALL)
    env.reset()  # before it declares its picture, the transform resets the environment once more
    shown = env.reset().get("pixels").data
    assert np.array_equal(shown, env.base_env.render(1, camera="top", **SMALL))
    assert not np.array_equal(shown, env.base_env.render(0, camera="top", **SMALL))
    env.close()


def test_every_control_step_of_a_chunk_is_filmed_even_where_rows_have_ended():
    env = filmed(2, None, MacroStepTransform(4), **SMALL)
    check_env_specs(env)
    env.transform[1].obs.clear()
    env.rollout(2)  # five control steps and the two masked ones that the second chunk does not need
    assert len(env.transform[1].obs) >= 6
    env.close()

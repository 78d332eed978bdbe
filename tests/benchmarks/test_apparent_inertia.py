from __future__ import annotations

import apparent_inertia
import numpy as np
import pytest

from ppt_rl.arms import arm_names, find_arm


@pytest.mark.parametrize("name", arm_names())
def test_every_arms_file_states_what_the_benchmark_measures(name):
    arm = find_arm(name)
    joint, task = apparent_inertia.inertias(arm, apparent_inertia.Config().samples, apparent_inertia.Config().seed)
    np.testing.assert_allclose(arm.joints.inertia, np.median(joint, 0), rtol=0.005)
    np.testing.assert_allclose(arm.apparent_inertia, np.median(task, 0), rtol=0, atol=0.006)

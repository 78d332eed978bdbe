from __future__ import annotations

import apparent_inertia
import numpy as np
import pytest

from ppt_rl.arms import FR3, PANDA, UR5E


@pytest.mark.parametrize("arm", [PANDA, FR3, UR5E], ids=lambda arm: arm.name)
def test_every_arms_file_states_what_the_benchmark_measures(arm):
    joint, task = apparent_inertia.inertias(arm, apparent_inertia.Config().samples, apparent_inertia.Config().seed)
    np.testing.assert_allclose(arm.joints.inertia, np.median(joint, 0), rtol=0.005)
    np.testing.assert_allclose(arm.apparent_inertia, np.median(task, 0), rtol=0, atol=0.006)

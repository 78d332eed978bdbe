from dataclasses import replace

import mujoco
import numpy as np
import pytest
from dm_control import mjcf

from ppt_rl.arms import PANDA, UR5E
from ppt_rl.envs import PandaEnv, PandaPushEnv
from ppt_rl.envs.models import PADDLE, arm_model, remove_looks, table_scene
from ppt_rl.envs.push.scene import push_scene
from tests.engines import SPACING, bound, model_of


def compiled(root):
    return mjcf.Physics.from_mjcf_model(root).model.ptr


@pytest.fixture(scope="module")
def physics_model():
    """The model that the pushing environment simulates."""
    return model_of(PandaPushEnv(1, seed=0), 0)


# -- the arm -----------------------------------------------------------------------------------------------------------


def test_joint_ranges_and_torque_limits_are_the_arms(physics_model):
    for i in range(7):
        joint, motor = physics_model.joint(f"joint{i + 1}"), physics_model.actuator(f"motor{i + 1}")
        assert joint.range.tolist() == list(PANDA.joints.position_limits[i])
        assert joint.limited[0]
        assert motor.ctrlrange.tolist() == [-PANDA.joints.torque_limits[i], PANDA.joints.torque_limits[i]]
        assert motor.ctrllimited[0]
        assert motor.trnid[0] == joint.id
        assert motor.gear.tolist() == [1, 0, 0, 0, 0, 0]


def test_masses_centres_and_inertias_of_the_links_are_the_arms(physics_model):
    for i, link in enumerate(PANDA.links, start=1):
        body = physics_model.body(f"link{i}")
        np.testing.assert_allclose(body.mass[0], link.mass, rtol=bound(0.0, SPACING))
        np.testing.assert_allclose(body.ipos, link.com, rtol=0, atol=1e-12)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, body.iquat)
        turn = turn.reshape(3, 3)
        xx, yy, zz, xy, xz, yz = link.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(turn @ np.diag(body.inertia) @ turn.T, inertia, rtol=0, atol=bound(1e-9, SPACING))


def test_no_joint_has_damping_or_dry_friction(physics_model):
    assert (physics_model.dof_damping == 0).all()
    assert (physics_model.dof_frictionloss == 0).all()


def test_gravity_is_compensated_on_arm_and_tool_but_not_on_the_box(physics_model):
    for name in (*(f"link{i}" for i in range(1, 8)), "tool"):
        assert physics_model.body_gravcomp[physics_model.body(name).id] == 1
    assert physics_model.body_gravcomp[physics_model.body("box").id] == 0
    assert physics_model.opt.gravity.tolist() == [0, 0, -9.81]


def test_the_end_effector_point_lies_in_the_centre_of_the_bar_a_tool_length_beyond_the_flange(physics_model):
    data = mujoco.MjData(physics_model)
    data.qpos[:7] = PANDA.home
    mujoco.mj_forward(physics_model, data)
    np.testing.assert_allclose(data.site("end_effector").xpos, data.geom("bar").xpos, rtol=0, atol=1e-12)
    flange = data.body("tool").xpos
    axis = data.body("link7").xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(data.site("end_effector").xpos, flange + PADDLE.length * axis, rtol=0, atol=1e-12)
    np.testing.assert_allclose(axis, [0, 0, -1], rtol=0, atol=1e-9)


def test_the_paddle_is_a_bar_of_12_by_1_by_1_centimetres(physics_model):
    assert (2 * physics_model.geom("bar").size).tolist() == pytest.approx([0.01, 0.12, 0.01])


# -- the scene ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene", [arm_model, table_scene, push_scene])
def test_no_scene_needs_a_file(scene):
    root = scene(PANDA)
    assert compiled(root).nmesh == len(PANDA.shells)
    assert root.get_assets() == {}
    assert "file=" not in root.to_xml_string()


def test_what_is_simulated_has_nothing_that_only_pictures_show(physics_model):
    found = [physics_model.nmesh, physics_model.nmat, physics_model.ntex, physics_model.ncam, physics_model.nlight]
    assert found == [0] * 5


def test_a_camera_that_a_sensor_reads_stays():
    root = push_scene(PANDA)
    camera = root.worldbody.add("camera", name="eye", pos=(0.1, 0.2, 0.3))
    root.sensor.add("framepos", name="eye_position", objtype="camera", objname=camera)
    remove_looks(root)
    stepped = compiled(root)
    data = mujoco.MjData(stepped)
    mujoco.mj_forward(stepped, data)
    assert stepped.ncam == 1
    np.testing.assert_array_equal(data.sensor("eye_position").data, (0.1, 0.2, 0.3))


@pytest.mark.parametrize("arm", [PANDA, UR5E], ids=lambda arm: arm.name)
def test_looks_change_no_trajectory(arm):
    """The same torques on what pictures show, on what is simulated, and on an arm that has no shells at all."""
    full, bare, plain = push_scene(arm), push_scene(arm), push_scene(replace(arm, shells=()))
    for root in (bare, plain):
        remove_looks(root)
    models = [compiled(root) for root in (full, bare, plain)]
    assert (models[1].nbody, models[1].ngeom) == (models[2].nbody, models[2].ngeom)
    assert models[0].nbody == models[1].nbody
    end = []
    for model in models:
        data = mujoco.MjData(model)
        data.qpos[: arm.num_joints] = arm.home
        data.qvel[arm.num_joints] = 0.3  # the box slides
        for step in range(400):
            data.ctrl[:] = 5 * np.sin(0.02 * step + np.arange(arm.num_joints))
            mujoco.mj_step(model, data)
        end.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    np.testing.assert_array_equal(end[0], end[1])
    np.testing.assert_array_equal(end[1], end[2])
    assert np.abs(end[0][arm.num_joints] - 0.45) > 0.01  # the box has slid


@pytest.mark.parametrize("env_class", [PandaEnv, PandaPushEnv])
def test_every_simulated_geom_can_collide(env_class):
    model = model_of(env_class(1, seed=0), 0)
    assert ((model.geom_contype != 0) | (model.geom_conaffinity != 0)).all()


def test_removing_visual_geoms_changes_no_mass_and_no_contact_geometry():
    looks, bare = push_scene(PANDA), push_scene(PANDA)
    remove_looks(bare)
    full, stepped = compiled(looks), compiled(bare)
    assert stepped.ngeom < full.ngeom
    moving = stepped.body_weldid != 0
    assert moving.sum() == 9  # seven links, the tool on the last of them, the box
    np.testing.assert_array_equal(stepped.body_mass[moving], full.body_mass[moving])
    np.testing.assert_array_equal(stepped.body_inertia[moving], full.body_inertia[moving])
    for i in range(stepped.ngeom):
        name = stepped.geom(i).name
        np.testing.assert_array_equal(stepped.geom(name).size, full.geom(name).size)


def test_the_box_collides_with_tool_and_table(physics_model):
    def collide(a, b):
        a, b = physics_model.geom(a), physics_model.geom(b)
        return bool(a.contype[0] & b.conaffinity[0] or b.contype[0] & a.conaffinity[0])

    assert all(collide("box", other) for other in ("bar", "stem", "table"))

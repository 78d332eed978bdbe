import math

import pytest
import torch
from torch.testing import assert_close

from ppt_rl.arms import PANDA
from ppt_rl.functional import cartesian_impedance, joint_torque
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.modules.impedance import STIFFNESS
from tests.sampling import normal, random_joint_positions, random_poses

F64 = torch.float64


def batch(*shape: int) -> list[torch.Tensor]:
    return [random_poses(*shape, seed=1), normal(*shape, 6, seed=2), random_poses(*shape, seed=3), normal(*shape, 6)]


def test_the_module_applies_the_impedance_law_with_its_gains():
    controller = CartesianImpedanceController([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], damping=[7.0] * 6).double()
    inputs = batch(5)
    stiffness = torch.arange(1.0, 7.0, dtype=F64)
    expected = cartesian_impedance(*inputs, stiffness, torch.full((6,), 7.0, dtype=F64))
    assert_close(controller(*inputs), expected, rtol=1e-6, atol=1e-6)  # gains were stored in float32


def test_the_wrench_is_zero_on_the_reference():
    pose, twist, *_ = batch(5)
    assert_close(CartesianImpedanceController()(pose, twist, pose, twist), torch.zeros(5, 6, dtype=F64))


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_any_batch_keeps_its_shape_and_precision(shape, dtype):
    wrench = CartesianImpedanceController()(*(x.to(dtype) for x in batch(*shape)))
    assert wrench.shape == (*shape, 6)
    assert wrench.dtype == dtype


@pytest.mark.parametrize("ratio", [0.5, 1.0, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
def test_damping_is_twice_the_ratio_times_the_root_of_stiffness_and_inertia(ratio):
    controller = CartesianImpedanceController(damping_ratio=ratio)
    ratios = [ratio] * 6 if isinstance(ratio, float) else ratio
    expected = [2 * z * math.sqrt(k * m) for z, k, m in zip(ratios, STIFFNESS, PANDA.apparent_inertia, strict=True)]
    assert_close(controller.damping, torch.tensor(expected), rtol=1e-5, atol=0.0)


def test_a_stiffness_passed_to_the_call_has_its_own_damping():
    inputs, stiffness = batch(5), torch.full((5, 6), 100.0, dtype=F64)
    inertia = torch.tensor(PANDA.apparent_inertia, dtype=F64)
    expected = cartesian_impedance(*inputs, stiffness, 2 * (stiffness * inertia).sqrt())
    assert_close(CartesianImpedanceController()(*inputs, stiffness=stiffness), expected, rtol=1e-5, atol=1e-5)


def test_given_damping_does_not_depend_on_the_stiffness():
    low, high = (CartesianImpedanceController(k, damping=30.0).damping for k in (10.0, 1000.0))
    assert_close(low, torch.tensor([30.0] * 3 + [2.25] * 3))
    assert_close(high, low)


def test_the_wrench_is_differentiable_in_gains_and_reference():
    controller, (pose, twist, *reference) = CartesianImpedanceController(), batch(2)
    stiffness, damping = normal(2, 6).exp(), normal(2, 6, seed=9).exp()
    inputs = [x.requires_grad_() for x in (*reference, stiffness, damping)]
    assert torch.autograd.gradcheck(lambda *x: controller(pose, twist, *x), inputs)


def test_the_damping_that_follows_a_stiffness_is_differentiable():
    controller, inputs = CartesianImpedanceController(), batch(2)
    stiffness = (100 * normal(2, 6).exp()).requires_grad_()
    assert torch.autograd.gradcheck(lambda k: controller(*inputs, stiffness=k), (stiffness,))


def test_the_joint_torque_is_differentiable_in_the_joint_position():
    kinematics, controller = Kinematics(PANDA, 0.16, dtype=F64), CartesianImpedanceController()
    _, _, reference_pose, reference_twist = batch(2)
    velocity = normal(2, 7, seed=5)

    def torque(joint_position: torch.Tensor) -> torch.Tensor:
        pose, jacobian = kinematics(joint_position)
        twist = (jacobian @ velocity.unsqueeze(-1)).squeeze(-1)
        return joint_torque(jacobian, controller(pose, twist, reference_pose, reference_twist))

    assert torch.autograd.gradcheck(torque, (random_joint_positions(2).requires_grad_(),), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("kwargs", [{"damping_ratio": 1.0}, {"damping": 50.0}])
def test_learnable_gains_get_gradients_and_stay_positive_under_a_harsh_optimiser(kwargs):
    controller = CartesianImpedanceController(learnable=True, **kwargs)
    parameters = list(controller.parameters())
    assert [p.shape for p in parameters] == [(6,), (6,)]
    optimiser = torch.optim.SGD(parameters, lr=0.1)
    inputs = [x.float() for x in batch(5)]
    for _ in range(20):
        optimiser.zero_grad()
        controller(*inputs).square().mean().backward()
        assert all(bool((p.grad.abs() > 0).all()) for p in parameters)
        torch.nn.utils.clip_grad_value_(parameters, 1.0)
        optimiser.step()
    assert bool((controller.stiffness > 0).all())
    assert bool((controller.damping > 0).all())
    assert bool((controller.stiffness < 0.9 * torch.tensor(STIFFNESS)).all())


def test_gains_that_are_not_learnable_are_not_parameters():
    assert not list(CartesianImpedanceController().parameters())


def test_the_state_dict_contains_the_gains():
    source, target = CartesianImpedanceController(100.0, 0.7), CartesianImpedanceController()
    target.load_state_dict(source.state_dict())
    assert torch.equal(target.stiffness, source.stiffness)
    assert torch.equal(target.damping, source.damping)


@pytest.mark.parametrize("name", ["stiffness", "damping_ratio", "damping"])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, [1.0] * 5 + [-1.0]])
def test_gains_that_are_not_positive_and_finite_are_refused(name, bad):
    with pytest.raises(ValueError, match=f"{name} is .*; expected positive finite numbers"):
        CartesianImpedanceController(**{name: bad})


@pytest.mark.parametrize("name", ["stiffness", "damping_ratio", "damping", "inertia"])
def test_the_wrong_number_of_gains_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} has 3 numbers; expected 1 or 6"):
        CartesianImpedanceController(**{name: [1.0, 2.0, 3.0]})


@pytest.mark.parametrize("name", ["pose", "twist", "reference_pose", "reference_twist"])
def test_the_error_names_an_input_of_the_wrong_size(name):
    inputs, index = batch(2), ["pose", "twist", "reference_pose", "reference_twist"].index(name)
    inputs[index] = inputs[index][:, :-1]
    with pytest.raises(ValueError, match=f"^{name} has shape"):
        CartesianImpedanceController()(*inputs)


def test_one_number_is_that_of_translation_and_rotation_gets_its_documented_share():
    controller = CartesianImpedanceController(400.0, damping=40.0)
    assert_close(controller.stiffness, torch.tensor([400.0] * 3 + [30.0] * 3))
    assert_close(controller.damping, torch.tensor([40.0] * 3 + [3.0] * 3))
    assert_close(CartesianImpedanceController(400.0).damping, CartesianImpedanceController().damping)


def test_gains_that_change_are_noticed():
    controller = CartesianImpedanceController(stiffness=100.0)
    pose, moved = torch.zeros(1, 7), torch.zeros(1, 7)
    pose[0, 3] = moved[0, 3] = 1.0
    moved[0, 0] = 0.1

    def force():
        return controller(pose, torch.zeros(1, 6).to(pose), moved, torch.zeros(1, 6).to(pose))[0, 0].item()

    assert force() == pytest.approx(10.0)
    controller.log_stiffness.add_(math.log(2.0))  # in place
    assert force() == pytest.approx(20.0)
    controller.load_state_dict(CartesianImpedanceController(stiffness=50.0).state_dict())
    assert force() == pytest.approx(5.0)
    controller.log_stiffness = torch.full((6,), math.log(30.0))  # another tensor
    assert force() == pytest.approx(3.0)
    pose, moved = pose.double(), moved.double()
    assert force() == pytest.approx(3.0)
    controller.double()
    assert force() == pytest.approx(3.0)

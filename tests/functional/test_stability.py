import pytest
import torch

from ppt_rl.functional.stability import spectral_radius

F64 = torch.float64


def matrix(value: float) -> torch.Tensor:
    return torch.tensor([[value]], dtype=F64)


def simulated_growth(inertia, stiffness, damping, dt, steps=400):
    """Growth in a control step of a mass on a spring and a damper whose force is held, step by step."""
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(len(inertia), generator=generator, dtype=F64)
    v, norms = torch.zeros_like(x), []
    for _ in range(steps):
        acceleration = torch.linalg.solve(inertia, -(stiffness @ x) - damping @ v)
        x, v = x + dt * v + 0.5 * dt**2 * acceleration, v + dt * acceleration
        size = torch.cat([x, v]).norm()
        x, v = x / size, v / size
        norms.append(size)
    return torch.stack(norms[steps // 2 :]).log().mean().exp()


@pytest.mark.parametrize("gain", [0.5, 3.0, 30.0])
def test_the_radius_is_the_growth_of_a_simulated_motion(gain):
    generator = torch.Generator().manual_seed(3)
    factor = torch.randn(3, 4, 4, generator=generator, dtype=F64)
    inertia, stiffness, damping = factor @ factor.mT + 0.5 * torch.eye(4, dtype=F64)
    radius = spectral_radius(inertia, gain * stiffness, gain * damping, 0.05)
    torch.testing.assert_close(
        radius, simulated_growth(inertia, gain * stiffness, gain * damping, 0.05), rtol=2e-2, atol=0
    )


def test_a_damper_alone_is_unstable_once_it_more_than_reverses_the_velocity_in_a_step():
    for damping, radius in ((1.9, 1.0), (2.5, 1.5)):
        torch.testing.assert_close(
            spectral_radius(matrix(1.0), matrix(0.0), matrix(damping / 0.01), 0.01), torch.tensor(radius, dtype=F64)
        )


def test_every_positive_damping_is_stable_at_a_high_enough_rate():
    stiff = matrix(400.0), matrix(20.0)
    assert spectral_radius(matrix(0.1), *stiff, 0.05) > 1
    assert spectral_radius(matrix(0.1), *stiff, 1e-4) < 1


def test_batches_equal_single_calls():
    inertia, stiffness, damping = (matrix(value).expand(3, 1, 1).clone() for value in (1.0, 40.0, 3.0))
    stiffness[1] *= 50
    together = spectral_radius(inertia, stiffness, damping, 0.02)
    alone = [spectral_radius(m, k, d, 0.02) for m, k, d in zip(inertia, stiffness, damping, strict=True)]
    torch.testing.assert_close(together, torch.stack(alone))

from __future__ import annotations

import pytest
import torch
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from ppt_rl.functional import PlaneBarrier, SpeedBarrier, project_half_spaces
from tests.sampling import normal

F64 = torch.float64
MASS = torch.tensor((8.35, 4.9, 8.75), dtype=F64)
LAWS = settings(max_examples=3, deadline=None, derandomize=True, phases=(Phase.generate,))
SEEDS = st.integers(0, 10**6)
DT = 0.01


def move(barriers, seed, *, steps=60, force=60.0, x=None, v=None, rows=32):
    """Positions, velocities and accelerations of point masses under random forces, each held for a control step."""
    x = torch.zeros(rows, 3, dtype=F64) if x is None else x
    v = torch.zeros(rows, 3, dtype=F64) if v is None else v
    generator, path = torch.Generator().manual_seed(seed), []
    wanted = torch.zeros(rows, 3, dtype=F64)
    for number in range(steps):
        if number % 10 == 0:
            wanted = force * torch.randn(rows, 3, generator=generator, dtype=F64)
        spaces = [barrier.half_space(x, v, MASS, DT) for barrier in barriers]
        normals, offsets = torch.stack([a for a, _ in spaces], -2), torch.cat([b for _, b in spaces], -1)
        a = project_half_spaces(wanted, normals, offsets) / MASS
        x, v = x + DT * v + 0.5 * DT**2 * a, v + DT * a
        path.append((x, v, a))
    return (torch.stack(part) for part in zip(*path, strict=True))


@pytest.mark.parametrize("rate", [5.0, 50.0, 100.0])
@LAWS
@given(seed=SEEDS)
def test_a_point_mass_keeps_below_its_speed_up_to_what_a_turn_in_one_step_adds(rate, seed):
    _, velocity, acceleration = move([SpeedBarrier(0.3, rate)], seed, force=20.0)
    speed = velocity.norm(dim=-1)
    assert speed.max() > 0.2
    assert (speed[1:] <= allowed(speed[:-1], acceleration[1:], 0.3, rate)).all()
    assert (speed <= 0.4).all()  # the forces change it by up to 12 cm/s in a control step


def allowed(speed, acceleration, v_max, rate):
    """Largest speed one control step later: along the motion what the barrier allows, across it what the force adds."""
    along = speed + rate * DT * (v_max - speed)
    return (along.square() + (DT * acceleration.norm(dim=-1)).square()).sqrt() + 1e-9


def test_a_speed_above_the_limit_falls_by_the_rate():
    v = torch.tensor([[0.6, 0.0, 0.0]], dtype=F64)
    _, velocity, _ = move([SpeedBarrier(0.3, 20.0)], 0, steps=30, force=1e-9, v=v, rows=1)
    expected = 0.3 + 0.3 * 0.8 ** torch.arange(1, 31, dtype=F64)
    torch.testing.assert_close(velocity[:, 0, 0], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("rate", [5.0, 20.0, 100.0])
@LAWS
@given(seed=SEEDS)
def test_a_point_mass_never_crosses_the_plane_at_any_control_step(rate, seed):
    barrier = PlaneBarrier(tuple(normal(3, seed=seed + 1).tolist()), -0.02, rate)
    way = torch.tensor(barrier.normal, dtype=F64)
    way = way / way.norm()
    position, velocity, _ = move([barrier], seed, force=100.0)
    height, climb = position @ way + 0.02, velocity @ way
    assert height.min() < 0.015  # it is pushed there
    assert (height >= -1e-12).all()
    assert (climb + rate * height >= -1e-9).all()


@LAWS
@given(seed=SEEDS)
def test_a_corner_and_a_speed_are_kept_together(seed):
    barriers = [SpeedBarrier(0.4, 50.0), PlaneBarrier((1.0, 0.0, 0.0), -0.03), PlaneBarrier((0.0, 0.0, 1.0), -0.03)]
    position, velocity, acceleration = move(barriers, seed)
    assert (position[..., 0] >= -0.03 - 1e-9).all()
    assert (position[..., 2] >= -0.03 - 1e-9).all()
    speed = velocity.norm(dim=-1)
    assert (speed[1:] <= allowed(speed[:-1], acceleration[1:], 0.4, 50.0)).all()


def test_without_its_term_for_the_control_step_the_barrier_would_be_broken():
    class Continuous(PlaneBarrier):
        def half_space(self, position, velocity, inertia, dt):
            return super().half_space(position, velocity, inertia, 0.0)

    def lowest(kind):
        position, velocity, _ = move([kind(offset=-0.01, rate=80.0)], 0, force=500.0)
        return (velocity[..., 2] + 80 * (position[..., 2] + 0.01)).min()

    assert lowest(PlaneBarrier) >= -1e-9
    assert lowest(Continuous) < -0.05

"""Attack the tank at the motors on the simulated arm, and measure what is executed.

Each attack is a policy that tries to get more power or work through than the tank allows. The executed power is torque
times joint velocity at every control step, as the environment receives and observes them, evaluated in double
precision; beside it stands what happened at the rate of the physics: within a control step the torque is held while the
velocity changes. The paper's law does not see that; ``--mode rate`` bounds what the torque itself does to the velocity,
``--mode impact`` what contact and Coriolis forces do as well.

``python benchmarks/attacks.py --steps 100000``
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.envs import Compose, Transform, TransformedEnv

from ppt_rl.envs import EngineConfig, PandaEnv
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.tasks import damping_key, motor_tank
from ppt_rl.training import run_script
from ppt_rl.transforms import EnergyTankTransform, ImpedanceTransform, JointTorqueTransform

__all__ = ["ATTACKS", "attack"]

#: From the observed tensordict and random numbers, an action.
Policy = Callable[[dict[str, Tensor], torch.Generator], Tensor]


@dataclass(frozen=True)
class Config:
    """Attack the tank and measure.

    Attributes:
        steps: control steps of each attack, summed over environments.
        num_envs: environments that step together.
        threads: physics threads; 0 takes one per CPU.
        p_max: power limit [W].
        e_max: capacity [J].
        mode: law of the tank. Where braking is free, only power that leaves the robot counts, and its net work; where
            the law reads a damping and no impedance writes it, the policy invents one.
        json: print one line of JSON only.
    """

    steps: int = 100_000
    num_envs: int = 64
    threads: int = 0
    p_max: float = 2.0
    e_max: float = 3.0
    mode: str = "paper"
    json: bool = False


def _normal(read: dict[str, Tensor], size: int, generator: torch.Generator) -> Tensor:
    return torch.randn(len(read["twist"]), size, generator=generator)


def _perpendicular(read: dict[str, Tensor], generator: torch.Generator) -> Tensor:
    """A wrench of a thousand newtons without any power: only limits joint by joint would give it some."""
    wrench, twist = 1e3 * _normal(read, 6, generator), read["twist"]
    return wrench - twist * (wrench * twist).sum(-1, keepdim=True) / twist.square().sum(-1, keepdim=True).clamp_min(
        1e-12
    )


def _huge(read: dict[str, Tensor], generator: torch.Generator) -> Tensor:
    """Ten billion newton metres straight at the tank, without power: what is left of it drowns in rounding."""
    velocity = read["joint_velocity"]
    torque = 1e10 * _normal(read, velocity.shape[-1], generator)
    along = (torque * velocity).sum(-1, keepdim=True) / velocity.square().sum(-1, keepdim=True).clamp_min(1e-12)
    return torque - velocity * along


def _random(read: dict[str, Tensor], generator: torch.Generator) -> Tensor:
    return 100.0 * _normal(read, 6, generator)


def _bang_bang(read: dict[str, Tensor], generator: torch.Generator) -> Tensor:
    """The largest torque of every joint, along its velocity, reversed at random."""
    sign = torch.where(torch.rand(len(read["twist"]), 1, generator=generator) < 0.1, -1.0, 1.0)
    return 100.0 * sign * torch.where(read["joint_velocity"] < 0, -1.0, 1.0)


def _posture(read: dict[str, Tensor], generator: torch.Generator) -> Tensor:
    """A reference at the tool: only a posture with a stiffness of 1000 N m/rad acts."""
    return torch.cat([read["pose"], read["twist"]], -1)


def _residual(read: dict[str, Tensor], generator: torch.Generator) -> Tensor:
    """A reference a million metres away, held by a spring of 100,000 N/m."""
    far = 1e6 * _normal(read, 3, generator)
    return torch.cat([read["pose"][:, :3] + far, read["pose"][:, 3:], 1e3 * _normal(read, 6, generator)], -1)


def _wrench(base: PandaEnv, damping: str | None, posture_stiffness: float = 10.0) -> list[Transform]:
    kinematics = Kinematics(base.arm, base.tool_length)
    return [JointTorqueTransform(kinematics, posture_stiffness=posture_stiffness, damping_key=damping)]


def _reference(
    base: PandaEnv, damping: str | None, stiffness: float = 400.0, posture_stiffness: float = 10.0
) -> list[Transform]:
    spring = ImpedanceTransform(CartesianImpedanceController(stiffness), damping_key=damping)
    return [*_wrench(base, damping, posture_stiffness), EnergyTankTransform(flow_key="twist"), spring]


#: Policy and the transforms that it acts through, after the tank at the motors, by name. The latter are made for an
#: environment and the key of the damping.
ATTACKS: dict[str, tuple[Policy, Callable[[PandaEnv, str | None], list[Transform]]]] = {
    "random": (_random, _wrench),
    "perpendicular": (_perpendicular, _wrench),
    "bang-bang": (_bang_bang, lambda base, damping: []),
    "1e10 N m": (_huge, lambda base, damping: []),
    "posture 1000 N m/rad": (_posture, lambda base, damping: _reference(base, damping, posture_stiffness=1000.0)),
    "reference 1e6 m away": (_residual, lambda base, damping: _reference(base, damping, stiffness=1e5)),
}


@torch.no_grad()
def attack(name: str, run: Config, *, seed: int = 0) -> dict[str, float]:
    """Run one attack.

    Args:
        name: one of :data:`ATTACKS`.
        run: size of the attack and limits of the tank.
        seed: of the policy's random numbers.

    Returns:
        ``power`` and ``work``, the largest executed at control rate as shares of ``p_max`` and ``e_max``;
        ``closed``, share of the control steps in which the valve was not fully open; ``true_power`` [W] and
        ``true_work`` [J], the largest at the rate of the physics; ``net_energy``, the largest that the torque has
        delivered in an episode so far, braking subtracted, as a share of ``e_max``: the sum of torque times change of
        joint position, which is exact for a torque that is held; ``steps``.
    """
    policy, chain = ATTACKS[name]
    base = PandaEnv(
        run.num_envs, duration=3.0, seed=seed, engine=EngineConfig(num_threads=run.threads or None, audit=True)
    )
    law = () if run.mode == "paper" else (run.mode, base.arm)
    transforms, key = chain(base, damping_key(run.mode)), damping_key(run.mode)
    env = TransformedEnv(base, Compose(motor_tank(run.p_max, run.e_max, *law), *transforms))
    braking_counts = run.mode in ("paper", "rate", "impact")
    executed = _watched(base)
    generator, most = torch.Generator().manual_seed(seed), torch.zeros(5, dtype=torch.float64)
    done, td, closed = 0, env.reset(), 0
    work, net = torch.zeros(2, run.num_envs, dtype=torch.float64)
    while done < run.steps:
        read = {key: td[key] for key in ("pose", "twist", "joint_position", "joint_velocity")}
        if key is not None:
            td[key] = 100.0 * _normal(read, 6 if transforms else 7, generator)
        stepped, td = env.step_and_maybe_reset(td.set("action", policy(read, generator)))
        power = (executed[-1].double() * read["joint_velocity"].double()).sum(-1)
        power = power.abs() if braking_counts else power
        work += 0.01 * power
        moved = stepped["next", "joint_position"].double() - read["joint_position"].double()
        net += (executed[-1].double() * moved).sum(-1)
        audit = stepped["next", "audit"]
        figures = power.max(), work.max(), audit["commanded_power"].max(), audit["commanded_work"].max(), net.max()
        most = torch.maximum(most, torch.stack([figure.double() for figure in figures]))
        closed += int((stepped["next", "motor_valve"] < 1).sum())
        over = stepped["next", "done"].squeeze(-1)
        work[over], net[over] = 0.0, 0.0
        done += run.num_envs
    env.close()
    power_share, work_share = float(most[0]) / run.p_max, float(most[1]) / run.e_max
    return {
        "power": power_share, "work": work_share, "closed": closed / done, "true_power": float(most[2]),
        "true_work": float(most[3]), "net_energy": float(most[4]) / run.e_max, "steps": done,
    }  # fmt: skip


def _watched(base: PandaEnv) -> list[Tensor]:
    """A list of one tensor: the torque that the engine executes."""
    executed: list[Tensor] = [torch.empty(0)]
    checked = base._checked_action

    def spy(action: Tensor, mask: Tensor | None) -> Tensor:
        executed[0] = checked(action, mask)
        return executed[0]

    base._checked_action = spy  # type: ignore[method-assign]
    return executed


def main(run: Config) -> None:
    """Attack and print."""
    torch.set_num_threads(1)
    results = {name: attack(name, run) for name in ATTACKS}
    if run.json:
        print(json.dumps(results))
        return
    limits = f"power / {run.p_max} W | work / {run.e_max} J"
    print(f"| attack | steps | {limits} | valve < 1 | true power [W] | true work [J] | net energy / {run.e_max} J |")
    print("|---|---|---|---|---|---|---|---|")
    for name, result in results.items():
        print(
            f"| {name} | {result['steps']:,} | {result['power']:.7f} | {result['work']:.7f} | {result['closed']:.2f} | "
            f"{result['true_power']:.3g} | {result['true_work']:.3g} | {result['net_energy']:.3g} |"
        )


if __name__ == "__main__":
    run_script(main, Config)

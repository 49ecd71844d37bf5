"""Light links on stiff springs: fast, small motion beside slow, large motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...system.system import System
from .check import DEFECT, PER_RADIAN, Case, Cases, Check, Trial, tolerance
from .closed_forms import discs
from .defect import defect
from .made_robots import body, disc_stack, serial

_RTOL = 1e-10


def _cases(trial: Trial) -> Cases:
    for stiff in trial.pick((1e6,), (1e2, 1e4, 1e6)):
        yield _twisting(trial, stiff)
    for stiff in trial.pick((1e4,), (1e2, 1e4, 1e6)):
        system = _arm(1e-2)
        traj = trial.simulate(
            system,
            x0=[0.3, -0.2, 0.4],
            xdot0=[0.5, 0.1, -0.2],
            xi0=[0.1, 0.0, 0.0, 0.2, -0.1, 0.3],
            duration=1.0,
            springs=dict.fromkeys(system.shape_names, (stiff, 0.1)),
            **tolerance(_RTOL),
        )
        yield Case(
            f"arm of 1 % of the mass, {stiff:.0e} N·m/rad", defect(traj, system) / _RTOL, DEFECT
        )


def _twisting(trial: Trial, stiff: float) -> Case:
    """A light disc on a stiff spring and a heavy one on a soft spring, in closed form."""
    moments, stiffness = np.array([1.0, 1e-3, 1.0]), np.array([stiff, 1.0])
    x0, rates = np.array([1e-3, 0.5]), np.array([0.4, 0.0, 0.2])
    times = np.linspace(0.0, 1.0, 41)
    first, twists = discs(moments, stiffness, x0, rates, times)
    system = disc_stack(moments.tolist())
    springs = {name: (k, 0.0) for name, k in zip(system.shape_names, stiffness, strict=True)}
    traj = trial.simulate(
        system,
        x0=x0,
        xdot0=rates[1:],
        xi0=rates[:1],
        times=times,
        springs=springs,
        **tolerance(_RTOL),
    )
    size = np.abs(twists).max(axis=0)
    error = max((np.abs(traj.x - twists) / size).max(), np.abs(traj.pose[:, 0] - first).max())
    fastest = float(np.sqrt(stiff / moments.min()))
    return Case(f"discs, {stiff:.0e} N·m/rad", float(error) / _RTOL, PER_RADIAN * fastest)


def _arm(mass: float) -> System:
    base = body(1.0, [0.0, 0.0, 0.0], [0.1, 0.15, 0.2])
    link = body(mass, [0.1, 0.0, 0.02], mass * np.array([0.01, 0.02, 0.025]))
    joints = (pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRY())
    arm = [(joint, [0.2, 0.0, 0.1], link) for joint in joints]
    return serial("springs", [(pin.JointModelFreeFlyer(), [0.0] * 3, base), *arm])


CHECK = Check("stiff_springs", "error of discs, or defect of a step, per tolerance", _cases)

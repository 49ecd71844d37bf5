"""Check of spins up to 1e4 rad/s of a single body, of reaction wheels, and of a robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...judge.step_defects import largest_defect
from ...system.load import load
from .check import DEFECT, PER_RADIAN, Case, Cases, Check, Trial, tolerance
from .closed_forms import euler_top, symmetric_top
from .generated_robots import single

_RTOL = 1e-10
_MOMENTS = np.array([1.0, 2.0, 2.5])
_TIMES = np.linspace(0.0, 1.0, 41)
_AXIS = np.array([0.3, 0.4, 0.85])


def _cases(trial: Trial) -> Cases:
    for spin in trial.pick((1e4,), (1.0, 1e2, 1e4)):
        options = tolerance(_RTOL)
        bound = PER_RADIAN * max(1.0, spin)
        omega = spin * _AXIS
        rates, _ = euler_top(_MOMENTS, omega, _TIMES)
        traj = trial.simulate(single(_MOMENTS), xi0=omega, times=_TIMES, **options)
        error = np.abs(traj.xi - rates).max() / spin / _RTOL
        yield Case(f"Euler's top, {spin:g} rad/s, body rates", float(error), bound)

        expected = symmetric_top(2.0, 1.0, omega, _TIMES)
        traj = trial.simulate(single([2.0, 2.0, 1.0]), xi0=omega, times=_TIMES, **options)
        attitudes = np.array([pin.Quaternion(pose).matrix() for pose in traj.pose])
        error = np.abs(attitudes - expected).max() / _RTOL
        yield Case(f"symmetric top, {spin:g} rad/s, attitude", float(error), bound)

        system = load("reaction_wheel_satellite")
        traj = trial.simulate(
            system,
            x0=[0.4, 0.0, 0.0, 0.0],
            xdot0=[0.2, spin, -0.8 * spin, 0.6 * spin],
            xi0=[0.0, 0.0, 0.0, 0.05, -0.04, 0.06],
            duration=1.0,
            **options,
        )
        yield Case(f"wheels, {spin:g} rad/s, defect", largest_defect(traj, system) / _RTOL, DEFECT)

        system = load("falling_cat")
        traj = trial.simulate(
            system,
            x0=[0.5, 0.2, -0.3],
            xi0=np.append(np.zeros(3), omega),
            duration=10.0 / spin,
            **options,
        )
        yield Case(
            f"a spinning cat, {spin:g} rad/s, defect", largest_defect(traj, system) / _RTOL, DEFECT
        )


CHECK = Check("spins", "error after 1 s, or defect of a step, per tolerance", _cases)

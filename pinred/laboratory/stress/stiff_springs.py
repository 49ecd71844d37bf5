"""Check of light links on stiff springs: fast small motions superposed on slow large ones."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...judge.step_defects import largest_defect
from ...system.system import System
from .check import DEFECT, PER_RADIAN, Case, Cases, Check, Trial, tolerance
from .generated_robots import body, serial
from .sprung_discs import SprungDiscs

_RTOL = 1e-10


def _cases(trial: Trial) -> Cases:
    for stiff in trial.pick((1e6,), (1e2, 1e4, 1e6)):
        yield _check_discs(trial, stiff)
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
            f"arm of 1 % of the mass, {stiff:.0e} N·m/rad",
            largest_defect(traj, system) / _RTOL,
            DEFECT,
        )


def _check_discs(trial: Trial, stiff: float) -> Case:
    """Compare a light disc on a stiff spring, and a heavy disc on a soft one, with closed forms."""
    discs = SprungDiscs(
        moments=np.array([1.0, 1e-3, 1.0]),
        stiffness=np.array([stiff, 1.0]),
        x0=np.array([1e-3, 0.5]),
        rates=np.array([0.4, 0.0, 0.2]),
        times=np.linspace(0.0, 1.0, 41),
    )
    traj = trial.simulate(discs.system, **discs.start, **discs.run, **tolerance(_RTOL))
    error = discs.error(traj, relative=True) / _RTOL
    fastest = float(np.sqrt(stiff / discs.moments.min()))
    return Case(f"discs, {stiff:.0e} N·m/rad", error, PER_RADIAN * fastest)


def _arm(mass: float) -> System:
    base = body(1.0, [0.0, 0.0, 0.0], [0.1, 0.15, 0.2])
    link = body(mass, [0.1, 0.0, 0.02], mass * np.array([0.01, 0.02, 0.025]))
    joints = (pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRY())
    arm = [(joint, [0.2, 0.0, 0.1], link) for joint in joints]
    return serial("springs", [(pin.JointModelFreeFlyer(), [0.0] * 3, base), *arm])


CHECK = Check("stiff_springs", "error of discs, or defect of a step, per tolerance", _cases)

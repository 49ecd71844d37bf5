"""Masses up to 1e8 apart: a light base, a light link, a heavy load.

A momentum that is a small difference of large ones has the round-off of the large ones: a body
that is lighter than its neighbours by a factor has its rate to that factor times eps at best.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...system.system import System
from .check import DEFECT, EPS, Case, Cases, Check, Trial, tolerance
from .closed_forms import discs
from .defect import defect
from .made_robots import disc_stack, serial

_RTOL = 1e-10
_ROUNDING = 20.0  # of eps times the ratio


def _cases(trial: Trial) -> Cases:
    for ratio in trial.pick((1e8,), (1e2, 1e4, 1e6, 1e8)):
        bound = DEFECT + _ROUNDING * EPS * ratio / _RTOL
        for place, name in enumerate(("base", "first link", "second link", "last link")):
            for factor, what in ((1.0 / ratio, "light"), (ratio, "heavy")):
                masses = np.ones(4)
                masses[place] = factor
                system = _chain(masses)
                traj = trial.simulate(
                    system,
                    x0=[0.3, -0.5, 0.4],
                    xdot0=[0.6, -0.4, 0.8],
                    xi0=[0.1, 0.2, -0.1, 0.3, -0.2, 0.4],
                    duration=2.0,
                    **tolerance(_RTOL),
                )
                steps = trial.pick(50, 200)
                found = defect(traj, system, steps=steps) / _RTOL
                yield Case(f"{what} {name}, 1 : {ratio:.0e}, defect", found, bound)
        for moments in ((1.0, 1.0 / ratio), (1.0 / ratio, 1.0)):
            yield _swinging(trial, np.array(moments), f"discs {moments[0]:g} : {moments[1]:g}")


def _chain(masses: np.ndarray) -> System:
    joints = (pin.JointModelFreeFlyer(), pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    return serial(
        "ratios",
        [
            (joint, [0.3, 0.1, -0.2], pin.Inertia(m, np.array([0.1, 0.02, 0.03]), m * _MOMENTS))
            for joint, m in zip(joints, masses, strict=True)
        ],
    )


_MOMENTS = np.diag([0.02, 0.05, 0.06])


def _swinging(trial: Trial, moments: np.ndarray, name: str) -> Case:
    """Two discs on a spring, in closed form: ten seconds of about one radian per second each."""
    system, times = disc_stack(moments.tolist()), np.linspace(0.0, 10.0, 51)
    stiffness = np.array([40.0 * moments.min()])
    x0, rates = np.array([0.5]), np.array([0.3, 0.3])
    first, twists = discs(moments, stiffness, x0, rates, times)
    traj = trial.simulate(
        system,
        x0=x0,
        xdot0=rates[1:],
        xi0=rates[:1],
        times=times,
        springs={system.shape_names[0]: (stiffness[0], 0.0)},
        **tolerance(_RTOL),
    )
    error = max(np.abs(traj.x - twists).max(), np.abs(traj.pose[:, 0] - first).max())
    turned = np.sqrt(stiffness[0] * (1.0 / moments).sum()) * times[-1]
    bound = turned * (1.0 + _ROUNDING * EPS * moments.max() / moments.min() / _RTOL)
    return Case(f"{name}, against the closed form", float(error / _RTOL), bound)


CHECK = Check("mass_ratios", "defect of a step, and error of discs, per tolerance", _cases)

"""Check of extreme inertias: plates at the limit of the triangle inequality, and thin rods."""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...judge.step_defects import largest_defect
from .check import DEFECT, PER_RADIAN, Case, Cases, Check, Trial, tolerance
from .closed_forms import euler_top
from .generated_robots import TUMBLING, body, single, tumbling_arm

_RTOL = 1e-10
_TIMES = np.linspace(0.0, 10.0, 41)
_OMEGA = np.array([0.3, 0.4, 1.2])


def _cases(trial: Trial) -> Cases:
    for short in trial.pick((0.0,), (1e-2, 1e-6, 1e-10, 0.0)):
        moments = np.array([1.0, 2.0, 3.0 * (1.0 - short)])
        rates, _ = euler_top(moments, _OMEGA, _TIMES)
        traj = trial.simulate(single(moments), xi0=_OMEGA, times=_TIMES, **tolerance(_RTOL))
        error = float(np.abs(traj.xi - rates).max()) / _RTOL
        bound = PER_RADIAN * float(np.linalg.norm(_OMEGA)) * float(_TIMES[-1])
        yield Case(f"plate, I₁ + I₂ − I₃ = {short:.0e} I₃, body rates", error, bound)
        defect = _tumbling_defect(trial, 0.02 * moments)
        yield Case(f"arm of plates, {short:.0e}, defect", defect, DEFECT)
    for thin in trial.pick((1e-10,), (1e-2, 1e-6, 1e-10)):
        moments = 0.02 * np.array([thin, 1.0, 1.0 + 0.5 * thin])
        defect = _tumbling_defect(trial, moments)
        yield Case(f"arm of rods, thin to {thin:.0e}, defect", defect, DEFECT)


def _tumbling_defect(trial: Trial, moments: Array) -> float:
    system = tumbling_arm("flat", [body(1.0, [0.1, 0.05, 0.0], moments)] * 4)
    traj = trial.simulate(system, **TUMBLING, duration=5.0, **tolerance(_RTOL))
    return largest_defect(traj, system) / _RTOL


CHECK = Check("flat_bodies", "error of body rates, or defect of a step, per tolerance", _cases)

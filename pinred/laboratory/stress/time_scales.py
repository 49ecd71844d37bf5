"""Check of very short and very long time scales, together in one motion and separately."""

from __future__ import annotations

import numpy as np

from .check import PER_RADIAN, Case, Cases, Check, Trial, dop853, tolerance
from .closed_forms import euler_top
from .generated_robots import single
from .sprung_discs import SprungDiscs

_RTOL = 1e-10
_MOMENTS = np.array([1.0, 2.0, 2.5])
_OMEGA = np.array([0.5, 0.7, 1.6])


def _cases(trial: Trial) -> Cases:
    for ratio in trial.pick((1e2,), (1e2, 1e3, 1e4)):
        yield _check_two_scales(trial, ratio)
    # Each case rotates by the same angle, over a very short or very long time.
    for seconds in trial.pick((1e-9, 1e9), (1e-12, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9, 1e12)):
        times = seconds * np.linspace(0.0, 10.0, 21)
        omega = _OMEGA / seconds
        rates, _ = euler_top(_MOMENTS, omega, times)
        method = dop853(0.1 * _RTOL, 1e-30)
        traj = trial.simulate(single(_MOMENTS), xi0=omega, times=times, method=method)
        error = float(np.abs(traj.xi - rates).max() / np.abs(omega).max())
        bound = PER_RADIAN * 10.0 * float(np.linalg.norm(_OMEGA))
        yield Case(f"a top of some rad per {seconds:.0e} s", error / _RTOL, bound)


def _check_two_scales(trial: Trial, ratio: float) -> Case:
    """Compare discs whose springs have stiffness ratio² : 1 with the closed form."""
    discs = SprungDiscs(
        moments=np.array([1.0, 2.0, 1.5]),
        stiffness=np.array([ratio**2, 1.0]),
        x0=np.array([0.3 / ratio, 0.4]),
        rates=np.array([0.2, 0.1, -0.3]),
        times=np.linspace(0.0, 20.0, 101),
    )
    starts = {name: value[None] for name, value in discs.start.items()}
    many = trial.simulate_many(discs.system, **starts, **discs.run, **tolerance(_RTOL))
    error = discs.error(many[0], relative=True) / _RTOL
    angle = ratio * float(discs.times[-1])
    return Case(f"two springs, {ratio:.0e} apart", error, PER_RADIAN * angle)


CHECK = Check("time_scales", "error against closed forms, relative, per tolerance", _cases)

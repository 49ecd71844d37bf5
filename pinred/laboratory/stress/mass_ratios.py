"""Check of mass ratios up to 1e8: light bases, light links, heavy loads.

A momentum that is a small difference of large momenta has their round-off. Therefore the rate of a
body that is lighter than its neighbours by a factor has a relative error of at least that factor
times eps.
"""

from __future__ import annotations

import numpy as np

from ...judge.step_defects import largest_defect
from .check import DEFECT, EPS, Case, Cases, Check, Trial, tolerance
from .generated_robots import TUMBLING, body, tumbling_arm
from .sprung_discs import SprungDiscs

_RTOL = 1e-10
_ROUNDING = 20.0  # bound on round-off in units of eps times the mass ratio
_MOMENTS = np.array([0.02, 0.05, 0.06])  # principal moments of a link of 1 kg [kg·m²]


def _cases(trial: Trial) -> Cases:
    for ratio in trial.pick((1e2, 1e8), (1e2, 1e4, 1e6, 1e8)):
        bound = DEFECT + _ROUNDING * EPS * ratio / _RTOL
        for index, name in enumerate(("base", "first link", "second link", "last link")):
            for factor, label in ((1.0 / ratio, "light"), (ratio, "heavy")):
                masses = np.ones(4)
                masses[index] = factor
                system = tumbling_arm(
                    "ratios", [body(m, [0.1, 0.02, 0.03], m * _MOMENTS) for m in masses]
                )
                traj = trial.simulate(system, **TUMBLING, duration=2.0, **tolerance(_RTOL))
                steps = trial.pick(50, 200)
                defect = largest_defect(traj, system, max_steps=steps) / _RTOL
                yield Case(f"{label} {name}, 1 : {ratio:.0e}, defect", defect, bound)
        for moments in ((1.0, 1.0 / ratio), (1.0 / ratio, 1.0)):
            yield _check_discs(trial, np.array(moments), f"discs {moments[0]:g} : {moments[1]:g}")


def _check_discs(trial: Trial, moments: np.ndarray, name: str) -> Case:
    """Compare two discs on a spring with the closed form over ten seconds, about 1 rad/s each."""
    discs = SprungDiscs(
        moments=moments,
        stiffness=np.array([40.0 * moments.min()]),
        x0=np.array([0.5]),
        rates=np.array([0.3, 0.3]),
        times=np.linspace(0.0, 10.0, 51),
    )
    traj = trial.simulate(discs.system, **discs.start, **discs.run, **tolerance(_RTOL))
    angle = np.sqrt(discs.stiffness[0] * (1.0 / moments).sum()) * discs.times[-1]
    bound = angle * (1.0 + _ROUNDING * EPS * moments.max() / moments.min() / _RTOL)
    return Case(f"{name}, against the closed form", discs.error(traj) / _RTOL, bound)


CHECK = Check("mass_ratios", "defect of a step, and error of discs, per tolerance", _cases)

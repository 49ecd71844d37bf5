"""Chaotic motions, checked by the defects of steps, because final errors carry no information."""

from __future__ import annotations

import numpy as np

from ...judge.step_defects import largest_defect
from ...system.load import load
from .check import DEFECT, EPS, Case, Cases, Check, Trial, tolerance

_ROUNDING = 2e3  # bound on round-off in units of eps; rates amplify the round-off of momenta
# Factor of the initial rates, and a duration [s] over which chaos amplifies any initial error.
_SCENES: dict[str, tuple[float, float]] = {
    "planar_chain5": (5.0, 100.0),
    "falling_cat": (5.0, 100.0),
    "satellite_two_arms": (5.0, 100.0),
    "double_spherical_pendulum": (4.0, 50.0),
}


def _cases(trial: Trial) -> Cases:
    names = trial.pick(("planar_chain5",), tuple(_SCENES))
    for name in names:
        system, (faster, duration) = load(name), _SCENES[name]
        assert system.initial is not None
        start = system.initial
        for rtol in trial.pick((1e-10,), (1e-6, 1e-10, 1e-13)):
            for method in trial.methods(rtol):
                traj = trial.simulate(
                    system,
                    x0=start.x,
                    xdot0=faster * start.xdot,
                    xi0=faster * start.xi,
                    times=np.array([duration]),
                    method=method,
                    **tolerance(rtol),
                )
                defect = largest_defect(traj, system) / rtol
                bound = DEFECT + _ROUNDING * EPS / rtol
                yield Case(f"{name}, {traj.run.method}, {duration:g} s, {rtol:.0e}", defect, bound)


CHECK = Check("chaos", "defect of a step, per tolerance", _cases)

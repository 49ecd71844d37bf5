"""Between the ends of steps: does what is reported there obey the equations as well?"""

from __future__ import annotations

from ...judge.step_defects import largest_defect
from ...system.catalogue import bundled_robots
from ...system.load import load
from .check import Case, Cases, Check, Trial, tolerance

_BOUND = 50.0  # the interpolant is of an order below the method, and no error control sees it


def _cases(trial: Trial) -> Cases:
    for name in trial.pick(("falling_cat",), tuple(bundled_robots())):
        system = load(name)
        for rtol in trial.pick((1e-10,), (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)):
            for method in trial.methods(rtol):
                traj = trial.simulate(system, method=method, **tolerance(rtol))
                found = largest_defect(traj, system, subintervals=True) / rtol
                yield Case(f"{name}, {traj.run.method}, {rtol:.0e}", found, _BOUND)


CHECK = Check("between", "defect of half a step, per tolerance", _cases)

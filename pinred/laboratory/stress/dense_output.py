"""Check that dense output satisfies the equations of motion between step ends."""

from __future__ import annotations

from ...judge.step_defects import largest_defect
from ...system.catalogue import bundled_robots
from ...system.load import load
from .check import Case, Cases, Check, Trial, tolerance

_BOUND = 50.0  # largest defect, in tolerances; dense output has a lower order and no error control


def _cases(trial: Trial) -> Cases:
    for name in trial.pick(("falling_cat",), tuple(bundled_robots())):
        system = load(name)
        for rtol in trial.pick((1e-10,), (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)):
            for method in trial.methods(rtol):
                traj = trial.simulate(system, method=method, **tolerance(rtol))
                defect = largest_defect(traj, system, subintervals=True) / rtol
                yield Case(f"{name}, {traj.run.method}, {rtol:.0e}", defect, _BOUND)


CHECK = Check("between", "defect of half a step, per tolerance", _cases)

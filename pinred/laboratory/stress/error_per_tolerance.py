"""Check of errors relative to tolerances from 1e-4 to 1e-13 on every bundled robot."""

from __future__ import annotations

from ...scene.scene import Scene
from ...system.catalogue import bundled_robots
from ...system.load import load
from .aba_reference import aba_reference, samples
from .check import PER_GROWTH, Case, Cases, Check, Trial, tolerance

_SHORT = ("planar_chain5", "falling_cat")


def _cases(trial: Trial) -> Cases:
    exponents = trial.pick((4, 8, 13), tuple(range(4, 14)))
    for name in trial.pick(_SHORT, tuple(bundled_robots())):
        scene = Scene(system=load(name))
        times = samples(scene)
        reference = aba_reference(scene, times)
        for k in exponents:
            rtol = 10.0**-k
            for method in trial.methods(rtol):
                traj = trial.simulate(scene.system, method=method, **tolerance(rtol))
                error = reference.error(traj, times) / rtol
                yield Case(f"{name}, {traj.run.method}, {rtol:.0e}", error, PER_GROWTH)


CHECK = Check("tolerances", "error by ABA over 10 s, relative, per tolerance", _cases)

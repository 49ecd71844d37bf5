"""Forward in time and back again: does the motion return to where it began?"""

from __future__ import annotations

import numpy as np

from ...judge.distances import FullMotion
from ...scene.scene import Scene
from ...system.catalogue import bundled_robots
from ...system.load import load
from .aba_reference import samples, truth_of
from .check import PER_GROWTH, Case, Cases, Check, Trial, tolerance

_RTOL = 1e-10


def _cases(trial: Trial) -> Cases:
    for name in trial.pick(("falling_cat", "cartpole"), tuple(bundled_robots())):
        system = load(name)
        scene = Scene(system=system)
        start, end = scene.start, np.array([scene.end])
        truth = truth_of(scene, samples(scene))
        there = trial.simulate(system, times=end, **tolerance(_RTOL))
        back = trial.simulate(
            system,
            pose0=there.pose[-1],
            x0=there.x[-1],
            xdot0=-there.xdot[-1],
            xi0=-there.xi[-1],
            times=end,
            **tolerance(_RTOL),
        )
        first = FullMotion(x=start.x[None], q=system.q(start.pose, start.x)[None])
        where = truth.full.distance(first, FullMotion(x=back.x, q=back.q)).worst(truth.size)
        rates = np.concatenate([start.xi, start.xdot])
        missed = np.abs(np.concatenate([back.xi[-1], back.xdot[-1]]) + rates).max()
        error = max(where, float(missed / np.abs(rates).max()))
        yield Case(name, error / _RTOL, PER_GROWTH * truth.growth)


CHECK = Check("reversal", "error of the return, relative, per tolerance", _cases)

"""Check that a motion with reversed rates returns to its initial state."""

from __future__ import annotations

import numpy as np

from ...judge.distances import FullMotion
from ...scene.scene import Scene
from ...system.catalogue import bundled_robots
from ...system.load import load
from .aba_reference import aba_reference, samples
from .check import PER_GROWTH, Case, Cases, Check, Trial, tolerance

_RTOL = 1e-10


def _cases(trial: Trial) -> Cases:
    for name in trial.pick(("falling_cat", "cartpole"), tuple(bundled_robots())):
        system = load(name)
        scene = Scene(system=system)
        start, end = scene.start, np.array([scene.end])
        reference = aba_reference(scene, samples(scene))
        forward = trial.simulate(system, times=end, **tolerance(_RTOL))
        back = trial.simulate(
            system,
            pose0=forward.pose[-1],
            x0=forward.x[-1],
            xdot0=-forward.xdot[-1],
            xi0=-forward.xi[-1],
            times=end,
            **tolerance(_RTOL),
        )
        initial = FullMotion(x=start.x[None], q=system.q(start.pose, start.x)[None])
        final = FullMotion(x=back.x, q=back.q)
        pose_error = reference.full.distance(initial, final).worst(reference.size)
        rates = np.concatenate([start.xi, start.xdot])
        rate_error = np.abs(np.concatenate([back.xi[-1], back.xdot[-1]]) + rates).max()
        error = max(pose_error, float(rate_error / np.abs(rates).max()))
        yield Case(name, error / _RTOL, PER_GROWTH * reference.growth)


CHECK = Check("reversal", "error of the return, relative, per tolerance", _cases)

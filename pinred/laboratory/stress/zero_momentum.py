"""Check that kernels with and without momentum agree in the limit of zero momentum."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.arrays import Array
from ...judge.distances import FullMotion
from ...scene.scene import Scene
from ...system.load import load
from .aba_reference import aba_reference
from .check import Case, Cases, Check, Trial, tolerance

_RTOL = 1e-10
_DIRECTION = {
    "falling_cat": np.array([0.0, 0.0, 0.0, 0.6, -0.64, 0.48]),
    "planar_chain5": np.array([0.0, 0.0, 1.0]),
    "elroys_beanie": np.array([1.0]),
    "double_spherical_pendulum": np.array([1.0]),
}


def _cases(trial: Trial) -> Cases:
    for name in trial.pick(("falling_cat",), tuple(_DIRECTION)):
        system, direction = load(name), _DIRECTION[name]
        assert system.initial is not None
        options: dict[str, Any] = {
            "x0": system.initial.x,
            "xdot0": system.initial.xdot,
            "times": np.array([1.0]),
            **tolerance(_RTOL),
        }
        # The sweep contains 1e-16 … 1e3 with both signs, and zero.
        most = trial.pick(2, 3)
        sizes = 10.0 ** np.arange(-16, most + 1)
        sweep = np.concatenate([-sizes[::-1], [0.0], sizes])
        many = trial.simulate_many(system, momentum=sweep[:, None] * direction, **options)
        ends = [many[k] for k in range(len(sweep))]
        at_zero = ends[len(sizes)]
        # The effect of smaller momenta is bounded by the effect of 1e-3, which ABA measures.
        effect = _effect_by_aba(Scene(system=system, momentum=1e-3 * direction, **options), options)
        for k in np.flatnonzero(np.abs(sweep) <= 1e-3):
            jump = float(np.abs(ends[k].x - at_zero.x).max())
            bound = 2.0 * effect * abs(sweep[k]) / 1e-3 + _RTOL
            yield Case(f"{name}, momentum {sweep[k]:.0e}, from that at zero", jump, bound)
        for k in np.flatnonzero(
            np.isin(sweep, trial.pick((0.0, 1.0), (0.0, 1e-16, 1e-8, 1e-2, 1.0)))
        ):
            size = sweep[k]
            scene = Scene(system=system, momentum=size * direction, **options)
            reference = aba_reference(scene, scene.report_times)
            error = reference.error_of(FullMotion(x=ends[k].x, q=ends[k].q))
            bound = 10 * _RTOL * reference.growth
            yield Case(f"{name}, momentum {size:.0e}, by ABA", error, bound)


def _effect_by_aba(scene: Scene, options: dict[str, Any]) -> float:
    """Compute with ABA the change of the final shape that the momentum causes."""
    at_zero = Scene(system=scene.system, momentum=0, **options)
    a, b = (_final_shape_by_aba(each) for each in (at_zero, scene))
    return float(np.abs(a - b).max())


def _final_shape_by_aba(scene: Scene) -> Array:
    return np.asarray(aba_reference(scene, scene.report_times).motion.x[-1])


CHECK = Check("zero_momentum", "difference of the ends; error by ABA", _cases)

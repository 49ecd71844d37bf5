"""The choice of an integrator for a scene that asks for none, with its reason.

A sweep of AdaptiveGauss evaluates eight stages at once, in lanes.  Where limbs of one build are
lanes already, that costs more of DOP853's evaluations; at tight tolerances it is worth more of
them.  The numbers below are fits to `pinred bench accuracy`: see docs/integrators.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log10

from ..common.arrays import Array
from ..integrators.methods import DOP853, DOP853_LEAST, AdaptiveGauss, Method, Radau
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.coupled_groups import Groups
from ..reduction.tree.limbs import Lanes, links_of
from ..scene.scene import Scene
from ..system.system import System
from .stiffness import rates_near_rest

_FEW = 3  # reports inside steps; each costs a step of AdaptiveGauss
_STABLE = 4.0  # decay over a step of DOP853 at the bound of its stability
_APART = 100.0  # decay over oscillation, which Radau must follow too
_MANY = 1000.0  # steps of DOP853 that Radau beats, for six joints; it solves linear systems
_SWEEP = 1.9  # evaluations that a sweep costs where no limbs are lanes
_LOOSEST, _AT_LOOSEST, _PER_DIGIT = 4.0, 1.0, 0.45  # evaluations that a sweep is worth
_SHORT = 100.0  # steps of DOP853 at that bound; those of AdaptiveGauss are shorter there


@dataclass(frozen=True)
class Choice:
    """An integrator, and why it is this one."""

    method: Method
    why: str


def choose(scene: Scene, stops: Array) -> Choice:
    """Return the integrator of a scene that stops at these times, (S,), with the reason."""
    if scene.integrator is not None:
        return Choice(scene.integrator, "the scene asks for it")
    rtol, atol = scene.tolerance
    dop853 = DOP853(max(rtol, DOP853_LEAST), atol)
    rates = rates_near_rest(scene)
    steps = rates.decay * scene.end / _STABLE
    if (
        rates.decay > _APART * rates.oscillation
        and steps > _MANY * max(1.0, scene.system.m / 6) ** 2
    ):
        told = f"forces decay at {rates.decay:.0e}/s: stability alone takes {steps:.0f} steps"
        return Choice(Radau(max(rtol, DOP853_LEAST), atol), told)
    inside = int((scene.report_times < scene.end).sum()) - int(scene.report_times[0] == 0.0)
    if inside > _FEW:
        return Choice(dop853, f"{inside} reports before the end cost it least")
    if scene.force_model is not None and len(stops) > 1:
        return Choice(dop853, "the scene is integrated in pieces")
    if scene.force_model is not None and scene.force_model.has_kinks:
        return Choice(dop853, "a force has kinks, which long steps do not see")
    if steps > _SHORT:
        return Choice(dop853, f"forces decay at {rates.decay:.0e}/s, which long steps do not bear")
    cost = _SWEEP * scene.system.workspace("limbs as lanes", lambda: _limbs(scene.system))
    worth = _AT_LOOSEST + _PER_DIGIT * max(0.0, -log10(scene.rtol) - _LOOSEST)
    told = f"{cost:.1f} evaluations a sweep, worth {worth:.1f} at rtol = {scene.rtol:g}"
    if cost < worth:
        return Choice(AdaptiveGauss(rtol, atol), told)
    return Choice(dop853, told)


def _limbs(system: System) -> float:
    """Return how many bodies there are for one that is computed on its own."""
    bodies = bodies_of(system)
    coupled = Groups(bodies, {}, system.coupled).members
    return len(bodies) / len(links_of(bodies, Lanes(), (), coupled))

"""The choice of an integrator for a scene that states none, with its reason.

A sweep of AdaptiveGauss evaluates eight stages at once, in SIMD lanes, and replaces evaluations of
DOP853.  It costs more of them if identical branches fill the lanes already, and replaces more of
them at tight tolerances.  The constants are fits to `pinred bench accuracy`; see
docs/integrators.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log10

from ..common.arrays import Array
from ..integrators.methods import DOP853, DOP853_LEAST, AdaptiveGauss, Method, Radau
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.coupled_groups import Groups
from ..reduction.tree.identical_branches import Lanes, links_of
from ..scene.scene import Scene
from ..system.system import System
from .stiffness import rates_near_rest

_FEW = 3  # Reports inside steps that AdaptiveGauss can afford; each costs one of its steps.
_STABLE = 4.0  # Decay over the longest stable step of DOP853.
# Ratio of decay to oscillation above which Radau is considered; it must resolve oscillations.
_STIFF_RATIO = 100.0
# Steps of DOP853, for six joints, above which Radau is faster although it solves linear systems.
_RADAU_STEPS = 1000.0
_SWEEP_COST = 1.9  # Evaluations of DOP853 that a sweep costs without identical branches.
# A sweep replaces _AT_LOOSEST evaluations at rtol = 10^−_LOOSEST, and _PER_DIGIT more per digit.
_LOOSEST, _AT_LOOSEST, _PER_DIGIT = 4.0, 1.0, 0.45
# Steps of DOP853 at its stability bound above which it is chosen; AdaptiveGauss needs more steps.
_STABILITY_STEPS = 100.0


@dataclass(frozen=True)
class Choice:
    """An integrator and the reason for its choice.

    Attributes:
        method: The integrator with its tolerances.
        why: The reason, as words for messages.
    """

    method: Method
    why: str


def choose(scene: Scene, stops: Array) -> Choice:
    """Return the integrator of a scene with the reason.  stops: times of stops, (S,) [s]."""
    if scene.integrator is not None:
        return Choice(scene.integrator, "the scene asks for it")
    rtol, atol = scene.tolerance
    dop853 = DOP853(max(rtol, DOP853_LEAST), atol)
    rates = rates_near_rest(scene)
    steps = rates.decay * scene.end / _STABLE
    if (
        rates.decay > _STIFF_RATIO * rates.oscillation
        and steps > _RADAU_STEPS * max(1.0, scene.system.m / 6) ** 2
    ):
        why = f"forces decay at {rates.decay:.0e}/s: stability alone takes {steps:.0f} steps"
        return Choice(Radau(max(rtol, DOP853_LEAST), atol), why)
    reports = int((scene.report_times < scene.end).sum()) - int(scene.report_times[0] == 0.0)
    if reports > _FEW:
        return Choice(dop853, f"{reports} reports before the end cost it least")
    if scene.force_model is not None and len(stops) > 1:
        return Choice(dop853, "the scene is integrated in segments")
    if scene.force_model is not None and scene.force_model.has_kinks:
        return Choice(dop853, "a force has kinks, which long steps miss")
    if steps > _STABILITY_STEPS:
        return Choice(dop853, f"forces decay at {rates.decay:.0e}/s, too fast for long steps")
    branches = scene.system.workspace("limbs as lanes", lambda: _limbs(scene.system))
    cost = _SWEEP_COST * branches
    worth = _AT_LOOSEST + _PER_DIGIT * max(0.0, -log10(scene.rtol) - _LOOSEST)
    why = f"{cost:.1f} evaluations a sweep, worth {worth:.1f} at rtol = {scene.rtol:g}"
    if cost < worth:
        return Choice(AdaptiveGauss(rtol, atol), why)
    return Choice(dop853, why)


def _limbs(system: System) -> float:
    """Return the number of bodies over the number computed separately from identical branches."""
    bodies = bodies_of(system)
    coupled = Groups(bodies, {}, system.coupled).members
    return len(bodies) / len(links_of(bodies, Lanes(), (), coupled))

"""Choice of an integrator, with the reason, for scenes that specify none.

A sweep is one iteration of AdaptiveGauss; it evaluates all eight stages at once in SIMD lanes.  A
sweep costs as much as several evaluations of DOP853, and more if identical branches of the robot
already fill the lanes.  It replaces more of these evaluations at tight tolerances.  The constants
are fits to `pinred bench accuracy`; see docs/integrators.md.

Forces are stiff if they decay fast. At zero momentum the linearisation of M ẍ = τ(x, ẋ) has K =
−∂τ/∂x and D = −∂τ/∂ẋ. The rates are the eigenvalues of [[0, 1], [−M⁻¹K, −M⁻¹D]].
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log10

import numpy as np

from ..common.arrays import Array
from ..common.errors import SingularInertiaError
from ..common.memo import once
from ..forces.force_model import ForceModel
from ..forces.force_numbers import BaseInSpace, ForceInputs
from ..integrators.methods import DOP853, DOP853_LEAST, AdaptiveGauss, Method, Radau
from ..reduction.pointwise_reduction import PointwiseReduction
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.coupled_groups import Groups
from ..reduction.tree.identical_branches import Lanes, links_of
from ..scene.scene import Scene
from ..system.system import System

# Largest number of report times inside steps with AdaptiveGauss; each of them costs a step.
_FEW = 3
_STABLE = 4.0  # Largest product of decay rate and step length at which DOP853 is stable.
# Costs of Radau, estimated from some of the scenes of `pinred bench methods`.  A step costs
# _RADAU_STEP evaluations of DOP853, and _RADAU_JOINT more for each joint, because of its linear
# systems.
_RADAU_STEP, _RADAU_JOINT = 10.0, 5.0
# Steps of Radau for the decay, and for each radian of the fastest oscillation, at rtol = _FITTED.
_RADAU_DECAY, _RADAU_RADIAN = 500.0, 45.0
_DOP853_STEP = 12.0  # Evaluations of a step of DOP853.
# Steps of DOP853 for each radian of the fastest oscillation, at rtol = _FITTED.
_DOP853_RADIAN = 4.0
_FITTED = 1e-9
# Least gain of Radau at which it is chosen; at equal tolerance it is less accurate than DOP853.
RADAU_GAIN = 2.0
# Gain of DOP853 if it integrates one member in each SIMD lane; Radau has no lanes.
LANES_GAIN = 3.0
_SWEEP_COST = 1.9  # Cost of a sweep without identical branches, in evaluations of DOP853.
# A sweep saves _AT_LOOSEST evaluations at rtol = 10^−_LOOSEST, and _PER_DIGIT more for each
# further digit of accuracy.
_LOOSEST, _AT_LOOSEST, _PER_DIGIT = 4.0, 1.0, 0.45
# Steps of DOP853 at the limit of stability above which the decay determines the costs.
_STABILITY_STEPS = 100.0
# Sweeps of AdaptiveGauss for each e-fold of the fastest decay.
_GAUSS_DECAY = 2.6
# E-folds of the fastest decay in a step of DOP853 at rtol = _DECAY_FITTED: fast modes that are
# still excited limit its steps by accuracy, below _STABLE.
_DOP853_DECAY, _DECAY_FITTED = 1.7, 1e-11
# Fast modes are excited until the end if there are at most this many e-folds of the fastest decay,
# and at least this many radians of the fastest oscillation.  Without them DOP853 takes steps at its
# limit of stability, which cost less than the iterations of AdaptiveGauss.
_LONG_DECAY, _EXCITED = 5e3, 60.0

_STEP = 1e-4  # Step of the difference quotients of forces [rad | m | rad/s | m/s].


@dataclass(frozen=True)
class Choice:
    """An integrator and the reason for its choice.

    Attributes:
        method: The integrator with its tolerances.
        why: The reason, for messages.
    """

    method: Method
    why: str


def choose(
    scene: Scene, stops: Array, cyclic: tuple[int, ...] = (), *, momentum_changes: bool = True
) -> Choice:
    """Choose the integrator of a scene.

    Args:
        scene: The scene.
        stops: Times at which the integration stops, (S,) [s].
        cyclic: Indices of the joints whose momentum is constant.
        momentum_changes: Whether a force changes the angular momentum of the base.
    Returns:
        The integrator with the reason.
    """
    if scene.integrator is not None:
        return Choice(scene.integrator, "requested by the scene")
    rtol, atol = scene.tolerance
    dop853 = DOP853(max(rtol, DOP853_LEAST), atol)
    rates = rates_near_rest(scene)
    steps = rates.decay * scene.end / _STABLE
    gain = radau_gain(scene)
    if gain > RADAU_GAIN:
        why = (
            f"forces decay at {rates.decay:.0e}/s: stability alone requires {steps:.0f} steps of "
            f"DOP853, which cost {gain:.1f} times as much"
        )
        return Choice(Radau(max(rtol, DOP853_LEAST), atol), why)
    reports = int((scene.report_times < scene.end).sum()) - int(scene.report_times[0] == 0.0)
    if reports > _FEW:
        return Choice(dop853, f"{reports} reports before the end cost least with DOP853")
    if scene.force_model is not None and len(stops) > 1:
        return Choice(dop853, "the scene is integrated in segments")
    if scene.force_model is not None and scene.force_model.has_kinks:
        return Choice(dop853, "a force has kinks, which long steps miss")
    system = scene.system
    if len(cyclic) == system.m and system.group.turns < 3 and not momentum_changes:
        return Choice(dop853, "all rates are constant, so that one step of any method is exact")
    branches = system.workspace(("limbs as lanes", cyclic), lambda: _limbs(system, cyclic))
    cost = _SWEEP_COST * branches
    if steps > _STABILITY_STEPS:
        folds = rates.decay * scene.end
        finer = max(rtol, DOP853_LEAST) / _DECAY_FITTED
        explicit = _DOP853_STEP / min(_STABLE, _DOP853_DECAY * finer**0.125)
        implicit = _GAUSS_DECAY * cost
        settles = folds > _LONG_DECAY or rates.oscillation * scene.end < _EXCITED
        if settles or implicit > explicit:
            return Choice(dop853, f"forces decay at {rates.decay:.0e}/s, too fast for long steps")
        why = (
            f"forces decay at {rates.decay:.0e}/s: each e-fold costs {implicit:.1f} evaluations, "
            f"and {explicit:.1f} with DOP853"
        )
        return Choice(AdaptiveGauss(rtol, atol), why)
    saved = _AT_LOOSEST + _PER_DIGIT * max(0.0, -log10(scene.rtol) - _LOOSEST)
    why = f"a sweep costs {cost:.1f} evaluations and saves {saved:.1f} at rtol = {scene.rtol:g}"
    if cost < saved:
        return Choice(AdaptiveGauss(rtol, atol), why)
    return Choice(dop853, why)


def radau_gain(scene: Scene) -> float:
    """Estimate the cost of DOP853 divided by that of Radau, for the forces of a scene.

    The steps of DOP853 are limited by stability or by the fastest oscillation.  The steps of Radau
    are limited by the same oscillation, and by the decay at the start.  The estimate does not
    depend on the initial state, so that scenes which differ only in it use one method.

    Args:
        scene: The scene.
    Returns:
        The ratio of the costs; above 1 if Radau is faster.
    """
    rates, rtol = rates_near_rest(scene), max(scene.tolerance[0], DOP853_LEAST)
    radians, finer = rates.oscillation * scene.end, _FITTED / rtol
    stable = rates.decay * scene.end / _STABLE
    explicit = _DOP853_STEP * max(stable, _DOP853_RADIAN * radians * finer**0.125)
    # The controlled error of Radau is of order 3, at a tolerance proportional to rtol^(2/3).
    implicit = (_RADAU_DECAY + _RADAU_RADIAN * radians) * finer ** (1.0 / 6.0)
    gain: float = explicit / ((_RADAU_STEP + _RADAU_JOINT * scene.system.m) * implicit)
    return gain


def _limbs(system: System, cyclic: tuple[int, ...]) -> float:
    """Return the ratio of all bodies to the bodies left when identical branches share lanes.

    Bodies at cyclic joints do not count: their constant momenta need no lanes.
    """
    bodies = bodies_of(system)
    coupled = Groups(bodies, {}, system.coupled).members
    links = links_of(bodies, Lanes(), (), coupled)
    skipped = cyclic if system.coupled is None else ()
    lanes = [sum(bodies[k].v_at not in skipped for k in link.lanes) for link in links]
    return sum(lanes) / sum(count > 0 for count in lanes)


@dataclass(frozen=True)
class Rates:
    """The fastest rates of a linear system.

    Attributes:
        decay: Rate of the fastest decay [1/s].
        oscillation: Angular frequency of the fastest oscillation [rad/s].
    """

    decay: float
    oscillation: float


def rates_near_rest(scene: Scene) -> Rates:
    """Return the rates of a scene's forces at shape zero, cached for equal forces.

    The rates are zero if no force does work, or if the forces are not defined at shape zero.
    """
    forces = scene.force_model
    if forces is None or not forces.labels or len(forces.joints) == scene.system.m:
        return Rates(0.0, 0.0)
    numbers = forces.numbers_from(0.0, scene.end)
    return once(forces, (Rates, numbers.tobytes()), lambda: _rates(scene.system, forces, numbers))


def _rates(system: System, forces: ForceModel, numbers: Array) -> Rates:
    m, r = system.m, system.r
    try:
        at = PointwiseReduction(system.open_tree()).at(system.space.neutral)
    except SingularInertiaError:  # The motion may never reach shape zero, so ignore it.
        return Rates(0.0, 0.0)

    def torque(x: Array, xdot: Array) -> Array:
        xi = -at.local_connection @ xdot  # The body twist at zero momentum.
        base = BaseInSpace(system.group.identity(), xi, np.zeros(r), np.zeros(r))
        return forces.acting(ForceInputs(0.0, x, xdot, xi, np.zeros(r), numbers, base)).torque

    x0, move, zeros = system.space.neutral, system.space.integrate, np.zeros(m)
    K, D = np.empty((m, m)), np.empty((m, m))
    for k in range(m):
        e = np.zeros(m)
        e[k] = _STEP
        K[:, k] = (torque(move(x0, -e), zeros) - torque(move(x0, e), zeros)) / (2.0 * _STEP)
        D[:, k] = (torque(x0, -e) - torque(x0, e)) / (2.0 * _STEP)
    free = np.setdiff1d(np.arange(m), list(forces.joints))
    K, D, M = (matrix[np.ix_(free, free)] for matrix in (K, D, at.reduced_metric))
    with np.errstate(over="ignore", invalid="ignore"):
        accelerations = np.linalg.solve(M, np.hstack([-K, -D]))
    if not np.isfinite(accelerations).all():
        return Rates(0.0, 0.0)
    rates = np.hstack([np.zeros_like(M), np.eye(len(free))])
    values = np.linalg.eigvals(np.vstack([rates, accelerations]))
    swinging = np.abs(values.imag) > np.abs(values.real)
    return Rates(
        decay=max(0.0, float(-values.real.min())),
        oscillation=float(np.abs(values.imag[swinging]).max(initial=0.0)),
    )

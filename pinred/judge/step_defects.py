"""Defects of steps, and errors of the reference solution: residuals in the equations of motion.

The defect of a step from a to b is y(b) − y(a) − ∫ f(t, y(t)) dt. Here y is the full state that the
trajectory reports and f is Pinocchio's ABA. Each half is integrated by itself, by Gauss's formula.
The formula has 8 nodes, so it is exact to round-off within the steps of accurate integrators. A
trajectory with small defects solves a slightly perturbed system exactly (backward error). An
integrator can keep defects small even where nearby motions diverge. No reference solution is
needed.

The error of the reference solution follows from the same quadrature, which shares nothing with
Hairer's codes. It integrates the residual of the dense output over each step that contains a time
of the comparison. The defects of steps accumulate, and grow like perturbations of the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..common.arrays import Array, read_only
from ..common.memo import once
from ..simulation.trajectory import Trajectory
from ..system.coordinates import Indices
from ..system.system import System
from .full_dynamics import FullDynamics
from .reference_integrators import NODES, spectral_radius
from .reference_solution import OFFSET, SPREAD_MARGIN, FullState, Solution

_GAUSS_NODES, _WEIGHTS = legendre.leggauss(8)
COUNT = len(_GAUSS_NODES)
# Weights of the mean over an interval of ∫ f from its start: ½ ∫ (1 − s) f ds.
_MEAN_WEIGHTS = 0.5 * _WEIGHTS * (1.0 - _GAUSS_NODES)
SLOPE_STEP = 1e-6  # step of directional difference quotients, relative to the sizes of states


def _partial_weights() -> Array:
    """Return the weights of ∫ f from −1 to each node, (8, 8)."""
    P = legendre.legvander(_GAUSS_NODES, COUNT)
    previous = np.concatenate([-np.ones((COUNT, 1)), P[:, : COUNT - 1]], axis=1)
    # ∫ P_n from −1 is (P_{n+1} − P_{n−1})/(2n + 1), with P_{−1} = −1.
    integrals = (P[:, 1:] - previous) / (2 * np.arange(COUNT) + 1)
    return np.asarray(integrals @ np.linalg.inv(P[:, :COUNT]))


_PARTIAL_WEIGHTS = _partial_weights()


@dataclass(frozen=True)
class Quadrature:
    """Evaluations of ABA on P intervals with 8 nodes each.

    Attributes:
        nodes: Times of the nodes, (8 P,) [s].
        parameters: Force parameters at the nodes.
        y: Full states at the nodes, (8 P, n).
        rates: Rates of y by ABA, (8 P, n).
        defects: Defect over each interval, (P, n).
        mean_defects: Mean over the interval of the defect accumulated from its start, (P, n).
        largest_defects: Largest magnitude of the accumulated defect at the nodes, (P, n).
        lengths: Lengths of the intervals, (P,) [s].
    """

    nodes: Array
    parameters: Sequence[Array]
    y: Array
    rates: Array
    defects: Array
    mean_defects: Array
    largest_defects: Array
    lengths: Array


def node_times(a: Array, b: Array) -> Array:
    """Return the times of the nodes, (8 P,), of intervals from a to b, (P,) each."""
    return np.asarray((0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * _GAUSS_NODES).ravel())


def integrate_residuals(
    full: FullDynamics,
    a: Array,
    b: Array,
    states: Callable[[Array], Array],
    numbers: Callable[[Array], Sequence[Array]],
) -> Quadrature:
    """Integrate the residuals of a motion over intervals.

    Args:
        full: Full dynamics of the scene.
        a: Starts of the intervals, (P,) [s].
        b: Ends of the intervals, (P,) [s].
        states: Function that returns the full states (T, n) of the motion at times (T,).
        numbers: Function that returns the force parameters at times (T,).
    Returns:
        The evaluations and the defects.
    """
    nodes, half = node_times(a, b), 0.5 * (b - a)
    start, end, y = np.split(states(np.concatenate([a, b, nodes])), [len(a), 2 * len(a)])
    parameters = numbers(nodes)
    rates = full.rates(nodes, y, parameters)
    course, at_nodes = y.reshape(len(a), COUNT, -1), rates.reshape(len(a), COUNT, -1)
    integral = half[:, None] * np.einsum("k,skn->sn", _WEIGHTS, at_nodes)
    mean_integral = half[:, None] * np.einsum("k,skn->sn", _MEAN_WEIGHTS, at_nodes)
    accumulated = course - start[:, None] - half[:, None, None] * (_PARTIAL_WEIGHTS @ at_nodes)
    return Quadrature(
        nodes=nodes,
        parameters=parameters,
        y=y,
        rates=rates,
        defects=end - start - integral,
        mean_defects=0.5 * np.einsum("k,skn->sn", _WEIGHTS, course) - start - mean_integral,
        largest_defects=np.abs(accumulated).max(axis=1),
        lengths=b - a,
    )


def propagate_residuals(
    full: FullDynamics, quadrature: Quadrature, first: Indices, sizes: Array
) -> Array:
    """Propagate residuals inside steps to the step ends.

    The integral of the residual over a step can vanish although the step end is wrong: for linear
    equations, the dense-output interpolants have this property. The accumulated defect D(t) is
    therefore propagated through the linearised ABA dynamics: e = D + z, where z' = J (D + z). The
    Jacobian J is evaluated at the midpoint of each interval.

    Args:
        full: Full dynamics of the scene.
        quadrature: Evaluations on P intervals, which are parts of S steps.
        first: Index of the first interval of each step, (S,).
        sizes: Sizes of states, (n,), which scale difference quotients.
    Returns:
        Errors at the step ends, (S, n).
    """
    counts = np.diff(np.append(first, len(quadrature.lengths)))
    errors = np.zeros((len(first), quadrature.defects.shape[1]))
    for k in range(int(counts.max(initial=0))):
        steps = np.flatnonzero(counts > k)  # the steps with an interval k
        intervals, before = first[steps] + k, errors[steps]
        mean = before + quadrature.mean_defects[intervals]
        mean += 0.5 * growth_over(full, quadrature, intervals, mean, sizes)
        grown = growth_over(full, quadrature, intervals, mean, sizes)
        errors[steps] = before + quadrature.defects[intervals] + grown
    return errors


def growth_over(
    full: FullDynamics, quadrature: Quadrature, intervals: Indices, errors: Array, sizes: Array
) -> Array:
    """Compute J · error times the length of an interval; J · error is a difference quotient.

    Args:
        full: Full dynamics of the scene.
        quadrature: Evaluations on all intervals.
        intervals: Indices of intervals, (I,).
        errors: An error of the state in each of them, (I, n).
        sizes: Sizes of states, (n,), which scale the difference.
    Returns:
        (I, n) growth; zero for an error that is zero or not finite.
    """
    units = np.abs(errors / sizes).max(axis=1) / SLOPE_STEP
    growth, regular = np.zeros_like(errors), (units > 0.0) & (units < np.inf)
    nodes, units = intervals[regular] * COUNT + COUNT // 2, units[regular, None]
    parameters = [quadrature.parameters[k] for k in nodes]
    states = quadrature.y[nodes] + errors[regular] / units
    change = full.rates(quadrature.nodes[nodes], states, parameters) - quadrature.rates[nodes]
    growth[regular] = quadrature.lengths[intervals[regular], None] * units * change
    return growth


_MOST_STEPS = 200  # number of randomly sampled steps that are evaluated for longer trajectories
# Defects above this multiple of the median defect indicate a kink of a force within the step.
_KINK = 10.0
# Product of spectral radius of ABA's Jacobian and the longer of the step and the time below, above
# which a step is stiff.
_STIFF = 1.0
_SETTLED = 0.01  # time after which decaying errors count, relative to the duration
_SUSPECT = 0.1  # residual above which a stiff step is solved, in tolerances
_FINER = 0.01  # local tolerance of ABA's solution of a stiff step, in tolerances of the scene
# Product of spectral radius and duration above which a motion is fast.
_FAST = 30.0
_TAIL = 8  # degree of the first Legendre polynomial that DOP853 cannot integrate


@dataclass(frozen=True)
class Defects:
    """Relative defects of S steps and of their subintervals.

    The unit of each kind of number is the largest value of that kind. For rates the unit is at
    least atol/rtol, because the tolerance is defined that way. The `motion_*` fields use the
    motion's actual rates instead, because the growth of perturbations is measured in these units.

    Attributes:
        steps: Defects of steps, (S,).
        subintervals: Largest defect of a subinterval of each step, (S,); these also test the
            dense output.
        smooth: Whether the equations are smooth within the step, (S,). No method keeps its order
            across a kink of a force.
        motion_steps: Defects of steps in units of the motion, (S,). Residuals inside a step count
            by their effect on its end, even if they cancel in the integral.
        motion_subintervals: The same for subintervals, (S,).
        round_off_rate: Rate at which round-off of ABA itself perturbs the motion [1/s].
    """

    steps: Array
    subintervals: Array
    smooth: NDArray[np.bool_]
    motion_steps: Array
    motion_subintervals: Array
    round_off_rate: float

    @property
    def worst(self) -> float:
        """Largest defect of a smooth step; NaN if any such defect is NaN."""
        return float(self.steps[self.smooth].max(initial=0.0))


@dataclass(frozen=True)
class DecayingErrors:
    """Relative errors of stiff steps before they decay; kinks of forces do not count.

    Attributes:
        steps: Number of stiff steps.
        coordinates: Largest error of a coordinate at the end of a stiff step, or while it decays.
        rates: Largest error of a rate at the end of a stiff step.
    """

    steps: int = 0
    coordinates: float = 0.0
    rates: float = 0.0


def largest_defect(
    traj: Trajectory, system: System, *, max_steps: int = _MOST_STEPS, subintervals: bool = False
) -> float:
    """Return the largest relative defect of a step.

    Args:
        traj: The trajectory.
        system: System whose equations the trajectory should satisfy.
        max_steps: Largest number of steps to evaluate; longer trajectories are sampled randomly.
        subintervals: Return the largest defect of a subinterval instead, which also tests the
            dense output.
    Returns:
        Largest defect relative to the size of each kind of number (root coordinates, joint
        values, and the velocities of both).
    """
    full = FullState(replace(traj.scene, system=system))
    defects = compute_defects(traj, full, max_steps=max_steps, propagate=False)
    return float(defects.subintervals.max(initial=0.0)) if subintervals else defects.worst


def compute_defects(
    traj: Trajectory,
    full: FullState,
    *,
    max_steps: int = _MOST_STEPS,
    propagate: bool = True,
) -> Defects:
    """Compute the defects of a trajectory with ABA.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        max_steps: Largest number of steps to evaluate; longer trajectories are sampled randomly.
        propagate: Propagate residuals inside a step to its end. Without it, motion_steps omits
            residuals that cancel in the integral.
    Returns:
        Defects of the steps and of their subintervals.
    """
    steps = _sampled_steps(traj, max_steps)
    return _without_kinks(traj, _defects_of_steps(traj, full, steps, propagate=propagate))


def _sampled_steps(traj: Trajectory, max_steps: int) -> Indices:
    steps = np.arange(len(traj.motion.step_spans[0]))
    if len(steps) > max_steps:
        last = steps[-1]  # errors of the last step cannot decay
        steps = np.sort(np.random.default_rng(0).choice(steps, max_steps, replace=False))
        steps[-1] = last
    return steps


def _without_kinks(traj: Trajectory, defects: Defects) -> Defects:
    forces = traj.scene.force_model
    if forces is None or not forces.has_kinks:
        return defects
    # The defect of a step across a kink of a force far exceeds those of its neighbours.
    threshold = _KINK * float(np.median(defects.steps))
    return replace(defects, smooth=~(defects.steps > threshold))


def solve_stiff_steps(
    traj: Trajectory, full: FullState, defects: Defects, tolerance: float
) -> tuple[Defects, DecayingErrors]:
    """Replace the defects of stiff steps by their errors against ABA's own solution of the step.

    In a stiff step of length h, an error w of a state between the step ends contributes h J w to
    the defect, although it decays. There, ABA is integrated from the start of the step by an
    implicit method. The error of the step is the difference at its end. `steps` is what the
    linearised ABA dynamics leave of it after a small fraction of the duration, or at the end of the
    motion if that comes first.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        defects: Result of `compute_defects` with the default number of steps.
        tolerance: Sum of relative and absolute tolerance.
    Returns:
        The defects, and the errors of stiff steps before they decay. The defects of other steps are
        unchanged.
    Raises:
        AbaStopped: A step cannot be integrated, or not within the budget.
    """
    steps = _sampled_steps(traj, _MOST_STEPS)
    a, b = (ends[steps] for ends in traj.motion.step_spans)
    sizes, motion_sizes = defect_units(traj, full)
    inside = a[:, None] + np.outer(b - a, NODES[:-1])
    times = np.column_stack([a, inside, b]).ravel()
    courses = full_states(traj, full, times).reshape(len(steps), len(NODES) + 1, -1)
    parameters = traj.motion.numbers(0.5 * (a + b))
    of_steps, of_motion, within, within_motion = (
        measures.copy()
        for measures in (
            defects.steps, defects.motion_steps, defects.subintervals, defects.motion_subintervals,
        )
    )  # fmt: skip
    decaying, first_rate = np.zeros((2, len(of_steps))), traj.system.group.size + full.coordinates
    count, settled = 0, _SETTLED * traj.scene.end
    # Small residuals need no second measurement.
    suspect = ~(np.maximum(defects.steps, defects.motion_steps) <= _SUSPECT * tolerance)
    for k in np.flatnonzero(suspect):
        course, start, end = courses[k], float(a[k]), float(b[k])
        full.set_parameters(parameters[k])
        J = full.jacobian(start, course[0], sizes)
        if np.isfinite(J).all() and spectral_radius(J) * max(end - start, settled) <= _STIFF:
            continue
        count += 1
        solved, noise = full.solve_step(
            course[0], (start, end), inside[k], _FINER * tolerance, sizes
        )
        errors = course[1:] - solved
        time = min(settled, traj.scene.end - end)
        decay = np.abs(_propagate_error(J, errors[-1] / sizes, time, sizes))
        decay = np.maximum(decay - noise, 0.0)
        lasting = decay[-1] * sizes
        errors = np.maximum(np.abs(errors) - noise * sizes, 0.0)
        of_steps[k] = min(of_steps[k], decay[-1].max())
        decaying[:, k] = decay[:, :first_rate].max(), decay[0, first_rate:].max()
        of_motion[k] = (lasting / motion_sizes).max()
        within[k] = (errors / sizes).max()
        within_motion[k] = (errors / motion_sizes).max()
    stiff = replace(
        defects,
        steps=of_steps,
        subintervals=within,
        motion_steps=of_motion,
        motion_subintervals=within_motion,
    )
    stiff = _without_kinks(traj, stiff)
    coordinates, rates = decaying[:, stiff.smooth].max(axis=1, initial=0.0)
    return stiff, DecayingErrors(count, float(coordinates), float(rates))


def unresolved_forces(traj: Trajectory, full: FullState, suspect: NDArray[np.bool_]) -> Array:
    """Return the impulses of forces that change too quickly for the error estimate of a step.

    The rates of ABA at the state in the middle of the step, as functions of time, are expanded in
    Legendre polynomials. The impulse is that of the polynomials which DOP853 cannot integrate.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        suspect: Which steps of `compute_defects` to evaluate, (S,).
    Returns:
        Relative impulses of steps, (S,); zero for the others, and without functions of time.
    """
    steps, impulses = _sampled_steps(traj, _MOST_STEPS), np.zeros(len(suspect))
    units = defect_units(traj, full)[0]
    nodes, weights = legendre.leggauss(2 * _TAIL)
    degrees = np.arange(2 * _TAIL)
    coefficients = (weights[:, None] * legendre.legvander(nodes, degrees[-1]) * (degrees + 0.5)).T
    for k in np.flatnonzero(suspect):
        a, b = (float(ends[steps[k]]) for ends in traj.motion.step_spans)
        times = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        y = np.tile(full_states(traj, full, 0.5 * np.array([a + b])), (len(times), 1))
        rates = full.rates(times, y, traj.motion.numbers(times))
        tail = np.abs(coefficients[_TAIL:] @ rates).sum(axis=0)
        impulses[k] = ((b - a) * tail / units).max()
    return impulses


def are_fast(traj: Trajectory, full: FullState, suspect: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return in which steps some motion is fast compared with the duration.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        suspect: Which steps of `compute_defects` to evaluate, (S,).
    Returns:
        Whether the spectral radius of ABA's Jacobian times the duration is large, (S,); false for
        steps that are not evaluated.
    """
    steps, fast = _sampled_steps(traj, _MOST_STEPS), np.zeros(len(suspect), dtype=bool)
    units = defect_units(traj, full)[0]
    for k in np.flatnonzero(suspect):
        start = traj.motion.step_spans[0][steps[k] : steps[k] + 1]
        full.set_parameters(traj.motion.numbers(start)[0])
        J = full.jacobian(float(start[0]), full_states(traj, full, start)[0], units)
        fast[k] = spectral_radius(J) * traj.scene.end > _FAST
    return fast


def _propagate_error(J: Array, error: Array, time: float, units: Array) -> Array:
    """Propagate an error by linear dynamics.

    Args:
        J: Jacobian of the rates of the state, (n, n).
        error: Error in these units, (n,).
        time: Time [s].
        units: Units of the numbers in a state, (n,).
    Returns:
        The errors after 0, time/2ᴷ, …, time/2 and time, (K + 2, n), where time/2ᴷ times the norm of
        the Jacobian is at most 1. Without a finite Jacobian, errors are constant.
    """
    from scipy.linalg import expm  # its import takes longer than most comparisons

    move = time * J * units / units[:, None]
    norm = float(np.abs(move).sum(axis=1).max())
    if not norm < np.inf:
        return error[None]
    halvings = int(np.ceil(np.log2(max(norm, 1.0))))
    propagator, errors = expm(move * 0.5**halvings), [error]
    with np.errstate(all="ignore"):
        for _ in range(halvings + 1):
            errors.append(propagator @ error)
            propagator = propagator @ propagator
    return np.array(errors)


def _defects_of_steps(
    traj: Trajectory, full: FullState, steps: Indices, *, propagate: bool
) -> Defects:
    a, b, first = _subintervals(traj, steps)
    quadrature = integrate_residuals(
        full, a, b, partial(full_states, traj, full), traj.motion.numbers
    )
    # One node per subinterval is enough to measure the round-off of ABA.
    nodes = slice(None, None, COUNT)
    other = full.rates(
        quadrature.nodes[nodes], quadrature.y[nodes], quadrature.parameters[nodes],
        pin.Convention.WORLD,
    )  # fmt: skip
    spread = np.abs(quadrature.rates[nodes] - other).max(axis=0)
    sizes, motion_sizes = defect_units(traj, full)
    missed = quadrature.defects
    of_steps = np.add.reduceat(missed, first)  # step ends between subintervals cancel
    propagated = propagate_residuals(full, quadrature, first, sizes) if propagate else of_steps
    # Round-off of ABA where the mass matrix is almost singular is not a defect.
    noise, durations = SPREAD_MARGIN * spread, np.add.reduceat(b - a, first)
    of_steps, propagated, missed = (
        np.maximum(np.abs(defects) - np.outer(time, noise), 0.0)
        for defects, time in ((of_steps, durations), (propagated, durations), (missed, b - a))
    )
    relative = (of_steps / sizes).max(axis=1)
    return Defects(
        steps=relative,
        subintervals=np.maximum.reduceat((missed / sizes).max(axis=1), first),
        smooth=np.ones(len(steps), dtype=bool),
        motion_steps=(np.maximum(of_steps, propagated) / motion_sizes).max(axis=1),
        motion_subintervals=np.maximum.reduceat((missed / motion_sizes).max(axis=1), first),
        round_off_rate=float((spread / motion_sizes).max()),
    )


def _subintervals(traj: Trajectory, steps: Indices) -> tuple[Array, Array, Indices]:
    """Return starts (P,) and ends (P,) of subintervals, and the first index of each step (S,).

    Subintervals are halves of steps, or shorter where the base rotates fast, so that the
    quadrature is exact to round-off.
    """
    starts, ends = traj.motion.step_spans
    linear = traj.system.group.linear
    fastest = np.abs(traj(traj.motion.knots).xi[:, linear:]).max(initial=0.0)
    angle = fastest * (ends - starts)[steps]
    counts = np.ceil(np.maximum(angle, 2.0)).astype(int)
    lower = np.concatenate([np.arange(n) for n in counts]) / np.repeat(counts, counts)
    upper = np.concatenate([np.arange(1, n + 1) for n in counts]) / np.repeat(counts, counts)
    start, end = np.repeat(starts[steps], counts), np.repeat(ends[steps], counts)
    # The last end equals the step end bit for bit, because no state exists after the final time.
    a, b = start + lower * (end - start), np.where(upper < 1.0, start + upper * (end - start), end)
    return a, b, np.concatenate([[0], np.cumsum(counts)[:-1]])


def full_states(traj: Trajectory, full: FullState, times: Array) -> Array:
    """Return the states of a trajectory at times (T,) as full states (T, n)."""
    state = traj(times)
    return full.state(state.pose, state.x, state.xi, state.xdot)


def defect_units(traj: Trajectory, full: FullState) -> tuple[Array, Array]:
    """Return the units of defects, (n,), and the units in which error growth is measured, (n,).

    Each unit is the largest number of its kind at the step ends. The unit of angles and quaternions
    is at least 1, and the unit of lengths at least the radius of gyration. For positions, the unit
    is the distance travelled, or larger if round-off of the distance from the origin requires it.

    The two results differ for rates. For defects, the unit is at least atol/rtol. For growth, it is
    at least atol/rtol or the rate that covers 1 rad until the end, whichever is smaller, and each
    joint has its own unit. For growth, the unit of the base's rotation rate is limited to the
    initial rate, like the perturbation whose growth is measured.
    """
    return once(full, (defect_units, traj), lambda: _defect_units(traj, full))


def _defect_units(traj: Trajectory, full: FullState) -> tuple[Array, Array]:
    y = full_states(traj, full, traj.motion.knots)
    group, m, r = traj.system.group, full.coordinates, traj.system.r
    linear, size = group.linear, group.size
    radius = full.totals.radius_of_gyration(full.q(y[0]))
    sizes, least = np.empty((2, y.shape[1])), np.zeros((2, y.shape[1]))
    least[:, :linear], least[:, linear : size + m] = radius, 1.0
    slow = np.array([traj.scene.atol / traj.scene.rtol, 1.0 / traj.scene.end])
    least[:, size + m :] = np.minimum(slow, slow[0])[:, None]
    least[:, size + m : size + m + linear] *= radius
    edges = [0, linear, size, size + m, size + m + linear, size + m + r, y.shape[1]]
    for first, last in pairwise(edges):
        if last > first:
            numbers = y[:, first:last]
            if first == 0 and linear:
                offset = OFFSET * np.abs(numbers).max()
                numbers = np.append(np.abs(numbers - numbers[0]).ravel(), offset)
            sizes[:, first:last] = np.maximum(np.abs(numbers).max(), least[:, first, None])
    joints, spin = slice(size + m + r, None), slice(size + m + linear, size + m + r)
    sizes[1, joints] = np.maximum(np.abs(y[:, joints]).max(axis=0), least[1, joints])
    initial = np.abs(y[0, spin]).max(initial=0.0)
    sizes[1, spin] = np.minimum(sizes[1, spin], np.maximum(initial, least[1, spin]))
    of_tolerance, of_motion = read_only(np.where(sizes > 0.0, sizes, 1.0))
    return of_tolerance, of_motion


def reference_errors(
    full: FullState, solution: Solution, times: Array, growth: Array, units: Array
) -> Array:
    """Bound the errors of a solution by its accumulated defects times the growth of perturbations.

    Args:
        full: Full simulation of the scene.
        solution: Solution at `times`.
        times: Increasing times, (T,) [s].
        growth: Factors by which a small perturbation has grown, (T,).
        units: Units of the numbers in a state, (n,).
    Returns:
        (T,) errors relative to the units; zero at the start.
    """
    steps = solution.steps
    if steps is None:
        return np.zeros(len(times))

    def numbers(t: Array) -> list[Array]:
        return [solution.parameters[k] for k in np.searchsorted(steps.ends, t)]

    count = len(steps.ends)
    residuals = integrate_residuals(full, steps.starts, steps.ends, steps, numbers)
    propagated = propagate_residuals(full, residuals, np.arange(count), units)
    defects = np.maximum(np.abs(residuals.defects), np.abs(propagated))
    step = np.minimum(np.searchsorted(steps.ends, times), count - 1)
    # Steps without times of the comparison count like the others.
    skipped = (np.searchsorted(solution.step_ends, times) + 1) / (step + 1)
    accumulated = skipped * np.cumsum((defects / units).max(axis=1))[step]
    # Times lie within steps, where dense output has an error of lower order.
    within = np.maximum.accumulate((residuals.largest_defects / units).max(axis=1))[step]
    return np.where(times > 0.0, growth * accumulated + within, 0.0)

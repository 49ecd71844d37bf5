"""compare(): validate a reduced trajectory with Pinocchio's ABA on the full state.

The full simulation (reference_solution.py) shares no dynamics with the reduced one. It runs at a
tolerance 100 times tighter, by a method of order 8. Its residuals, integrated by another formula,
bound its error (step_defects.py). Where this bound is wide, the difference from a solution by
a method of order 5 is used instead, if it is smaller.

A trajectory passes in three steps, each with a separate line of the report:
1. Equations: at the states of the trajectory, the route's accelerations equal ABA's up to
   round-off (audit.py). Neither chaos nor the tolerance matters.
2. Steps: the defect of each step, evaluated with ABA, is within the tolerance (step_defects.py).
3. Errors: the distance from the reference is at most ten times the sum of earlier defects, times
   the growth of perturbations, which ABA measures. Each joint is measured in
   units of its motion.
Where the third bound exceeds 0.1, the distance carries no information, and the verdict is
CANNOT TELL.
docs/comparison.md derives all bounds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, positive
from ..common.errors import InputError
from ..common.waiting import Progress, shown
from ..simulation.contact.chain import Chain
from ..simulation.trajectory import Trajectory
from ..system.state_fields import State
from .audit import audit_trajectory, audit_with_reference, equation_errors, measurement_error
from .full_system import loop_errors
from .impact_checks import (
    ChainReport,
    StopChecks,
    check_stops,
    contact_errors,
    judge_impacts,
    judgeable_until,
)
from .reference_integrators import AbaStopped, TimeBudget, default_budget
from .reference_solution import (
    FINEST,
    PERTURBATION,
    Distance,
    FullMotion,
    FullState,
    Size,
    StiffError,
)
from .step_defects import (
    DecayingErrors,
    Defects,
    are_fast,
    compute_defects,
    defect_units,
    reference_errors,
    solve_stiff_steps,
    unresolved_forces,
)
from .stop_reference import NEVER, Hit, StoppedFullState, first_difference, stopped_full_state
from .verdict import Report, Verdict

TIGHTER = 100.0  # ratio of the scene's tolerance to the tolerance of the reference solution
# Loosest rtol and atol of the reference solution: dense output of longer steps is less accurate.
COARSEST = (1e-8, 1e-10)
SAMPLES = 101  # number of evenly spaced times of the comparison, in addition to the report times

INFORMATIVE = 0.1  # largest informative error bound [rad, or fraction of the motion's size]
_REST = 1e-12  # motion below which nothing is tested [rad, or fraction of robot size]

EQUATION_BOUND = 1e-12  # largest relative difference of accelerations that round-off can explain
DEFECT_BOUND = 3.0  # largest passing defect of a step, in tolerances, as in the stress suite
# Largest passing defect of a step in which a force changes quickly if the mean defect passes, in
# tolerances, and in impulses of the changes that the error estimate of the step misses.
SINGLE_BOUND, UNRESOLVED_BOUND = 100.0, 3.0
# Largest passing defect of a step with fast motion if the mean defect passes, in tolerances.
FAST_BOUND = 10.0
# Residuals propagated to step ends, relative to the motion, above which steps are tested for
# stiffness are the passing defect divided by this.
PROPAGATED = 0.1
DENSE_BOUND = 50.0  # largest passing defect of a subinterval; step control ignores dense output
DRIFT_BOUND = 100.0  # smallest bound of the energy and momentum drift, in tolerances
REFERENCE_BOUND = 100.0  # largest error of a reliable reference, in tolerances times growth
GROWTH_TOLERANCE = 1e-10  # least relative tolerance at which the growth is measured
# Error of the reference by its residuals, in tolerances times growth, above which a second solution
# is computed.
SECOND_BOUND = 10.0
# Checks that dense output of stiff steps can fail.
BETWEEN_STEPS = {
    "shape error [rad | m]",
    "rotation error [rad]",
    "position error [m]",
    "energy drift [relative]",
    "momentum drift [relative]",
}
FIELD_BOUND = 1e-9  # largest passing relative error of fields computed from q and v
RESOLUTION = 1e-13  # relative accuracy of the reference solution and of its energies
_SAFETY = 10.0  # margin, because growth and defects are only sampled
_ROUND_OFF = 1e-15  # relative round-off of one step


@overload
def compare(
    traj: Trajectory, *, progress: Progress | bool | None = None, budget: float | None = None
) -> Report: ...
@overload
def compare(
    traj: Chain, *, progress: Progress | bool | None = None, budget: float | None = None
) -> ChainReport: ...
@checks_arguments
def compare(
    traj: Trajectory | Chain,
    *,
    progress: Progress | bool | None = None,
    budget: float | None = None,
) -> Report | ChainReport:
    """Compare a trajectory with the full simulation of its scene, which uses Pinocchio's ABA.

    Args:
        traj: Trajectory returned by `simulate`, or a Chain. Each motion of a chain is compared,
            and each impact with that of the full mass matrices.
        progress: True for a progress bar, or a function that is called with the completed
            fraction of the work, 0 to 1.
        budget: Processor time after which ABA stops [s]; by default 30 s, or 500 times the wall
            time of the simulation if that is longer. It holds for each motion of a chain.
    Returns:
        The report. It is true if the comparison passed: `assert pinred.compare(traj)`. The
        verdict is CANNOT TELL if ABA does not reach the end of the motion.
    Raises:
        InputError: `traj` is not a Trajectory, or the budget is not positive.
    """
    if isinstance(traj, Chain):
        motions = [motion for phase in traj.phases for motion in phase.motions]
        reports = [_compare_motion(motion, progress, budget) for motion in motions]
        return ChainReport(tuple(reports), judge_impacts(traj))
    if not isinstance(traj, Trajectory):
        raise InputError(
            f"compare takes a Trajectory, got {type(traj).__name__}; simulate returns one"
        )
    return _compare_motion(traj, progress, budget)


def _compare_motion(
    traj: Trajectory, progress: Progress | bool | None, budget: float | None
) -> Report:
    """Compare one trajectory; the arguments are those of `compare`."""
    seconds = default_budget(traj.run.wall) if budget is None else positive(budget, "budget")
    what = f"compares the motion of '{traj.system.name}' with ABA"
    with shown(progress, "full", what=what, reports=True) as report_progress:
        progress, limit = report_progress or (lambda _: None), TimeBudget(seconds)
        report = _compare(traj, progress, limit)
        if report.verdict is not Verdict.FAILED or not report.rate_error:
            return report
        if not failed_checks(report) <= BETWEEN_STEPS:
            return report
        # Dense output of stiff steps can be wrong although the step ends are right.
        coarse = _compare(traj, progress, limit, everywhere=False)
        return report if coarse.verdict is Verdict.FAILED else coarse


def failed_checks(report: Report) -> set[str]:
    """Return the names of the checks that fail."""
    return {name for name, (value, bound) in report.checks.items() if not value <= bound}


def _compare(
    traj: Trajectory, progress: Progress, budget: TimeBudget, *, everywhere: bool = True
) -> Report:
    scene, start, rtol, atol = traj.scene, traj.scene.start, traj.scene.rtol, traj.scene.atol
    # The whole motion is compared, independent of its report times.
    evenly = np.linspace(0.0, scene.end, SAMPLES)
    times = np.union1d(traj.t, evenly) if everywhere else traj.t
    states = traj(times)
    full = full_state_of(traj, budget)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    between = "errors between report times of stiff motion are above their bounds; use Radau"
    stopped: tuple[str, ...] = () if everywhere else (between,)
    tolerance = max(rtol, RESOLUTION) + atol
    started = time.perf_counter()
    try:
        solutions = _integrate_with_aba(traj, full, y0, times, tolerance, progress)
    except AbaStopped as stop:
        reason = f"errors of the motion cannot be judged: {stop}; compare a shorter motion"
        stopped = (*stopped, reason)
        times = times[:1]
        initial = full.run(y0, times, rtol, atol)
        wall = time.perf_counter() - started
        until = 0.0 if scene.bounds else np.inf
        solutions = _Solutions(initial, y0[None], np.ones(1), np.zeros(1), wall, until=until)
    progress(0.8)
    reference, growth = solutions.reference, solutions.growth
    defects = compute_defects(traj, full)
    bound, decaying = DEFECT_BOUND * tolerance, DecayingErrors()
    largest = max(defects.worst, PROPAGATED * float(defects.motion_steps.max()))
    if solutions.stiff or not largest <= bound:
        # Residuals of stiff equations are large although the errors that they cause decay.
        try:
            defects, decaying = solve_stiff_steps(traj, full, defects, tolerance)
        except AbaStopped as stop:
            stopped = (*stopped, f"defects of stiff steps cannot be judged: {stop}")
            bound, decaying = np.inf, DecayingErrors(1)
    defect, defect_bound = defects.worst, bound
    if defect > bound:
        suspect = defects.smooth & (defects.steps > bound)
        defect, defect_bound = closest_defect(
            defects.steps[defects.smooth],
            unresolved_forces(traj, full, suspect)[defects.smooth],
            are_fast(traj, full, suspect)[defects.smooth],
            tolerance,
        )
    equations = equation_errors(traj, full, evenly)
    progress(0.9)
    x, q = full.couplings.values(states.x), traj.system.sort_q(states.q)
    motion = FullMotion(x=x[: len(times)], q=q[: len(times)])
    size, error = full.size(reference), full.distance(reference, motion)
    contacts = np.zeros(len(times))
    if isinstance(full, StoppedFullState):
        contacts = contact_errors(traj, full, times)

    def bounded() -> ErrorBounds:
        errors = solutions.errors
        return compute_error_bounds(traj, times, growth, defects, errors, size, tolerance, contacts)

    bounds = bounded()
    stops = StopChecks((), (), np.inf)
    if isinstance(full, StoppedFullState):
        until = judgeable_until(solutions.grazes, solutions.until, times, bounds.relative)
        stops = check_stops(traj, full, solutions.hits, until, times, bounds.relative)
    if stops.until < np.inf:
        growth[times >= stops.until] = NEVER
        bounds = bounded()
    count = count_informative_times(bounds.relative, growth)
    rates = compute_rate_errors(traj, full, states, solutions.states)[:count]
    reported = np.isin(times[:count], traj.t)
    reasons = (
        *explain_uninformative_times(times, count, bounds.relative, growth),
        *explain_decaying_errors(
            decaying, rates[reported], bounds.relative[:count][reported], tolerance
        ),
    )
    audit = audit_trajectory(traj, states)
    drift_bound = max(DRIFT_BOUND * tolerance, 2.0 * bounds.total_defect)
    if not audit.energy <= drift_bound:
        # The largest kinetic energy, the unit, may occur between these times.
        ends = traj.motion.knots[traj.motion.knots <= scene.end]
        audit = audit_trajectory(traj, traj(np.union1d(states.t, ends)))
    if (solutions.stiff or decaying.steps) and not max(audit.energy, audit.momentum) <= drift_bound:
        if len(times) == len(states.t):
            audit = audit_with_reference(full, states, solutions.states)
        else:
            drift_bound = np.inf
    loops = loop_errors(traj.system, states)
    progress(1.0)
    growth_at_last = float(growth[max(count - 1, 0)])
    return Report(
        robot=traj.system.name,
        engine=traj.run.engine,
        group=traj.system.group.name,
        joints=traj.system.m,
        duration=scene.end,
        rtol=rtol,
        atol=atol,
        t=times,
        shape_errors=error.joints,
        rotation_errors=error.rotation,
        position_errors=error.position,
        shape_bounds=bounds.distance.joints,
        rotation_bounds=bounds.distance.rotation,
        position_bounds=bounds.distance.position,
        equations=float(equations.max(initial=0.0)),
        defect=defect,
        energy_drift=audit.energy,
        momentum_drift=audit.momentum,
        field_error=max(audit.fields, measurement_error(traj, full)),
        reference_error=float(solutions.errors[:count].max(initial=0.0)),
        equations_bound=EQUATION_BOUND,
        defect_bound=defect_bound,
        drift_bound=drift_bound,
        field_bound=FIELD_BOUND,
        reference_bound=min(REFERENCE_BOUND * tolerance * growth_at_last, INFORMATIVE),
        growth=growth,
        told=count,
        reasons=(*stops.reasons, *reasons, *(stopped or explain_rest(reference, size))),
        wall_reduced=traj.run.wall,
        wall_full=solutions.wall,
        left_out=scene.left_out,
        stop_checks=stops.checks,
        loop_gap=loops.gap,
        loop_rate=loops.rate,
        rate_error=max(decaying.rates, float(rates.max(initial=0.0))) if decaying.steps else 0.0,
    )


def full_state_of(traj: Trajectory, budget: TimeBudget | None = None) -> FullState:
    """Return the full simulation of a trajectory's scene, with its joint stops if it has any.

    Args:
        traj: The trajectory.
        budget: Time limit of all runs together.
    """
    if traj.scene.bounds:
        return stopped_full_state(traj, budget)
    return FullState(traj.scene, traj.motion.replay, budget)


@dataclass(frozen=True)
class _Solutions:
    """Solutions by ABA.

    Attributes:
        reference: The reference motion.
        states: Its full states, (T, n).
        growth: Factors by which a small perturbation has grown over time, (T,).
        errors: Errors of the reference over time, relative to the motion, (T,).
        wall: Wall time at the scene's tolerance [s].
        stiff: Whether the reference is that of an implicit method.
        hits: Impacts of the reference at joint stops.
        grazes: Grazing impacts of the reference, see HybridSolution.
        until: Time of the first impact that a small perturbation changes, or inf [s].
    """

    reference: FullMotion
    states: Array
    growth: Array
    errors: Array
    wall: float
    stiff: bool = False
    hits: tuple[Hit, ...] = ()
    grazes: tuple[tuple[float, float], ...] = ()
    until: float = np.inf


def _integrate_with_aba(
    traj: Trajectory,
    full: FullState,
    y0: Array,
    times: Array,
    tolerance: float,
    progress: Progress,
) -> _Solutions:
    rtol, atol = traj.scene.rtol, traj.scene.atol
    if isinstance(full, StoppedFullState):
        return _integrate_with_stops(full, y0, times, rtol, atol)
    units = defect_units(traj, full)[1]
    began = time.perf_counter()
    try:
        full.run_unless_stiff(y0, float(times[-1]), rtol, atol, units)
        wall = time.perf_counter() - began
        progress(0.1)
        return _integrate_explicitly(full, y0, times, (rtol, atol), units, wall, progress)
    except StiffError:
        return _integrate_stiff(full, y0, times, tolerance, units)
    except AbaStopped as stop:
        try:  # dop853 gives up if its steps become too short, or if it detects stiffness
            return _integrate_stiff(full, y0, times, tolerance, units)
        except AbaStopped:
            raise stop from None


def _integrate_with_stops(
    full: StoppedFullState, y0: Array, times: Array, rtol: float, atol: float
) -> _Solutions:
    """Return the solutions of a scene with joint stops, by SciPy's DOP853."""
    began = time.perf_counter()
    looser = full.solve_with_stops(y0, times, rtol / 10.0, atol / 10.0)
    wall = time.perf_counter() - began
    tight = min(rtol / TIGHTER, COARSEST[0]), min(atol / TIGHTER, COARSEST[1])
    solution = full.solve_with_stops(y0, times, *tight)
    fine = max(tight[0], GROWTH_TOLERANCE), max(tight[1], 1e-2 * GROWTH_TOLERANCE)
    growth, until = full.growth_with_stops(y0, solution, times, *fine)
    until = min(until, first_difference(solution.hits, looser.hits, full.slowest))
    size = full.size(solution.motion)
    errors = full.distance(solution.motion, looser.motion).relative(size)
    return _Solutions(
        solution.motion, solution.states, growth, errors, wall,
        hits=tuple(solution.hits), grazes=tuple(solution.grazes), until=until,
    )  # fmt: skip


def _integrate_explicitly(
    full: FullState,
    y0: Array,
    times: Array,
    asked: tuple[float, float],
    units: Array,
    wall: float,
    progress: Progress,
) -> _Solutions:
    """Return the solutions by Hairer's dop853.

    Args:
        full: Full simulation of the scene.
        y0: Initial state, (n,).
        times: Times, (T,) [s].
        asked: Relative and absolute tolerance of the scene.
        units: Units of the numbers in a state, (n,).
        wall: Wall time of a run at these tolerances [s].
        progress: Function that is called with the completed fraction of the work.
    Returns:
        The solutions.
    """
    rtol, atol = asked
    tight = max(min(rtol / TIGHTER, COARSEST[0]), FINEST[0]), min(atol / TIGHTER, COARSEST[1])
    solution = full.solve(y0, times, *tight)
    progress(0.3)
    # The perturbation far exceeds the errors of a run at this tolerance.
    fine = max(tight[0], GROWTH_TOLERANCE), max(tight[1], 1e-2 * GROWTH_TOLERANCE)
    growth = full.growth(y0, solution.motion, times, *fine)
    progress(0.5)
    errors = reference_errors(full, solution, times, growth, units)
    if not (errors <= SECOND_BOUND * (max(rtol, RESOLUTION) + atol) * growth).all():
        # Stiff errors decay and do not accumulate, which only a second solution shows.
        second = full.run(y0, times, *tight, method="dopri5")
        distance = full.distance(solution.motion, second).relative(full.size(solution.motion))
        errors = np.minimum(errors, distance)
    return _Solutions(solution.motion, solution.states, growth, errors, wall)


def _integrate_stiff(
    full: FullState, y0: Array, times: Array, tolerance: float, units: Array
) -> _Solutions:
    """Return the solutions by an implicit method, whose steps estimate their errors."""
    began = time.perf_counter()
    tight = max(min(tolerance / TIGHTER, COARSEST[0]), RESOLUTION)
    solution = full.solve_stiff(y0, times, tight, units)
    wall = time.perf_counter() - began
    fine = max(tight, GROWTH_TOLERANCE)
    growth = full.growth(y0, solution.motion, times, fine, fine, units=units)
    assert solution.estimates is not None
    accumulated, largest = solution.estimates.T
    return _Solutions(
        solution.motion, solution.states, growth, growth * accumulated + largest, wall, stiff=True
    )


def compute_rate_errors(
    traj: Trajectory, full: FullState, states: State, reference: Array
) -> Array:
    """Compute the errors of rates over time.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        states: States of the trajectory at T times or more.
        reference: Full states of the reference solution at the first T times, (T, n).
    Returns:
        (T,) errors in the units of defects.
    """
    y = full.state(states.pose, states.x, states.xi, states.xdot)[: len(reference)]
    errors = np.abs(y - reference) / defect_units(traj, full)[0]
    first = traj.system.group.size + full.coordinates
    return np.asarray(errors[:, first:].max(axis=1, initial=0.0))


def closest_defect(
    steps: Array, impulses: Array, fast: NDArray[np.bool_], tolerance: float
) -> tuple[float, float]:
    """Return the defect of a step that is closest to its bound, and this bound.

    Args:
        steps: Relative defects of smooth steps, (S,).
        impulses: Result of `unresolved_forces` for these steps, (S,).
        fast: Result of `are_fast` for these steps, (S,).
        tolerance: Sum of relative and absolute tolerance.
    """
    bounds = np.full(len(steps), DEFECT_BOUND * tolerance)
    if steps.mean() <= DEFECT_BOUND * tolerance:
        bounds[fast] = FAST_BOUND * tolerance
        bounds = np.clip(UNRESOLVED_BOUND * impulses, bounds, SINGLE_BOUND * tolerance)
    k = int(np.argmax(steps / bounds))
    return float(steps[k]), float(bounds[k])


def explain_decaying_errors(
    decaying: DecayingErrors, rates: Array, bounds: Array, tolerance: float
) -> tuple[str, ...]:
    """Return the reason why errors that decay cannot be judged; empty if they pass.

    Args:
        decaying: Errors of stiff steps.
        rates: Relative errors of rates at the report times, (T,).
        bounds: Bounds on relative errors at these times, (T,).
        tolerance: Sum of relative and absolute tolerance.
    Returns:
        One sentence, or an empty tuple.
    """
    if not decaying.coordinates <= DENSE_BOUND * tolerance:
        return (
            f"errors up to {decaying.coordinates:.1e} at the ends of stiff steps decay and cannot "
            "be judged; use a tighter tolerance",
        )
    if decaying.rates > DEFECT_BOUND * tolerance and (rates > bounds).any():
        return (
            "rates of stiff motion differ from the reference by up to "
            f"{rates[rates > bounds].max():.1e} at report times, without effect on the "
            "coordinates; use Radau, or a tighter tolerance if these rates matter",
        )
    return ()


def count_informative_times(bounds: Array, growth: Array) -> int:
    """Return the number of leading times at which errors can be judged.

    Args:
        bounds: Bounds on relative errors over time, (T,).
        growth: Factors by which a small perturbation has grown, (T,).
    Returns:
        Number of times before a bound or the perturbation exceeds INFORMATIVE.
    """
    uninformative = (bounds > INFORMATIVE) | (growth * PERTURBATION > INFORMATIVE)
    return int(np.argmax(uninformative)) if uninformative.any() else len(bounds)


def explain_uninformative_times(
    times: Array, count: int, bounds: Array, growth: Array
) -> tuple[str, ...]:
    """Return the reason why only the first times can be judged; empty if all times can be judged.

    Args:
        times: Times of the comparison, (T,) [s].
        count: Number of times that can be judged.
        bounds: Bounds on relative errors over time, (T,).
        growth: Factors by which a small perturbation has grown, (T,).
    Returns:
        One sentence, or an empty text.
    """
    if count == len(times):
        return ()
    cause = (
        f"a small change of the initial state has grown {growth[-1]:.1e} times by the end"
        if growth[-1] * PERTURBATION > INFORMATIVE
        else f"errors up to {bounds[-1]:.1e} would pass by the end"
    )
    return (
        f"errors of the motion can be judged until t = {times[max(count - 1, 0)]:g} s only: "
        f"{cause}; compare a shorter motion, or a tighter tolerance",
    )


def explain_rest(reference: FullMotion, size: Size) -> tuple[str, ...]:
    """Return the reason why a system at rest cannot be judged; empty if the system moves."""
    configurations = np.abs(reference.q - reference.q[0]).max(initial=0.0)
    joints = 0.0
    if reference.x.shape[1] == len(size.joints):  # without balls, whose attitudes are part of q
        joints = (np.abs(reference.x - reference.x[0]) / size.joints).max(initial=0.0)
    if max(float(configurations) / max(size.position, 1.0), float(joints)) > _REST:
        return ()
    return ("nothing moves, so the equations are not tested: give rates, a twist or forces",)


@dataclass(frozen=True)
class ErrorBounds:
    """Bounds on the errors of a motion over time.

    Attributes:
        relative: Bounds in units of the motion's size, (T,).
        distance: The same bounds in the units of each error, (T, …).
        total_defect: Sum of the defects of all steps, limited to what passes.
    """

    relative: Array
    distance: Distance
    total_defect: float


def compute_error_bounds(
    traj: Trajectory,
    times: Array,
    growth: Array,
    defects: Defects,
    errors: Array,
    size: Size,
    tolerance: float,
    contacts: Array | float = 0.0,
) -> ErrorBounds:
    """Bound the errors at each time by the accumulated defects times the growth of perturbations.

    Args:
        traj: The trajectory.
        times: Times of the comparison, (T,) [s].
        growth: Factors by which a small perturbation has grown, (T,).
        defects: Defects of the trajectory.
        errors: Errors of the reference, (T,), relative.
        size: Units of errors.
        tolerance: Sum of relative and absolute tolerance.
        contacts: Sums of the errors with which earlier impacts were found, (T,), relative.
    Returns:
        Bounds at all times.
    """
    knots, smooth = traj.motion.knots, defects.smooth
    steps = np.searchsorted(knots, times, side="left")
    # A failing defect must not loosen the bound on errors, so defects are limited to what passes.
    mean = float(defects.steps[smooth].mean())
    worst = float(defects.subintervals[smooth].max())
    largest_step, largest = DEFECT_BOUND * tolerance, DENSE_BOUND * tolerance
    mean_share, share = largest_step / max(mean, largest_step), largest / max(worst, largest)
    per_step = mean_share * float(defects.motion_steps[smooth].mean())
    # Times lie inside steps, where dense output has an error of lower order.
    dense = share * float(defects.motion_subintervals[smooth].max())
    # Steps with kinks are exempt from the bound on defects, so each of them is limited by itself.
    kinked_steps = defects.steps[~smooth]
    shares = largest_step / np.maximum(kinked_steps, largest_step)
    sampled = (len(knots) - 1) / len(smooth)  # at most 200 steps are evaluated
    kinked = sampled * float((shares * defects.motion_steps[~smooth]).sum())
    local = steps * per_step + np.where(steps > 0, kinked + dense, 0.0) + _ROUND_OFF * (steps + 1)
    local += contacts
    local += defects.round_off_rate * times  # round-off of ABA affects the references, too
    floor = RESOLUTION + np.maximum.accumulate(errors)
    relative = _SAFETY * (growth * local + floor)
    bounds = Distance(
        joints=relative[:, None] * size.joints,
        rotation=relative,
        # Positions far from the origin have the round-off of their distance on both sides.
        position=relative * size.position + _SAFETY * _ROUND_OFF * size.away,
    )
    total = mean_share * mean * (len(knots) - 1) + sampled * float((shares * kinked_steps).sum())
    return ErrorBounds(relative, bounds, total)

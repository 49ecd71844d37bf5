"""compare(): the judge.  Pinocchio's ABA on the full state against a reduced trajectory.

The full simulation (full_state.py) shares no dynamics with the reduced one.  It runs at a
tolerance 100 times tighter, by two methods of order 8 and 5, whose difference tells how
accurate the judge is.

What passes, in three steps, each with its own line:
1. The route's equations are ABA's: at the states of the trajectory its accelerations agree to
   round-off (equations_of_motion.py).  Neither chaos nor the tolerance plays a part.
2. Its steps follow them: the defect of each by ABA is what the tolerance allows (defect.py).
3. Its ends are where that leads: errors are the sum of the defects there have been, times the
   growth of a kick until then, measured by ABA; 10 times that passes, for each joint in units of
   its own motion.
Where the third bound exceeds 0.1, the end of the motion says nothing, and neither does the
verdict: it cannot tell.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..common.progress import Progress, shown
from ..simulation.balances import energy_balance, momentum_balance
from ..simulation.trajectory import Trajectory
from ..system.state_fields import State
from .audit import Audit
from .defect import Defects, defects
from .distances import Distance, FullMotion, Size
from .equations_of_motion import equation_errors
from .full_state import FINEST, KICK, FullState
from .measurements import measurement_error
from .report import JUDGEABLE, Report

TIGHTER = 100.0  # the reference's tolerance is this much below the one asked for
SAMPLES = 101  # times at which a motion is judged, besides those it reports
SAFETY = 10.0  # for a growth that is measured by one kick, and the defects of some steps
EXACT = 1e-12  # relative; what two ways to the same accelerations leave of round-off
DEFECT = 3.0  # tolerances; a step's defect, as the stress suite holds it on extreme robots
BETWEEN = 50.0  # tolerances; the same between the ends of steps, of which no control sees the error
DRIFT = 100.0  # tolerances, at least; what errors of so many steps may do to energy
REFERENCE = 100.0  # tolerances for each growth; beyond it the reference is no reference
CONSISTENT = 1e-9  # relative; pose, twist, momenta and energy are functions of q and v
_RESOLVED = 1e-13  # relative; what the reference and its energies can tell from round-off
_ROUND_OFF = 1e-15  # relative, of a step
_STILL = 1e-12  # of a radian, or of the robot's size: less is no motion to be judged


def compare(traj: Trajectory, *, progress: Progress | bool | None = None) -> Report:
    """Judge a trajectory against the full simulation of the same scene.

    progress: True for a progress bar; or a function that is called with the part of the work
        that is done, 0 to 1.
    The report is true if the comparison passed: `assert pinred.compare(traj)`.
    Raises IntegrationError if the full simulation cannot be followed.
    """
    if not isinstance(traj, Trajectory):
        raise InputError(
            f"compare takes a Trajectory, got {type(traj).__name__}; simulate makes one"
        )
    with shown(progress, "full") as done:
        return _judged(traj, done or (lambda _: None))


@dataclass(frozen=True)
class _Ends:
    """What passes of the ends of a motion over time, (T, …), and how far something is told.

    mean: the defect of a step that counts.
    """

    bound: Distance
    mean: float
    told: int
    reasons: tuple[str, ...]


def _judged(traj: Trajectory, done: Progress) -> Report:
    scene, start, rtol, atol = traj.scene, traj.scene.start, traj.scene.rtol, traj.scene.atol
    # Whatever times the scene reports, all of the motion is judged.
    times = np.union1d(traj.t, np.linspace(0.0, scene.end, SAMPLES))
    states = traj(times)
    full = FullState(scene, traj.motion.replay)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    began = time.perf_counter()
    full.run(y0, np.array([scene.end]), rtol, atol)
    wall_full = time.perf_counter() - began
    done(0.1)
    tight = max(rtol / TIGHTER, FINEST[0]), atol / TIGHTER
    truth = full.run(y0, times, *tight)
    done(0.3)
    growth = full.growth(y0, truth, times, *tight)
    done(0.5)
    second = full.run(y0, times, *tight, method="dopri5")
    done(0.8)
    missed = defects(traj, full)
    equations = equation_errors(traj, full, np.linspace(0.0, scene.end, SAMPLES))
    done(0.9)
    found = FullMotion(x=full.ties.values(states.x), q=traj.system.sorted_q(states.q))
    size, error = full.size(truth), full.distance(truth, found)
    between = full.distance(truth, second).relative(size)
    tolerance = max(rtol, _RESOLVED) + atol
    ends = _ends(traj, times, growth, missed, between, size, tolerance)
    audit = audited(traj, states)
    done(1.0)
    drift = max(DRIFT * tolerance, 2.0 * ends.mean * (len(traj.motion.knots) - 1))
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
        shape_bounds=ends.bound.joints,
        rotation_bounds=ends.bound.rotation,
        position_bounds=ends.bound.position,
        equations=float(equations.max(initial=0.0)),
        defect=missed.worst,
        energy_drift=audit.energy,
        momentum_drift=audit.momentum,
        field_error=max(audit.fields, measurement_error(traj, full)),
        reference_error=float(between[: ends.told].max(initial=0.0)),
        equations_bound=EXACT,
        defect_bound=DEFECT * tolerance,
        drift_bound=drift,
        field_bound=CONSISTENT,
        reference_bound=min(
            REFERENCE * tolerance * float(growth[max(ends.told - 1, 0)]), JUDGEABLE
        ),
        growth=growth,
        told=ends.told,
        reasons=(*ends.reasons, *_at_rest(truth, size)),
        wall_reduced=traj.run.wall,
        wall_full=wall_full,
        left_out=scene.left_out,
    )


def _ends(
    traj: Trajectory,
    times: Array,
    growth: Array,
    missed: Defects,
    between: Array,
    size: Size,
    tolerance: float,
) -> _Ends:
    """Return what the ends of a motion may be off by, and how far that tells something.

    missed: the defects of steps.  between: (T,) how far the references are apart, of which
    both may be wrong.  tolerance: relative and absolute.
    """
    knots = traj.motion.knots
    steps = np.searchsorted(knots, times, side="left")
    # Between the ends of steps is what the method makes of it, of an order less than the steps.
    # A defect beyond what passes is a failure, and excuses none.
    mean, within = float(missed.steps.mean()), float(missed.inside.max())
    most, most_within = DEFECT * tolerance, BETWEEN * tolerance
    parts, parts_within = most / max(mean, most), most_within / max(within, most_within)
    carried = parts * float(missed.carried.mean())
    carried_within = parts_within * float(missed.carried_inside.max())
    local = steps * carried + np.where(steps > 0, carried_within, 0.0) + _ROUND_OFF * (steps + 1)
    local += missed.blurred * times  # the reference is led by it, and so may both references be
    floor = _RESOLVED + np.maximum.accumulate(between)
    allowed = SAFETY * (growth * local + floor)
    told = int(np.argmax(allowed > JUDGEABLE)) if (allowed > JUDGEABLE).any() else len(times)
    kicked = growth * KICK > JUDGEABLE
    told = min(told, int(np.argmax(kicked)) if kicked.any() else len(times))
    bound = Distance(
        joints=allowed[:, None] * size.joints,
        rotation=allowed,
        # A place far away is a number with round-off of its distance, on either side.
        position=allowed * size.position + SAFETY * _ROUND_OFF * size.away,
    )
    reasons: tuple[str, ...] = ()
    if told < len(times):
        until = float(times[max(told - 1, 0)])
        rest = (
            f"a small change of the start has grown {growth[-1]:.1e} times by the end"
            if growth[-1] * KICK > JUDGEABLE
            else f"errors up to {allowed[-1]:.1e} would pass by the end"
        )
        reasons = (
            f"the ends of the motion say something until t = {until:g} s only: {rest}; "
            "compare a shorter motion, or a tighter tolerance",
        )
    return _Ends(bound, parts * mean, told, reasons)


def _at_rest(truth: FullMotion, size: Size) -> tuple[str, ...]:
    """Return the reason for which a motion that is none cannot be judged, if it is none."""
    moved = np.abs(truth.q - truth.q[0]).max(initial=0.0)
    turned = (np.abs(truth.x - truth.x[0]) / size.joints).max(initial=0.0)
    if max(float(moved) / max(size.position, 1.0), float(turned)) > _STILL:
        return ()
    return ("nothing moves, so nothing of the equations is seen: give rates, a twist or forces",)


def audited(traj: Trajectory, states: State) -> Audit:
    """Return what Pinocchio says of states of a trajectory, work and impulse taken off."""
    work = energy_balance(traj.plan, traj.motion, states).work.sum(axis=1)
    impulse = None
    if traj.plan.acting.momentum_changes:
        impulse = momentum_balance(traj.plan, traj.motion, states).impulse
    return FullState(traj.scene).audit(states, work, impulse)

"""Checks of a motion with joint stops: impacts, momentum across them, gaps, and reactions.

An impact is compared with that of the reference solution. The allowed error of its time is the
bound on the position of the joint, divided by the speed at which it reaches the stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..simulation.impacts import ImpactTable
from ..simulation.trajectory import Trajectory
from .step_defects import defect_units, full_states
from .stop_reference import Hit, StoppedFullState, matched

MOMENTUM_BOUND = 1e-12  # largest change of momentum at an impact, relative to √(2mT)
REACTION_BOUND = 1e-8  # largest pull of a stop, relative to the largest reaction
GAP_BOUND = 50.0  # largest distance beyond a stop, in tolerances; dense output is not controlled
_SAFETY = 10.0  # margin, because growth and defects are only sampled
_MOST_TIMES = 400  # largest number of times at which reactions are computed


@dataclass(frozen=True)
class StopChecks:
    """The checks of stops.

    Attributes:
        checks: (name, value, largest value that passes) of each check.
        reasons: Why the impacts cannot be judged completely; empty if they can.
    """

    checks: tuple[tuple[str, float, float], ...]
    reasons: tuple[str, ...]


def judgeable_until(
    grazes: Sequence[tuple[float, float]], until: float, times: Array, bounds: Array
) -> float:
    """Return the time until which errors of positions do not add or remove impacts [s].

    Args:
        grazes: Times of grazing impacts and near misses; see HybridSolution.
        until: Time of the first impact that a small perturbation changes [s].
        times: Times of the comparison, (T,) [s].
        bounds: Bounds on relative errors of positions at these times, (T,).
    """
    at = np.minimum(np.searchsorted(times, [t for t, _ in grazes]), len(bounds) - 1)
    undecided = [t for (t, margin), k in zip(grazes, at, strict=True) if margin <= bounds[k]]
    return min([until, *undecided])


def check_stops(
    traj: Trajectory,
    full: StoppedFullState,
    hits: Sequence[Hit],
    until: float,
    times: Array,
    bounds: Array,
) -> StopChecks:
    """Compare the impacts of a trajectory with those of the reference solution.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        hits: Impulses of the reference.
        until: Time until which impacts can be judged [s].
        times: Times of the comparison, (T,) [s].
        bounds: Bounds on relative errors of positions at these times, (T,).
    Returns:
        The checks.
    """
    table, reasons = traj.impacts, list[str]()
    slowest = full.slowest
    own = _hits_of(table)
    units = defect_units(traj, full)[1]
    rates = {row.joint: units[len(units) - full.system.model.nv + row.v] for row in full.rows}

    def bound_at(t: float) -> float:
        return float(bounds[min(int(np.searchsorted(times, t)), len(bounds) - 1)])

    def time_bound(hit: Hit) -> float:
        return bound_at(hit.t) * max(1.0, abs(_position(full, hit))) / max(hit.speed, 1e-300)

    pairs, differs = matched(own, hits, slowest)
    if until < np.inf:
        reasons.append(
            f"impacts can be judged until t = {until:g} s only: there, a small change of the "
            "initial state changes which joints hit their stops, or in which order; compare a "
            "shorter motion, or a tighter tolerance"
        )
    pairs = [(a, b) for a, b in pairs if b.t < until]
    if differs < min(until, traj.scene.end):
        near = [h for h in hits if abs(h.t - differs) <= 2.0 * time_bound(h)]
        late = [h for h in (*own, *hits) if traj.scene.end - h.t <= 2.0 * time_bound(h)]
        if len({(h.joint, h.side) for h in near}) > 1 or any(h.t == differs for h in late):
            reasons.append(
                f"the order of the impacts at t = {differs:g} s cannot be told: they are closer "
                "than the errors of both motions; compare a tighter tolerance"
            )
            differs = np.inf
    wrong = float(differs < min(until, traj.scene.end))
    errors = [(abs(a.t - b.t), time_bound(b) + 1e-13 * traj.scene.end) for a, b in pairs]
    strengths = []
    for a, b in pairs:
        # Impulses are proportional to the speed. Its error is that of the rates, and that of the
        # time of impact, times the acceleration.
        speed = b.speed if b.speed > 0.0 else np.inf
        of_time = b.pull * max(1.0, abs(_position(full, b))) / speed**2
        allowed = _SAFETY * bound_at(b.t) * max(1.0, rates[b.joint] / speed, of_time)
        strengths.append((abs(a.impulse - b.impulse) / max(abs(b.impulse), 1e-300), allowed))
    checks = [
        ("impacts in other order", wrong, 0.0),
        ("time of an impact [s]", *_closest(errors)),
        ("impulse of an impact [relative]", *_closest(strengths)),
        ("momentum at an impact [relative]", _momentum_jump(traj, full), MOMENTUM_BOUND),
        ("distance beyond a stop", *_beyond(traj, full, times)),
        ("pull of a stop [relative]", _pull(traj, full), REACTION_BOUND),
    ]
    return StopChecks(tuple(checks), tuple(reasons))


def _hits_of(table: ImpactTable) -> list[Hit]:
    """Return the rows of a table of impacts."""
    return [
        Hit(float(t), joint, side, float(impulse), float(abs(rate)))
        for t, joint, side, impulse, rate in zip(
            table.t, table.joint, table.side, table.impulse, table.rate_before, strict=True
        )
    ]


def _position(full: StoppedFullState, hit: Hit) -> float:
    return next(row.position for row in full.rows if (row.joint, row.side) == (hit.joint, hit.side))


def _closest(errors: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the error that is closest to its bound, and this bound."""
    if not errors:
        return 0.0, 0.0
    return max(errors, key=lambda each: each[0] / max(each[1], 1e-300))


def _momentum_jump(traj: Trajectory, full: StoppedFullState) -> float:
    """Return the largest change of the spatial momentum at an impact, by Pinocchio, relative."""
    times = traj.impacts.times
    if not len(times):
        return 0.0
    before, after = (full_states(traj, full, t) for t in (times, np.nextafter(times, np.inf)))
    momenta, unit = [], 0.0
    for y in (before, after):
        q, v = full.q(y), full.shapes_and_velocities(y)[1]
        momenta.append(full.totals.momentum(q, v, np.zeros(3), about_pivot=True))
        kinetic = full.totals.kinetic_energy(q, v).max()
        unit = max(unit, float(np.sqrt(2.0 * full.totals.mass * kinetic)))
        reach = np.abs(y[:, : full.root.linear]).max(initial=0.0)
    radius = full.totals.radius_of_gyration(full.q(before)[0]) + reach
    jump = float(np.abs(momenta[0] - momenta[1]).max(initial=0.0))
    return jump / (unit * max(1.0, float(radius)))


def _beyond(traj: Trajectory, full: StoppedFullState, times: Array) -> tuple[float, float]:
    """Return the largest distance beyond a stop, and the largest that passes [rad | m]."""
    evaluated = np.unique(np.concatenate([times, traj.motion.knots]))
    least = full.gaps(full_states(traj, full, evaluated)).min(axis=0, initial=np.inf)
    allowed = np.array(
        [
            GAP_BOUND * (traj.scene.atol + traj.scene.rtol * max(1.0, abs(row.position)))
            for row in full.rows
        ]
    )
    beyond = np.maximum(-least, 0.0)
    k = int(np.argmax(beyond / allowed))
    return float(beyond[k]), float(allowed[k])


def _pull(traj: Trajectory, full: StoppedFullState) -> float:
    """Return the largest pull of a stop on a resting joint, relative to the largest reaction."""
    starts, ends = traj.motion.step_spans
    times = 0.5 * (starts + ends)
    if len(times) > _MOST_TIMES:
        times = times[np.unique(np.linspace(0, len(times) - 1, _MOST_TIMES).astype(int))]
    y, numbers = full_states(traj, full, times), traj.motion.numbers(times)
    pull = largest = 0.0
    for rest, rows in traj.motion.resting(times):
        if not rest:
            continue
        resting = tuple(map(traj.scene.bounds.index, rest))
        for k in rows.tolist():
            full.set_parameters(numbers[k])
            reactions = full.reactions(float(times[k]), y[k], resting)
            pull = max(pull, float(-reactions.min()))
            largest = max(largest, float(np.abs(reactions).max()))
    return pull / largest if largest > 0.0 else 0.0

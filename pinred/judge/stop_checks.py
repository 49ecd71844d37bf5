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
PULL_BY_ROUND_OFF = 1e-13  # pull that counts as none, per kinetic energy [1/rad | 1/m]
GAP_BOUND = 50.0  # largest distance beyond a stop, in tolerances; dense output is not controlled
_SAFETY = 10.0  # margin, because growth and defects are only sampled
_MOST_TIMES = 400  # largest number of times at which reactions are computed


@dataclass(frozen=True)
class StopChecks:
    """The checks of stops.

    Attributes:
        checks: (name, value, largest value that passes) of each check.
        reasons: Why the impacts cannot be judged completely; empty if they can.
        until: Time until which the motion can be judged [s].
    """

    checks: tuple[tuple[str, float, float], ...]
    reasons: tuple[str, ...]
    until: float


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


def contact_errors(traj: Trajectory, full: StoppedFullState, times: Array) -> Array:
    """Return the sums of the gaps at which earlier impacts happened, relative, (T,).

    Contacts are found in the dense output of steps, which is less accurate than their ends. Gaps
    are limited to the distance beyond a stop that passes.

    Args:
        traj: The trajectory.
        full: Full simulation of its scene.
        times: Times of the comparison, (T,) [s].
    """
    table = traj.impacts
    if not len(table):
        return np.zeros(len(times))
    place = {(row.joint, row.side): k for k, row in enumerate(full.rows)}
    rows = np.array([place[each] for each in zip(table.joint, table.side, strict=True)])
    gaps = np.abs(full.gaps(full_states(traj, full, table.t)))[np.arange(len(rows)), rows]
    units = defect_units(traj, full)[1][[full.rows[k].x for k in rows]]
    errors = np.cumsum(np.minimum(gaps, _allowed_distances(traj, full)[rows]) / units)
    return np.append(0.0, errors)[np.searchsorted(table.t, times, side="left")]


def _allowed_distances(traj: Trajectory, full: StoppedFullState) -> Array:
    """Return the largest distances beyond stops that pass, (R,) [rad | m]."""
    sizes = np.array([max(1.0, abs(row.position)) for row in full.rows])
    return np.asarray(GAP_BOUND * (traj.scene.atol + traj.scene.rtol * sizes))


@dataclass(frozen=True)
class _Rules:
    """The allowed errors of impacts.

    Attributes:
        slowest: Speed below which impacts are not compared [rad/s | m/s].
        together: Time between contacts that make one impact in a simulation [s].
        end: End of the motion [s].
        sizes: {(joint, side): size of the position of the stop, at least 1}.
        rates: {joint: unit of its rate}.
        times: Times of the comparison, (T,) [s].
        bounds: Bounds on relative errors of positions at these times, (T,).
    """

    slowest: float
    together: float
    end: float
    sizes: dict[tuple[str, str], float]
    rates: dict[str, float]
    times: Array
    bounds: Array

    @classmethod
    def of(cls, traj: Trajectory, full: StoppedFullState, times: Array, bounds: Array) -> _Rules:
        """Return the rules for a motion; see check_stops."""
        units = defect_units(traj, full)[1][-full.system.model.nv :]
        sizes = {(row.joint, row.side): max(1.0, abs(row.position)) for row in full.rows}
        rates = {row.joint: float(units[row.v]) for row in full.rows}
        end = traj.scene.end
        return cls(full.slowest, traj.scene.rtol * end, end, sizes, rates, times, bounds)

    def _bound(self, t: float) -> float:
        return float(self.bounds[min(int(np.searchsorted(self.times, t)), len(self.bounds) - 1)])

    def time_error(self, hit: Hit) -> float:
        """Return the allowed error of the time of an impact [s]."""
        size = self.sizes[hit.joint, hit.side]
        return self._bound(hit.t) * size / max(hit.speed, 1e-300)

    def impulse_error(self, hit: Hit) -> float:
        """Return the allowed relative error of an impulse.

        Impulses are proportional to the speed. Its error is that of the rates, and that of the time
        of the impact, times the acceleration.
        """
        speed = hit.speed if hit.speed > 0.0 else np.inf
        of_time = hit.pull * self.sizes[hit.joint, hit.side] / speed**2
        return _SAFETY * self._bound(hit.t) * max(1.0, self.rates[hit.joint] / speed, of_time)


def pair_impacts(
    own: Sequence[Hit], hits: Sequence[Hit], until: float, rules: _Rules
) -> tuple[list[tuple[Hit, Hit]], float, float]:
    """Pair the impacts of a trajectory with those of the reference, up to the first difference.

    Impacts of several joints that are closer than the errors of their times may happen in another
    order, or together. Then other impulses follow from Newton's law, and so does another motion.

    Args:
        own: Impulses of the trajectory, in order of time.
        hits: Impulses of the reference.
        until: Time until which impacts can be judged [s].
        rules: The allowed errors.
    Returns:
        The pairs; the time of the first impact that only one motion has, or inf; and the time of
        the first impacts whose order cannot be told, or inf [s].
    """
    pairs, differs = matched(own, hits, rules.slowest)
    wrong = next((b.t for a, b in pairs if _is_other_impact(a, b, rules)), differs)
    if wrong >= until:
        return pairs, np.inf, np.inf
    first, last = _cluster([*own, *hits], wrong, rules)
    if len({(hit.joint, hit.side) for hit in hits if first <= hit.t <= last}) > 1:
        return [pair for pair in pairs if pair[1].t < first], np.inf, first
    late = [h for h in (*own, *hits) if rules.end - h.t <= 2.0 * rules.time_error(h)]
    if any(hit.t == wrong for hit in late):
        return pairs, np.inf, wrong
    return pairs, differs, np.inf


def _is_other_impact(a: Hit, b: Hit, rules: _Rules) -> bool:
    """Return whether impulses differ because joints reach their stops at other speeds."""
    allowed = rules.impulse_error(b)
    is_other = abs(a.speed - b.speed) > allowed * b.speed
    return is_other and abs(a.impulse - b.impulse) > allowed * abs(b.impulse)


def _cluster(hits: list[Hit], t: float, rules: _Rules) -> tuple[float, float]:
    """Return the first and last time of the impacts around a time whose order is not certain."""
    near = sorted((hit for hit in hits if hit.speed > rules.slowest), key=lambda hit: hit.t)
    errors = np.array([rules.time_error(hit) for hit in near])
    times = np.array([hit.t for hit in near])
    apart = np.diff(times) > errors[1:] + errors[:-1] + rules.together
    label = np.append(0, np.cumsum(apart))
    first, last = times[label == label[np.searchsorted(times, t)]][[0, -1]]
    return float(first), float(last)


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
    reasons = list[str]()
    rules = _Rules.of(traj, full, times, bounds)
    if until < np.inf:
        reasons.append(
            f"impacts can be judged until t = {until:g} s only: there, a small change of the "
            "initial state changes which joints hit their stops, or in which order; compare a "
            "shorter motion, or a tighter tolerance"
        )
    own = _hits_of(traj.impacts)
    pairs, differs, undecided = pair_impacts(own, hits, min(until, traj.scene.end), rules)
    if undecided < np.inf:
        reasons.append(
            f"the order of the impacts at t = {undecided:g} s cannot be told: they are closer "
            "than the errors of both motions; compare a tighter tolerance"
        )
    pairs = [(a, b) for a, b in pairs if b.t < until]
    errors = [(abs(a.t - b.t), rules.time_error(b) + 1e-13 * traj.scene.end) for a, b in pairs]
    strengths = [
        (abs(a.impulse - b.impulse) / max(abs(b.impulse), 1e-300), rules.impulse_error(b))
        for a, b in pairs
    ]
    strengths += _impulses_at_rest(pairs, own, hits, rules)
    wrong = float(differs < min(until, traj.scene.end))
    checks = [
        ("impacts in other order", wrong, 0.0),
        ("time of an impact [s]", *_closest(errors)),
        ("impulse of an impact [relative]", *_closest(strengths)),
        ("momentum at an impact [relative]", _momentum_jump(traj, full), MOMENTUM_BOUND),
        ("distance beyond a stop", *_beyond(traj, full, times)),
        ("pull of a stop [relative]", _pull(traj, full), REACTION_BOUND),
    ]
    return StopChecks(tuple(checks), tuple(reasons), min(until, undecided))


def _impulses_at_rest(
    pairs: Sequence[tuple[Hit, Hit]], own: Sequence[Hit], hits: Sequence[Hit], rules: _Rules
) -> list[tuple[float, float]]:
    """Return the errors of impulses on joints that others push, relative to those, with bounds."""
    errors = []
    for a, b in pairs:
        mine, others = ([h for h in each if h.t == t] for each, t in ((own, a.t), (hits, b.t)))
        if [(h.joint, h.side) for h in mine] != [(h.joint, h.side) for h in others]:
            continue
        errors += [
            (abs(h.impulse - other.impulse) / max(abs(b.impulse), 1e-300), rules.impulse_error(b))
            for h, other in zip(mine, others, strict=True)
            if other.speed <= rules.slowest
        ]
    return errors


def _hits_of(table: ImpactTable) -> list[Hit]:
    """Return the rows of a table of impacts."""
    return [
        Hit(float(t), joint, side, float(impulse), float(-rate if side == "lower" else rate))
        for t, joint, side, impulse, rate in zip(
            table.t, table.joint, table.side, table.impulse, table.rate_before, strict=True
        )
    ]


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
    allowed = _allowed_distances(traj, full)
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
    energies = full.totals.kinetic_energy(full.q(y), full.shapes_and_velocities(y)[1])
    round_off = PULL_BY_ROUND_OFF * float(energies.max())
    for rest, rows in traj.motion.resting(times):
        if not rest:
            continue
        resting = tuple(map(traj.scene.bounds.index, rest))
        for k in rows.tolist():
            full.set_parameters(numbers[k])
            reactions = full.reactions(float(times[k]), y[k], resting)
            pull = max(pull, float(-reactions.min()) - round_off)
            largest = max(largest, float(np.abs(reactions).max()))
    return pull / largest if largest > 0.0 else 0.0

"""Checks of impacts: at joint stops, and of the captures, releases and landings of a chain.

At joint stops, an impact is compared with that of the reference solution. The allowed error of its
time is the bound on the position of the joint, divided by the speed at which it reaches the stop.
Momentum across impacts, gaps, and reactions at rest are checked, too.

The impacts of a chain are computed by an independent route, which uses the models as Pinocchio
reads them: the mass matrices of all joints by CRBA, the Jacobians of the frames in the files, and
one linear system for velocities and impulse,

    [ H  Cᵀ ] [ v⁺ ]   [ H v⁻ ]
    [ C  0  ] [ −λ ] = [  0   ],

where the rows C say that the frames move alike, or stand still, that followers follow, and that
loops stay closed. This route knows neither the joined robot nor the stance robot; their links are
compared with the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..simulation.contact.capture import Capture, Landing, Release
from ..simulation.contact.chain import Chain, Impact
from ..simulation.impacts import ImpactTable
from ..simulation.trajectory import Trajectory
from ..system.derived_systems import Instant
from ..system.loops.kinematics import LoopKinematics
from ..system.system import System
from .full_system import RANK, mass_matrix
from .step_defects import defect_units, full_states
from .stop_reference import Hit, StoppedFullState, matched
from .verdict import Report, Verdict, table_of

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
    index_of_side = {(stop.joint, stop.side): k for k, stop in enumerate(full.rows)}
    sides = np.array([index_of_side[key] for key in zip(table.joint, table.side, strict=True)])
    gaps = np.abs(full.gaps(full_states(traj, full, table.t)))[np.arange(len(sides)), sides]
    units = defect_units(traj, full)[1][[full.rows[k].x for k in sides]]
    errors = np.cumsum(np.minimum(gaps, _allowed_distances(traj, full)[sides]) / units)
    return np.append(0.0, errors)[np.searchsorted(table.t, times, side="left")]


def _allowed_distances(traj: Trajectory, full: StoppedFullState) -> Array:
    """Return the largest distances beyond stops that pass, (R,) [rad | m]."""
    sizes = np.array([max(1.0, abs(stop.position)) for stop in full.rows])
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
        sizes = {(stop.joint, stop.side): max(1.0, abs(stop.position)) for stop in full.rows}
        rates = {stop.joint: float(units[stop.v]) for stop in full.rows}
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
    is_separate = np.diff(times) > errors[1:] + errors[:-1] + rules.together
    label = np.append(0, np.cumsum(is_separate))
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
    simulated = _hits_of(traj.impacts)
    pairs, differs, undecided = pair_impacts(simulated, hits, min(until, traj.scene.end), rules)
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
    strengths += _impulses_at_rest(pairs, simulated, hits, rules)
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
        mine, others = (
            [h for h in impulses if h.t == t] for impulses, t in ((own, a.t), (hits, b.t))
        )
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
    for resting_bounds, indices in traj.motion.resting(times):
        if not resting_bounds:
            continue
        resting = tuple(map(traj.scene.bounds.index, resting_bounds))
        for k in indices.tolist():
            full.set_parameters(numbers[k])
            reactions = full.reactions(float(times[k]), y[k], resting)
            pull = max(pull, float(-reactions.min()) - round_off)
            largest = max(largest, float(np.abs(reactions).max()))
    return pull / largest if largest > 0.0 else 0.0


IMPACT_BOUND = 1e-11  # largest passing difference across an impact, relative to size and speed


@checks_arguments
@dataclass(frozen=True)
class ImpactReport:
    """Errors of a capture, release or landing, relative to sizes before and after it.

    Attributes:
        title: What happens, and when.
        values: Each error by name.
        bound: Largest error that passes.
    """

    title: str
    values: dict[str, float]
    bound: float = IMPACT_BOUND

    @property
    def checks(self) -> dict[str, tuple[float, float]]:
        """Name → (value, largest value that passes) of each check."""
        return {name: (value, self.bound) for name, value in self.values.items()}

    @property
    def verdict(self) -> Verdict:
        """FAILED if a value exceeds its bound or is NaN."""
        is_passed = all(value <= self.bound for value in self.values.values())
        return Verdict.PASSED if is_passed else Verdict.FAILED

    def __str__(self) -> str:
        lines = [self.title, "full mass matrices and one linear system for each impulse"]
        return "\n".join([*lines, *table_of(self.checks), f"  verdict: {self.verdict}"])


@checks_arguments
@dataclass(frozen=True)
class ChainReport:
    """Comparison of a chain with the full simulation, phase by phase.

    Attributes:
        phases: Report of each motion, in the order of time.
        impacts: Report of each impact.
    """

    phases: tuple[Report, ...]
    impacts: tuple[ImpactReport, ...]

    @property
    def verdict(self) -> Verdict:
        """FAILED if any part failed; CANNOT TELL if a motion cannot be judged completely."""
        verdicts = {r.verdict for r in self.phases} | {r.verdict for r in self.impacts}
        worst = (Verdict.FAILED, Verdict.CANNOT_TELL, Verdict.PASSED)
        return next(verdict for verdict in worst if verdict in verdicts)

    @property
    def passed(self) -> bool:
        """Whether all parts passed."""
        return self.verdict is Verdict.PASSED

    def __bool__(self) -> bool:
        return self.passed

    def __str__(self) -> str:
        reports = [str(report) for report in (*self.phases, *self.impacts)]
        return "\n\n".join([*reports, f"verdict of the chain: {self.verdict}"])

    def __repr__(self) -> str:
        count = f"{len(self.phases)} motions and {len(self.impacts)} impacts"
        return f"<ChainReport of {count}: {self.verdict}>"


def judge_impacts(chain: Chain) -> tuple[ImpactReport, ...]:
    """Return the errors of all impacts of a chain."""
    return tuple(
        judge_impact(impact, f"at t = {phase.end:g} s: ")
        for phase, impact in zip(chain.phases, chain.between, strict=False)
        if impact is not None
    )


def judge_impact(impact: Impact, title: str = "") -> ImpactReport:
    """Return the errors of an impact by the independent route.

    Args:
        impact: The capture, release or landing.
        title: Text before its name.
    """
    judge = {Capture: _capture, Release: _release, Landing: _landing}[type(impact)]
    return ImpactReport(f"{title}{impact!r}", judge(impact))  # type: ignore[operator]


class _Body:
    """A robot with all joints of its model, at one state."""

    def __init__(self, system: System, state: Instant) -> None:
        model, data = system.sorted_model, system.sorted_model.createData()
        self.model, self.data = model, data
        self.q = system.sorted_q(state.pose, state.x)
        self.v = system.sorted_v(state.xi, state.xdot)
        self.H = mass_matrix(model, data, self.q)
        self.constraints = np.vstack([_follower_rows(system), _loop_rows(system, self.q)])
        pin.computeJointJacobians(model, data, self.q)
        pin.updateFramePlacements(model, data)

    def rows(self, frame: str) -> Array:
        """Return the Jacobian of a frame, (6, nv), at its origin in world axes."""
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, self._number(frame), axes)
        return np.reshape(J, (6, self.model.nv))

    def placement(self, frame: str) -> pin.SE3:
        """Return the placement of a frame in the world."""
        return self.data.oMf[self._number(frame)]

    def _number(self, frame: str) -> int:
        """Return the index of a frame; a link takes precedence over others of its name."""
        link = (pin.FrameType.BODY,) if self.model.existFrame(frame, pin.FrameType.BODY) else ()
        return int(self.model.getFrameId(frame, *link))

    def twists(self, v: Array) -> dict[str, Array]:
        """Return the twists of all links in world axes, (6,), by name, for velocities (nv,)."""
        model, data = self.model, self.model.createData()
        pin.forwardKinematics(model, data, self.q, v)
        pin.updateFramePlacements(model, data)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return {
            str(f.name): pin.getFrameVelocity(model, data, k, axes).vector
            for k, f in enumerate(model.frames)
            if f.type == pin.FrameType.BODY and f.parentJoint > 0
        }

    def momentum(self, v: Array) -> Array:
        """Return the momentum about the world's origin, (6,), for velocities (nv,)."""
        data = self.model.createData()
        pin.computeCentroidalMomentum(self.model, data, self.q, v)
        about_com = pin.SE3(np.eye(3), data.com[0])
        return np.array(about_com.act(data.hg).vector)

    def energy(self, v: Array) -> float:
        """Return the kinetic energy [J] for velocities (nv,)."""
        return float(0.5 * v @ self.H @ v)


def _follower_rows(system: System) -> Array:
    """Return rows that vanish on velocities at which all followers follow, (k, nv)."""
    model = system.sorted_model
    rows = np.zeros((len(system.couplings), model.nv))
    for row, coupling in zip(rows, system.couplings, strict=True):
        row[model.joints[model.getJointId(coupling.follower)].idx_v] = 1.0
        for leader, ratio in coupling.ratios.items():
            row[model.joints[model.getJointId(leader)].idx_v] -= ratio
    return rows


def _loop_rows(system: System, q: Array) -> Array:
    """Return independent rows that vanish on velocities at which all loops stay closed, (k, nv)."""
    if not system.loops:
        return np.empty((0, system.sorted_model.nv))
    J = LoopKinematics(system.sorted_model, system.loops).jacobian(q)
    _, sizes, directions = np.linalg.svd(J, full_matrices=False)
    return np.asarray(directions[sizes > RANK * sizes[0]])


def _solve(H: Array, C: Array, v: Array) -> tuple[Array, Array]:
    """Return velocities after an impact that makes C v vanish, and the multipliers λ.

    Redundant rows, as of planar robots, have the smallest λ.
    """
    size = np.sqrt(np.diag(H))  # scale the unknowns, so that light joints count
    scaled, n = C / size, len(v)
    matrix = np.block([[H / np.outer(size, size), scaled.T], [scaled, np.zeros((len(C), len(C)))]])
    right = np.concatenate([(H @ v) / size, np.zeros(len(C))])
    solution = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    return solution[:n] / size, -solution[n:]


def _difference(values: ArrayLike, references: ArrayLike, scale: float) -> float:
    """Return the largest difference relative to a scale; 0 if all are zero."""
    error = float(np.abs(np.asarray(values) - np.asarray(references)).max(initial=0.0))
    return error / scale if scale else error


def _twist_error(found: dict[str, Array], expected: dict[str, Array], before: Array) -> float:
    names = found.keys() & expected.keys()
    scale = max(
        [float(np.abs(before).max(initial=0.0)), *(np.abs(expected[n]).max() for n in names)]
    )
    return max(_difference(found[name], expected[name], scale) for name in names)


def _capture(capture: Capture) -> dict[str, float]:
    a, b = _Body(capture.a, capture.before_a), _Body(capture.b, capture.before_b)
    na, prefix = len(a.v), capture.prefix
    H = np.block([[a.H, np.zeros((na, len(b.v)))], [np.zeros((len(b.v), na)), b.H]])
    v = np.concatenate([a.v, b.v])
    # The frames may be apart by the tolerance: the second frame moves as if fixed to the first.
    offset = b.placement(capture.onto).translation - a.placement(capture.at).translation
    carried = np.eye(6)
    carried[:3, 3:] = -pin.skew(offset)
    meeting = np.hstack([carried @ a.rows(capture.at), -b.rows(capture.onto)])
    k = len(a.constraints)
    inner = np.zeros((k + len(b.constraints), len(v)))
    inner[:k, :na], inner[k:, na:] = a.constraints, b.constraints
    after, multipliers = _solve(H, np.vstack([meeting, inner]), v)
    joined = _Body(capture.system, capture.instant)
    links = a.twists(after[:na]) | {prefix + n: w for n, w in b.twists(after[na:]).items()}
    impulse = carried.T @ multipliers[:6]
    turn = a.placement(capture.at).rotation
    wrench = np.concatenate([turn @ capture.impulse[:3], turn @ capture.impulse[3:]])
    momenta = a.momentum(a.v), b.momentum(b.v)
    size = float(np.abs(momenta).sum(axis=0).max())
    energy = a.energy(a.v) + b.energy(b.v)
    lost = energy - a.energy(after[:na]) - b.energy(after[na:])
    sums = momenta[0] + momenta[1]
    twists = _root_twists(capture.a)
    return {
        "velocities after [relative]": _twist_error(links, joined.twists(joined.v), v),
        "impulse [relative]": _difference(wrench, impulse, max(size, float(np.abs(impulse).max()))),
        "momentum across it [relative]": _difference(
            twists.T @ joined.momentum(joined.v), twists.T @ sums, size
        ),
        "energy lost [relative]": _difference(capture.energy_lost, lost, energy),
        "energy after [relative]": _difference(joined.energy(joined.v), energy - lost, energy),
    }


def _release(release: Release) -> dict[str, float]:
    joined = _Body(release.whole, release.before)
    bodies = [_Body(p.system, p.instant) for p in (release.carrier, release.released)]
    links = {name: twist for body in bodies for name, twist in body.twists(body.v).items()}
    energy, momentum = joined.energy(joined.v), joined.momentum(joined.v)
    size = float(np.sum([np.abs(body.momentum(body.v)) for body in bodies], axis=0).max())
    after = np.sum([body.momentum(body.v) for body in bodies], axis=0)
    twists = _root_twists(release.whole)
    return {
        "velocities after [relative]": _twist_error(links, joined.twists(joined.v), joined.v),
        "momentum across it [relative]": _difference(twists.T @ after, twists.T @ momentum, size),
        "energy after [relative]": _difference(
            sum(body.energy(body.v) for body in bodies), energy, energy
        ),
    }


def _landing(landing: Landing) -> dict[str, float]:
    body = _Body(landing.system, landing.before)
    directions = 3 if landing.contact == "point" else 6
    stopped = np.vstack([body.rows(frame)[:directions] for frame in landing.frames])
    after, multipliers = _solve(body.H, np.vstack([stopped, body.constraints]), body.v)
    landed = _Body(landing.system, landing.instant)
    twists, expected = landed.twists(landed.v), body.twists(after)
    energy, size = body.energy(body.v), float(np.abs(body.momentum(body.v)).max())
    impulse = multipliers[: len(stopped)].reshape(-1, directions)
    errors = {
        "velocities after [relative]": _twist_error(twists, expected, body.v),
        "impulse [relative]": _difference(
            stopped.T @ landing.impulse.ravel(), stopped.T @ impulse.ravel(),
            max(size, float(np.abs(landing.impulse).max())),
        ),
        "motion of the frames [relative]": _difference(
            stopped @ landed.v, np.zeros(len(stopped)), float(np.abs(stopped @ body.v).max())
        ),
        "energy lost [relative]": _difference(
            landing.energy_lost, energy - body.energy(after), energy
        ),
    }  # fmt: skip
    if landing.stance is not None:
        stance = _Body(landing.stance.system, landing.stance.instant)
        errors["velocities in stance [relative]"] = _twist_error(
            stance.twists(stance.v), expected, body.v
        )
        errors["energy in stance [relative]"] = _difference(
            stance.energy(stance.v), body.energy(after), energy
        )
    return errors


def _root_twists(system: System) -> Array:
    """Return twists of the root in the world, (6, r); momentum is conserved along them."""
    model, data = system.sorted_model, system.sorted_model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    J = pin.getJointJacobian(model, data, 1, pin.ReferenceFrame.WORLD)
    return np.reshape(J, (6, model.nv))[:, : system.r]

"""Comparison of a chain: each phase with ABA, and each impact by an independent route.

The route for impacts uses the models as Pinocchio reads them: the mass matrices of all joints by
CRBA, the Jacobians of the frames in the files, and one linear system for velocities and impulse,

    [ H  Cᵀ ] [ v⁺ ]   [ H v⁻ ]
    [ C  0  ] [ −λ ] = [  0   ],

where the rows C say that the frames move alike, or stand still, that followers follow, and that
loops stay closed.  It knows neither the joined robot nor the stance robot; their links are
compared with the result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..reduction.pointwise_reduction import symmetric
from ..simulation.contact.capture import Capture, Release
from ..simulation.contact.chain import Chain, Impact
from ..simulation.contact.landing import Landing
from ..system.derived_systems import Instant
from ..system.loops.kinematics import LoopKinematics
from ..system.system import System
from .full_system import RANK
from .verdict import Report, Verdict, table_of

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
        rows = [self.title, "full mass matrices and one linear system for each impulse"]
        return "\n".join([*rows, *table_of(self.checks), f"  verdict: {self.verdict}"])


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
        parts = [str(part) for part in (*self.phases, *self.impacts)]
        return "\n\n".join([*parts, f"verdict of the chain: {self.verdict}"])

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
        self.H = symmetric(np.array(pin.crba(model, data, self.q)))
        self.constraints = np.vstack([_follower_rows(system), _loop_rows(system, self.q)])
        pin.computeJointJacobians(model, data, self.q)
        pin.updateFramePlacements(model, data)

    def rows(self, frame: str) -> Array:
        """Return the Jacobian of a frame, (6, nv), at its origin in world axes."""
        model = self.model
        is_link = model.existFrame(frame, pin.FrameType.BODY)
        number = model.getFrameId(frame, pin.FrameType.BODY) if is_link else model.getFrameId(frame)
        kind = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(model, self.data, number, kind)
        return np.reshape(J, (6, model.nv))

    def twists(self, v: Array) -> dict[str, Array]:
        """Return the twists of all links in world axes, (6,), by name, for velocities (nv,)."""
        model, data = self.model, self.model.createData()
        pin.forwardKinematics(model, data, self.q, v)
        pin.updateFramePlacements(model, data)
        kind = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return {
            str(f.name): pin.getFrameVelocity(model, data, k, kind).vector
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
    _, sizes, rows = np.linalg.svd(J, full_matrices=False)
    return np.asarray(rows[sizes > RANK * sizes[0]])


def _solve(H: Array, C: Array, v: Array) -> tuple[Array, Array]:
    """Return velocities after an impact that makes C v vanish, and the multipliers λ.

    Redundant rows, as of planar robots, have the smallest λ.
    """
    size = np.sqrt(np.diag(H))  # scale the unknowns, so that light joints count
    rows, n = C / size, len(v)
    matrix = np.block([[H / np.outer(size, size), rows.T], [rows, np.zeros((len(C), len(C)))]])
    right = np.concatenate([(H @ v) / size, np.zeros(len(C))])
    solution = np.linalg.lstsq(matrix, right, rcond=1e-12)[0]
    return solution[:n] / size, -solution[n:]


def _difference(values: Array, references: Array, scale: float) -> float:
    """Return the largest difference relative to a scale; 0 if all are zero."""
    error = float(np.abs(np.asarray(values) - references).max(initial=0.0))
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
    apart = _origin(b, capture.onto) - _origin(a, capture.at)
    carried = np.eye(6)
    carried[:3, 3:] = -pin.skew(apart)
    meeting = np.hstack([carried @ a.rows(capture.at), -b.rows(capture.onto)])
    k = len(a.constraints)
    inner = np.zeros((k + len(b.constraints), len(v)))
    inner[:k, :na], inner[k:, na:] = a.constraints, b.constraints
    after, multipliers = _solve(H, np.vstack([meeting, inner]), v)
    joined = _Body(capture.system, capture.instant)
    links = a.twists(after[:na]) | {prefix + n: w for n, w in b.twists(after[na:]).items()}
    impulse = carried.T @ multipliers[:6]
    turn = _attitude(a, capture.at)
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
        "energy lost [relative]": _difference(
            np.array(capture.energy_lost), np.array(lost), energy
        ),
        "energy after [relative]": _difference(
            np.array(joined.energy(joined.v)), np.array(energy - lost), energy
        ),
    }


def _release(release: Release) -> dict[str, float]:
    whole = _Body(release.whole, release.before)
    parts = [_Body(p.system, p.instant) for p in (release.carrier, release.released)]
    links = {name: twist for part in parts for name, twist in part.twists(part.v).items()}
    energy, momentum = whole.energy(whole.v), whole.momentum(whole.v)
    size = float(np.sum([np.abs(part.momentum(part.v)) for part in parts], axis=0).max())
    after = np.sum([part.momentum(part.v) for part in parts], axis=0)
    twists = _root_twists(release.whole)
    return {
        "velocities after [relative]": _twist_error(links, whole.twists(whole.v), whole.v),
        "momentum across it [relative]": _difference(twists.T @ after, twists.T @ momentum, size),
        "energy after [relative]": _difference(
            np.array(sum(part.energy(part.v) for part in parts)), np.array(energy), energy
        ),
    }


def _landing(landing: Landing) -> dict[str, float]:
    body = _Body(landing.system, landing.before)
    rows = 3 if landing.contact == "point" else 6
    stopped = np.vstack([body.rows(frame)[:rows] for frame in landing.frames])
    after, multipliers = _solve(body.H, np.vstack([stopped, body.constraints]), body.v)
    landed = _Body(landing.system, landing.instant)
    found, expected = landed.twists(landed.v), body.twists(after)
    energy, size = body.energy(body.v), float(np.abs(body.momentum(body.v)).max())
    impulse = multipliers[: len(stopped)].reshape(-1, rows)
    errors = {
        "velocities after [relative]": _twist_error(found, expected, body.v),
        "impulse [relative]": _difference(
            stopped.T @ landing.impulse.ravel(), stopped.T @ impulse.ravel(),
            max(size, float(np.abs(landing.impulse).max())),
        ),
        "motion of the frames [relative]": _difference(
            stopped @ landed.v, np.zeros(len(stopped)), float(np.abs(stopped @ body.v).max())
        ),
        "energy lost [relative]": _difference(
            np.array(landing.energy_lost), np.array(energy - body.energy(after)), energy
        ),
    }  # fmt: skip
    if landing.stance is not None:
        stance = _Body(landing.stance.system, landing.stance.instant)
        errors["velocities in stance [relative]"] = _twist_error(
            stance.twists(stance.v), expected, body.v
        )
        errors["energy in stance [relative]"] = _difference(
            np.array(stance.energy(stance.v)), np.array(body.energy(after)), energy
        )
    return errors


def _frame(body: _Body, name: str) -> pin.SE3:
    model = body.model
    is_link = model.existFrame(name, pin.FrameType.BODY)
    number = model.getFrameId(name, pin.FrameType.BODY) if is_link else model.getFrameId(name)
    return body.data.oMf[number]


def _origin(body: _Body, frame: str) -> Array:
    return np.array(_frame(body, frame).translation)


def _attitude(body: _Body, frame: str) -> Array:
    return np.array(_frame(body, frame).rotation)


def _root_twists(system: System) -> Array:
    """Return twists of the root in the world, (6, r); momentum is conserved along them."""
    model, data = system.sorted_model, system.sorted_model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    J = pin.getJointJacobian(model, data, 1, pin.ReferenceFrame.WORLD)
    return np.reshape(J, (6, model.nv))[:, : system.r]

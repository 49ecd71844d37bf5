"""capture(), release() and land(): systems that are joined, parted or stopped by an impact.

At a capture, two frames that coincide are fixed to each other.  The velocities of the joined robot
are a subspace, v = J v⁺, of those of both.  The impulse of the new joint does no work on them, so
the momentum is pulled back to this subspace:

    p⁺ = Jᵀ H v⁻,   v⁺ = (Jᵀ H J)⁻¹ p⁺.

The sum of the spatial momenta is kept exactly, and the energy ½ |v⁻ − J v⁺|²_H is lost (Carnot).
With closed loops, the columns of J span the velocities that keep all loops closed.
A release is the inverse without impulse.

At a landing, frames of a robot stop dead at the ground.  A point contact stops the three velocities
of a frame's origin, a flat contact its whole twist J v.  The impulse of the ground acts on these
rows only and changes the velocities to the nearest ones, in the metric of the kinetic energy, at
which they stand still:

    v⁺ = v⁻ − H⁻¹ Jᵀ (J H⁻¹ Jᵀ)⁻¹ J v⁻.

The impulse is external: the momentum jumps by it.  The symmetry group shrinks to the motions that
keep the contact: rotations about a point, and nothing for a flat foot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, entries_of, positive
from ...common.errors import InputError
from ...common.names import brief, listed, one_of, quoted
from ...reduction.pointwise_reduction import mass_matrix_at
from ...reduction.tree.all_joints import up_of
from ...scene.scene import Scene, scene_of
from ...system.assembly import renamed, reversed_balls, take_apart
from ...system.derived_systems import (
    Instant,
    Moving,
    Pivot,
    Place,
    carry_state,
    cut,
    free_prefix,
    join,
    place_of,
    placements,
    same_motions,
    stand,
)
from ...system.joints import axes_of
from ...system.loops.kinematics import loop_jacobian
from ...system.system import System, checked_system
from ..saved_states import OverTime
from ..trajectory import Trajectory

MEETING = 1e-6  # default largest distance of the frames that a capture joins [m], [rad]


@dataclass(frozen=True, eq=False)
class _AfterImpact:
    """A system with the state at which its motion goes on.

    Attributes:
        system: The system.
        instant: Its state.
    """

    system: System
    instant: Instant

    @property
    def start(self) -> dict[str, Any]:
        """Options that start a simulation at this state: pose0, x0, xdot0 and xi0."""
        return options_of(self.instant)

    @property
    def scene(self) -> Scene:
        """A scene that starts at this state."""
        return Scene(system=self.system, **self.start)


# A motion, whose last state counts, or a value that states a system with its state.
Moment: TypeAlias = OverTime | Scene | System | _AfterImpact


@checks_arguments
@dataclass(frozen=True, eq=False)
class Capture(_AfterImpact):
    """Two systems at the moment of a capture, and the joined system after it.

    Momenta are spatial momenta in the fixed frame of the first root joint, about its origin.

    Attributes:
        system: The joined system; its root is that of the first.
        instant: Its state after the impact: pose, x, xdot and xi.
        a: The first system.
        b: The second system.
        before_a: State of the first before the impact.
        before_b: State of the second before the impact.
        at: Frame of the first.
        onto: Frame of the second.
        prefix: Text before the names of the second in the joined system.
        impulse: Impulse on the first at the origin of its frame, in the frame's axes, (6,):
            force [N·s], moment [N·m·s].
        energy_before: Kinetic energy of both before the impact [J].
        energy_lost: Energy that the impact takes [J].
        momentum_a: Momentum of the first before the impact, (r,) [N·s; N·m·s].
        momentum_b: Momentum of the second before the impact, (r,).
        momentum: Momentum of the joined system after the impact, (r,).
    """

    a: System
    b: System
    before_a: Instant
    before_b: Instant
    at: str
    onto: str
    prefix: str
    impulse: Array
    energy_before: float
    energy_lost: float
    momentum_a: Array
    momentum_b: Array
    momentum: Array

    @property
    def momentum_before(self) -> Array:
        """Sum of the momenta of both before the impact, (r,) [N·s; N·m·s]."""
        return np.asarray(self.momentum_a + self.momentum_b)

    def __repr__(self) -> str:
        return (
            f"<Capture of {self.b.name!r} by {self.a.name!r}: {self.onto} fixed to {self.at}, "
            f"{self.energy_lost:.6g} of {self.energy_before:.6g} J lost>"
        )

    def __str__(self) -> str:
        names = ", ".join(self.system.group.momentum_names)
        lines = [
            ("impulse on the first [N·s | N·m·s]", in_words(self.impulse)),
            ("energy lost [J]", f"{self.energy_lost:.6g} of {self.energy_before:.6g}"),
            (f"momenta before ({names})", in_words(self.momentum_before)),
            ("momentum after", in_words(self.momentum)),
        ]
        head = f"{self.a.name} captures {self.b.name}: {self.onto} fixed to {self.at}"
        return "\n".join([head, *(f"  {name:<42} {value}" for name, value in lines)])


@checks_arguments
def capture(
    a: Moment,
    b: Moment,
    *,
    at: str,
    onto: str,
    tolerance: float = MEETING,
    prefix: str | None = None,
    name: str = "",
) -> Capture:
    """Fix a frame of one system to a frame of another, by a plastic impact.

    Args:
        a: The first system with its state: a Trajectory or Recording, whose last state counts; a
            Scene, whose start counts; a Capture, a Landing, or a part of a Release; or a System
            with its own initial state.
        b: The second system with its state at the same time.
        at: Link or frame of the first.
        onto: Link or frame of the second, which coincides with it.
        tolerance: Largest distance [m] and largest angle [rad] between the frames.  The joined
            robot keeps the distance and the angle, so that no body jumps.
        prefix: Text before the names of the second in the joined system.  If None, "" if no names
            collide, and the name of the second otherwise.
        name: Name of the joined system; those of both by default.
    Returns:
        The joined system with its state, the impulse, and the balances.
    Raises:
        InputError: A frame is unknown, the frames do not coincide, the groups or gravity differ, a
            name would occur twice, or both are the same robot.
        UnsupportedOperationError: A force acts at a ball that changes its direction, or a loop ends
            at the frame of a joint that does.
    """
    tolerance = positive(tolerance, "tolerance")
    (A, before_a), (B, before_b) = moment_of(a, "a"), moment_of(b, "b")
    if a is b or (A is B and _same_state(before_a, before_b)):
        raise InputError(
            "capture: expected two systems, got the same one twice. Close a loop within one robot "
            "by load(loops=)"
        )
    if reason := same_motions(A, B):
        raise InputError(f"capture: {reason}")
    first, second = place_of(A, at, "at"), place_of(B, onto, "onto")
    data_a, data_b = (placements(s, i.pose, i.x) for s, i in ((A, before_a), (B, before_b)))
    meeting = data_a.oMi[first.joint] * first.on_joint
    offset = meeting.actInv(data_b.oMi[second.joint] * second.on_joint)
    _check_meeting(
        offset, tolerance, f"{quoted(at)} of '{A.name}'", f"{quoted(onto)} of '{B.name}'"
    )
    used = free_prefix(A, B) if prefix is None else prefix
    joined = join(
        A, B, at=at, onto=onto, offset=np.array(pin.SE3ToXYZQUAT(offset)), prefix=used, name=name
    )
    shape = carry_state([Moving(A, before_a), Moving(B, before_b, used)], joined).x
    # The velocities of both robots are J v⁺, the rows of the first robot first.
    J = _embedding(A, B, joined, (first, second), (before_a, before_b), offset, used)
    N = closed_velocities(joined, shape)
    H_a, H_b = mass_matrix(A, before_a), mass_matrix(B, before_b)
    v_a, v_b = (np.concatenate([i.xi, i.xdot]) for i in (before_a, before_b))
    p_a, p_b, split = H_a @ v_a, H_b @ v_b, A.n
    J_a, J_b = J[:split], J[split:]
    H = J_a.T @ H_a @ J_a + J_b.T @ H_b @ J_b
    v = N @ np.linalg.solve(N.T @ H @ N, N.T @ (J_a.T @ p_a + J_b.T @ p_b))
    lost_a, lost_b = v_a - J_a @ v, v_b - J_b @ v
    r = A.r
    jacobian_of_base = jacobian(A, first, before_a)[:, :r]
    impulse = jacobian_of_base @ np.linalg.solve(
        jacobian_of_base.T @ jacobian_of_base, -(H_a @ lost_a)[:r]
    )
    momentum_a = A.group.spatial_momentum(before_a.pose, p_a[:r])
    momentum_b = _in_root_of(A, B, B.group.spatial_momentum(before_b.pose, p_b[:r]))
    return Capture(
        joined, Instant(before_a.pose.copy(), shape, v[r:], v[:r]), A, B, before_a, before_b,
        at, onto, used, impulse,
        energy_before=float(0.5 * (v_a @ p_a + v_b @ p_b)),
        energy_lost=float(0.5 * (lost_a @ H_a @ lost_a + lost_b @ H_b @ lost_b)),
        momentum_a=momentum_a, momentum_b=momentum_b,
        momentum=A.group.spatial_momentum(before_a.pose, (H @ v)[:r]),
    )  # fmt: skip


def in_words(values: Array) -> str:
    """Return numbers as text of one line; round-off of the largest counts as zero."""
    least = 1e-12 * float(np.abs(values).max(initial=0.0))
    shown = [f"{value:.6g}" if abs(value) > least else "0" for value in values.tolist()]
    return f"({', '.join(shown)})"


def moment_of(value: Moment, what: str) -> tuple[System, Instant]:
    """Return a system with its state.

    Args:
        value: The value that states both.
        what: Name of the argument in messages.
    Returns:
        The system and its state.
    Raises:
        InputError: The value is of another type.
    """
    if isinstance(value, System):
        value = scene_of(checked_system(value, what, loops=True), {})
    if isinstance(value, _AfterImpact):
        return value.system, value.instant
    if isinstance(value, Scene):
        start, system = value.start, value.system
        state = Instant(start.pose, start.x, start.xdot, start.xi)
    elif isinstance(value, OverTime):
        system = value.system
        last = value(value.scene.end) if isinstance(value, Trajectory) else value.states
        k = (-1,) if last.t.ndim else ()
        state = Instant(last.pose[k], last.x[k], last.xdot[k], last.xi[k])
    else:
        raise InputError(
            f"{what}: expected a Trajectory, Recording, Scene, System, Capture, Landing or a part "
            f"of a Release, got {type(value).__name__}"
        )
    return system, state


def options_of(state: Instant) -> dict[str, Any]:
    """Return the options that start a simulation at a state: pose0, x0, xdot0 and xi0."""
    return {f"{name}0": value for name, value in vars(state).items()}


def _same_state(a: Instant, b: Instant) -> bool:
    return np.array_equal(a.pose, b.pose) and np.array_equal(a.x, b.x)


def _check_meeting(offset: pin.SE3, tolerance: float, a: str, b: str) -> None:
    distance = float(np.linalg.norm(offset.translation))
    angle = float(np.linalg.norm(pin.log3(offset.rotation)))
    if not max(distance, angle) <= tolerance:
        raise InputError(
            f"capture: {a} and {b} do not coincide: they are {distance:.3g} m and {angle:.3g} rad "
            f"apart, more than tolerance={tolerance:g}. End the approach where they meet, name "
            "frames that meet, or allow this offset by a larger tolerance"
        )


def mass_matrix(system: System, state: Instant) -> Array:
    """Return the mass matrix of base and shape, (n, n)."""
    model, data = system.sorted_model, system.sorted_data
    return mass_matrix_at(system, model, data, state.pose, state.x)


def closed_velocities(system: System, x: Array) -> Array:
    """Return a basis of the velocities (ξ, ẋ) that keep all loops closed at shape x, (n, k)."""
    if system.closure is None:
        return np.eye(system.n)
    gradients = loop_jacobian(system, x)[system.closure.rows]
    Q = np.linalg.qr(gradients.T, mode="complete")[0]
    basis = np.zeros((system.n, system.n - len(gradients)))
    basis[: system.r, : system.r] = np.eye(system.r)
    basis[system.r :, system.r :] = Q[:, len(gradients) :]
    return basis


def jacobian(system: System, place: Place, state: Instant) -> Array:
    """Return the Jacobian of the body twist of a frame, (6, n), by (ξ, ẋ)."""
    model, data = system.sorted_model, system.sorted_model.createData()
    q = system.sorted_q(state.pose, state.x)
    pin.computeJointJacobians(model, data, q)
    J = pin.getJointJacobian(model, data, place.joint, pin.ReferenceFrame.LOCAL)
    local = place.on_joint.toActionMatrixInverse() @ np.reshape(J, (6, model.nv))
    return system.on_shape(local)


def _embedding(
    A: System,
    B: System,
    joined: System,
    places: tuple[Place, Place],
    states: tuple[Instant, Instant],
    offset: pin.SE3,
    prefix: str,
) -> Array:
    """Return J, (n_A + n_B, n): velocities of both robots by those of the joined one."""
    r, n = A.r, joined.n
    J_a, J_b = np.zeros((A.n, n)), np.zeros((B.n, n))
    J_a[:r, :r] = np.eye(r)
    reversed_ones = reversed_balls(renamed(take_apart(B), prefix), take_apart(joined))
    slots = {joint.name: joint for joint in joined.space.joints}
    for joint in A.space.joints:
        new = slots[joint.name].v
        J_a[r:][joint.v, r:][:, new] = np.eye(joint.kind.m)
    for joint in B.space.joints:
        name = prefix + joint.name
        block = np.eye(joint.kind.m)
        if name in reversed_ones:  # σ = −R(x)ᵀ σ' for the rate σ' of the reversed ball
            block = -pin.Quaternion(states[1].x[joint.x]).matrix().T
        J_b[r:][joint.v, r:][:, slots[name].v] = block
    # The frames move alike: rows_b (ξ_b, ẋ_b) = offset⁻¹ rows_a (ξ_a, ẋ_a).
    rows_a, rows_b = (jacobian(s, p, i) for s, p, i in zip((A, B), places, states, strict=True))
    common = offset.toActionMatrixInverse() @ rows_a @ J_a - rows_b[:, r:] @ J_b[r:]
    base = rows_b[:, :r]
    J_b[:r] = np.linalg.solve(base.T @ base, base.T @ common)
    return np.vstack([J_a, J_b])


def _in_root_of(A: System, B: System, momentum: Array) -> Array:
    """Return a momentum of B, (r,) in the fixed frame of its root, in that of the root of A."""
    axes_a, axes_b = (axes_of(s.sorted_model.joints[1]) for s in (A, B))
    between = B.sorted_model.jointPlacements[1].actInv(A.sorted_model.jointPlacements[1])
    # The twists of the group are the same, so the momentum is a covector on them.
    return np.asarray((axes_b.T @ between.toActionMatrix() @ axes_a).T @ momentum)


@checks_arguments
@dataclass(frozen=True, eq=False)
class Released(_AfterImpact):
    """One of the two systems after a release.

    Attributes:
        system: The system.
        instant: Its state: pose, x, xdot and xi.
    """


@checks_arguments
@dataclass(frozen=True, eq=False)
class Release:
    """The two systems into which a release divides a robot.

    Attributes:
        whole: The robot before the release.
        before: Its state.
        link: Link behind the joint that opens.
        carrier: The part with the root, and its state.
        released: The other part, and its state.
    """

    whole: System
    before: Instant
    link: str
    carrier: Released
    released: Released

    def __str__(self) -> str:
        lines = [f"{self.whole.name} opens at {self.link}"]
        for body in (self.carrier, self.released):
            system = body.system
            lines.append(
                f"  {system.name:<42} {system.mass:.6g} kg, {system.group.name} x "
                f"{system.m} joints, xi = {in_words(body.instant.xi)}"
            )
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<Release of {self.released.system.name!r} from {self.whole.name!r} at {self.link!r}>"
        )


@checks_arguments
def release(state: Moment, link: str, *, root: str = "") -> Release:
    """Divide a robot at a joint, without an impulse: both parts move on as they did.

    Args:
        state: The robot with its state (see `capture`).
        link: Link behind the joint that opens, or the joint itself.  The joint may be fixed, as
            between links of a file or after a capture, or move.
        root: Link of the released part whose motion its pose describes; `link` by default.
    Returns:
        Both systems with their states.
    Raises:
        InputError: The link is unknown or the root; couplings, springs or loops connect both parts;
            or the part cannot float on its own.
    """
    system, before = moment_of(state, "release")
    systems = [cut(system, link=link, part=part, root=root if part else "") for part in (0, 1)]
    carrier, released = (
        Released(cut_off, carry_state([Moving(system, before)], cut_off)) for cut_off in systems
    )
    return Release(system, before, link, carrier, released)


Contact: TypeAlias = Literal["point", "flat"]
CONTACTS: tuple[Contact, ...] = ("point", "flat")
_RANK = 1e-10  # smallest singular value of the contact rows, relative to the largest
_ALONG = 1e-9  # largest part of gravity across an axis that counts as round-off


@checks_arguments
@dataclass(frozen=True, eq=False)
class Stance(_AfterImpact):
    """A robot that turns about the point on which it has landed.

    Attributes:
        system: The same tree with its root at the foot.
        instant: Its state after the impact: pose, x, xdot and xi.
    """


@checks_arguments
@dataclass(frozen=True, eq=False)
class Landing(_AfterImpact):
    """A robot at the moment of its landing, and its velocities after the impact.

    Attributes:
        system: The robot that floats.
        instant: Its state after the impact: pose, x, xdot and xi.
        before: Its state before the impact.
        frames: Frames that stop.
        contact: "point" or "flat".
        impulse: Impulse of the ground at the origin of each frame, in world axes: (k, 3) force
            [N·s] of a point contact, (k, 6) with moment [N·m·s] of a flat one.
        energy_before: Kinetic energy before the impact [J].
        energy_lost: Energy that the impact takes [J].
        momentum_before: Spatial momentum before the impact, (r,) [N·s; N·m·s].
        momentum_jump: Change of the spatial momentum, (r,).
        stance: The robot on its foot; None if pinred does not support its motion.
        why_no_stance: Why there is no stance robot, and a way out; "" if there is one.
    """

    before: Instant
    frames: tuple[str, ...]
    contact: Literal["point", "flat"]
    impulse: Array
    energy_before: float
    energy_lost: float
    momentum_before: Array
    momentum_jump: Array
    stance: Stance | None
    why_no_stance: str

    @property
    def pulled(self) -> tuple[str, ...]:
        """Frames on which the impulse pulls towards the ground, which no free ground can do."""
        up = up_of(self.system)
        return tuple(
            frame
            for frame, wrench in zip(self.frames, self.impulse, strict=True)
            if wrench[:3] @ up < 0.0
        )

    def __repr__(self) -> str:
        frames = listed(list(self.frames), 4)
        return (
            f"<Landing of {self.system.name!r} on {frames} ({self.contact}): "
            f"{self.energy_lost:.6g} of {self.energy_before:.6g} J lost>"
        )

    def __str__(self) -> str:
        rows = [
            (f"impulse on {frame} [N·s{' | N·m·s' * (len(row) > 3)}]", in_words(row))
            for frame, row in zip(self.frames, self.impulse, strict=True)
        ]  # fmt: skip
        names = ", ".join(self.system.group.momentum_names)
        rows += [
            ("energy lost [J]", f"{self.energy_lost:.6g} of {self.energy_before:.6g}"),
            (f"jump of the momentum ({names})", in_words(self.momentum_jump)),
        ]
        rows.append(("stance", repr(self.stance.system) if self.stance else self.why_no_stance))
        lines = [f"  {name:<42} {value}" for name, value in rows]
        lines += [
            f"  the ground would pull at {frame}: it lifts off instead" for frame in self.pulled
        ]
        head = f"{self.system.name} lands on {listed(list(self.frames), 6)} ({self.contact})"
        return "\n".join([head, *lines])


@checks_arguments
def land(
    state: Moment,
    frame: str | Sequence[str],
    *,
    contact: Literal["point", "flat"] = "point",
    name: str = "",
) -> Landing:
    """Stop one or several frames of a robot dead, by the impulse of the ground.

    Args:
        state: The robot with its state: a Trajectory or Recording, whose last state counts; a
            Scene, whose start counts; a Capture, a Landing, or a part of a Release.  An event with
            the formula height['foot'] ends a flight where a foot meets the ground.
        frame: Link or frame that stops, or several that stop at once.
        contact: "point": the origin of the frame stops.  "flat": the frame stops turning, too.
        name: Name of the stance robot; that of the robot with its foot by default.
    Returns:
        Velocities, impulse, energy and momentum, and the stance robot where its group is supported:
        one point contact.  Without gravity the robot turns freely about it (SO3); under gravity
        about the vertical (SO2), with two tilt angles as further joints; a planar one about its
        normal (SO2), if gravity does not turn it.
    Raises:
        InputError: A frame is unknown or stated twice, or the contact is not valid.
    """
    if not one_of(contact, CONTACTS):
        raise InputError(f"contact: expected {' or '.join(CONTACTS)}, got {brief(contact)}")
    system, before = moment_of(state, "land")
    frames = tuple((frame,) if isinstance(frame, str) else entries_of(frame) or ())
    if not frames or len(set(frames)) < len(frames):
        raise InputError(f"frame: expected one or several frames, each once, got {brief(frame)}")
    places = [place_of(system, entry, "frame") for entry in frames]
    count, data = 3 if contact == "point" else 6, placements(system, before.pose, before.x)
    J = list[Array]()  # twists of the frames in world axes
    for place in places:
        R = data.oMi[place.joint].rotation @ place.on_joint.rotation
        J.append(np.kron(np.eye(count // 3), R) @ jacobian(system, place, before)[:count])
    H, v = mass_matrix(system, before), np.concatenate([before.xi, before.xdot])
    N = closed_velocities(system, before.x)
    # In w = Lᵀ u with v = N u and NᵀHN = L Lᵀ, the impact is the orthogonal projection off the
    # columns of L⁻¹ (J N)ᵀ.
    L = np.linalg.cholesky(N.T @ H @ N)
    U, s, Vt = np.linalg.svd(np.linalg.solve(L, (np.vstack(J) @ N).T), full_matrices=False)
    rank = int((s > _RANK * s[0]).sum())
    stopped = U[:, :rank].T @ (L.T @ (N.T @ v))
    jump = -N @ np.linalg.solve(L.T, U[:, :rank] @ stopped)
    impulse = -(Vt[:rank].T @ (stopped / s[:rank])).reshape(len(frames), count)
    r = system.r
    momentum, change = (system.group.spatial_momentum(before.pose, (H @ u)[:r]) for u in (v, jump))
    after = Instant(before.pose, before.x, before.xdot + jump[r:], before.xi + jump[:r])
    stance, why = _stance(system, after, frames, places, contact, name)
    return Landing(
        system, after, before, frames, contact, impulse, float(0.5 * v @ H @ v),
        float(0.5 * stopped @ stopped), momentum, change, stance, why,
    )  # fmt: skip


def _stance(
    system: System,
    after: Instant,
    frames: Sequence[str],
    places: Sequence[Place],
    contact: Contact,
    name: str,
) -> tuple[Stance | None, str]:
    """Return the stance robot with its state, or None and the reason."""
    if contact == "flat":
        return None, (
            "no motion keeps a flat foot, so the group is trivial, which pinred does not support. "
            "Simulate the robot as a fixed one with Pinocchio, or land with contact='point'"
        )
    if len(frames) > 1:
        return None, (
            "several contact points close loops through the ground, and no motion keeps them all. "
            "Land on one point, or simulate with Pinocchio's constraints"
        )
    pivot, up = _pivot(system)
    if pivot is None:
        return None, (
            f"a point contact leaves no symmetry to a robot in {system.group.name} with gravity "
            f"{system.gravity.tolist()} m/s²"
        )
    place, data = places[0], placements(system, after.pose, after.x)
    at = pin.SE3ToXYZQUAT(data.oMi[place.joint] * place.on_joint)
    standing = stand(
        system, frame=frames[0], at=at.tolist(), pivot=pivot, up=up.tolist(), name=name
    )
    state = carry_state([Moving(system, after)], standing)
    return Stance(standing, state), ""


def _pivot(system: System) -> tuple[Pivot | None, Array]:
    """Return how a robot turns about a contact point, and the axis of its group in the world."""
    group, gravity, model = system.group, system.gravity, system.sorted_model
    if group.name == "SE3":
        return ("vertical" if gravity.any() else "all"), up_of(system)
    normal = np.zeros(3)
    if group.plane:
        root = model.jointPlacements[1].rotation
        normal = root @ axes_of(model.joints[1])[3:, group.linear]
    across = gravity - normal * (normal @ gravity)
    still = normal.any() and np.abs(across).max() <= _ALONG * np.abs(gravity).max(initial=0.0)
    return ("normal" if still else None), normal

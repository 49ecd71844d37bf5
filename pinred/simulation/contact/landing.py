"""land(): frames of a robot in flight stop dead at the ground.

A point contact stops the three velocities of a frame's origin, a flat contact its whole twist J v.
The impulse of the ground acts on these rows only and changes the velocities to the nearest ones, in
the metric of the kinetic energy, at which they stand still:

    v⁺ = v⁻ − H⁻¹ Jᵀ (J H⁻¹ Jᵀ)⁻¹ J v⁻.

The impulse is external: the momentum jumps by it.  The symmetry group shrinks to the motions that
keep the contact: rotations about a point, and nothing for a flat foot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, entries_of
from ...common.errors import InputError
from ...common.names import brief, listed, one_of
from ...reduction.tree.all_joints import up_of
from ...system.derived_systems import (
    Instant,
    Moving,
    Pivot,
    Place,
    carry_state,
    place_of,
    placements,
    stand,
)
from ...system.joints import axes_of
from ...system.system import System
from .capture import (
    Moment,
    _AfterImpact,
    closed_velocities,
    in_words,
    jacobian,
    mass_matrix,
    moment_of,
)

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
            for frame, row in zip(self.frames, self.impulse, strict=True)
            if row[:3] @ up < 0.0
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
    rows, data = 3 if contact == "point" else 6, placements(system, before.pose, before.x)
    J = list[Array]()  # twists of the frames in world axes
    for place in places:
        R = data.oMi[place.joint].rotation @ place.on_joint.rotation
        J.append(np.kron(np.eye(rows // 3), R) @ jacobian(system, place, before)[:rows])
    H, v = mass_matrix(system, before), np.concatenate([before.xi, before.xdot])
    N = closed_velocities(system, before.x)
    # In w = Lᵀ u with v = N u and NᵀHN = L Lᵀ, the impact is the orthogonal projection off the
    # columns of L⁻¹ (J N)ᵀ.
    L = np.linalg.cholesky(N.T @ H @ N)
    U, s, Vt = np.linalg.svd(np.linalg.solve(L, (np.vstack(J) @ N).T), full_matrices=False)
    rank = int((s > _RANK * s[0]).sum())
    stopped = U[:, :rank].T @ (L.T @ (N.T @ v))
    jump = -N @ np.linalg.solve(L.T, U[:, :rank] @ stopped)
    impulse = -(Vt[:rank].T @ (stopped / s[:rank])).reshape(len(frames), rows)
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

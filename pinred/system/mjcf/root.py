"""The joints of the body that carries all others, read as one motion of a symmetry group.

MuJoCo has no planar joint, and moves a body in a plane by three joints in it; these become
SE(2), with a slide across the plane ℝ × SE(2), and three slides with a ball, or with three
hinges, SE(3).  All else is
the first joint alone, with the others as shape behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...lie.group import Group
from ...lie.r_se2 import RxSE2
from ...lie.se2 import SE2
from ..joints import root_joint
from . import rotors
from .joints import Joint, frame

_EXACT = 1e-12  # sines and cosines, below which they are round-off
_SOMEWHERE = (0.7, -0.4, 1.1, 0.2)  # rad | m, from where the file has the joints


@dataclass(frozen=True, eq=False)
class RootMotion:
    """The motion of the carrying body in the world.

    joints: those that make the motion.  model: Pinocchio's joint.  before: its frame, on the
    body's as the file has it drawn.  behind: the body's frame, on the joint's moving one.
    fixed: whether `before` counts from the world instead.  weight: what the joints' rotors add
    to the inertia, on the moving frame; armature: (nv,) what Pinocchio is to add itself.
    pose: from qpos to the pose of the group.  twist: from qpos and qvel to the body twist.
    """

    joints: tuple[Joint, ...]
    model: pin.JointModel
    before: pin.SE3
    behind: pin.SE3
    weight: pin.Inertia
    armature: Array
    pose: Callable[[Array], Array]
    twist: Callable[[Array, Array], Array]
    fixed: bool = False

    @property
    def name(self) -> str:
        """The joints' names."""
        return "+".join(joint.name for joint in self.joints)


def root_motion(joints: Sequence[Joint], gravity: Array, turn: Array) -> RootMotion:
    """Return the motion that the joints of the carrying body make, or the first ones of them.

    gravity: (3,) in the world [m/s²].  turn: (3, 3) from the body's axes, where the file has
    it drawn, to the world's.
    Raises ModelError for rotors of which no symmetry of the base is left.
    """
    kinds, first = [joint.kind for joint in joints], joints[0]
    felt = turn.T @ gravity
    if kinds == ["slide"] * 3 + ["ball"] and _rank([j.axis for j in joints[:3]]) == 3:
        return _floating(joints, felt)
    if (plane := _plane(joints)) is not None:
        return _planar(joints, plane, felt)
    if _is_spatial(joints):
        return _spatial(joints, felt)
    if first.kind == "free":
        return _free(first, gravity)
    return _ball(first) if first.kind == "ball" else _single(first, felt)


def _single(joint: Joint, gravity: Array) -> RootMotion:
    """Return the motion of a slide or a hinge, whose coordinate is MuJoCo's."""
    slides = joint.kind == "slide"
    return RootMotion(
        joints=(joint,), model=joint.model(),
        before=joint.at_point * joint.turned(-joint.q0), behind=joint.at_point.inverse(),
        weight=rotors.of_slides([joint], gravity) if slides else pin.Inertia.Zero(),
        armature=np.zeros(1) if slides else joint.armature,
        pose=lambda qpos: qpos[joint.q_at : joint.q_at + 1].copy(),
        twist=lambda _, qvel: qvel[joint.v_at : joint.v_at + 1].copy(),
    )  # fmt: skip


def _ball(joint: Joint) -> RootMotion:
    """Return turning about a point; MuJoCo's angular velocity is in the body's axes, too."""
    return RootMotion(
        joints=(joint,), model=pin.JointModelSpherical(), before=joint.at_point,
        behind=joint.at_point.inverse(), weight=rotors.of_ball(joint), armature=np.zeros(3),
        pose=lambda qpos: _quaternion(qpos[joint.q_at :]),
        twist=lambda _, qvel: qvel[joint.v_at : joint.v_at + 3].copy(),
    )  # fmt: skip


def _free(joint: Joint, gravity: Array) -> RootMotion:
    """Return free motion, whose pose is that in the world; it moves along the world's axes."""
    q, v = joint.q_at, joint.v_at

    def pose(qpos: Array) -> Array:
        return np.concatenate([qpos[q : q + 3], _quaternion(qpos[q + 3 :])])

    def twist(qpos: Array, qvel: Array) -> Array:
        turn = frame(np.zeros(3), _wxyz(qpos[q + 3 :])).rotation
        return np.concatenate([turn.T @ qvel[v : v + 3], qvel[v + 3 : v + 6]])

    return RootMotion(
        joints=(joint,), model=pin.JointModelFreeFlyer(), before=pin.SE3.Identity(),
        behind=pin.SE3.Identity(), weight=rotors.of_free(joint, gravity), armature=np.zeros(6),
        pose=pose, twist=twist, fixed=True,
    )  # fmt: skip


def _floating(joints: Sequence[Joint], gravity: Array) -> RootMotion:
    """Return the motion of three slides, then a ball."""
    *slides, ball = joints
    axes = np.array([joint.axis for joint in slides]).T

    def pose(qpos: Array) -> Array:
        moved = axes @ np.array([qpos[joint.q_at] - joint.q0 for joint in slides])
        return np.concatenate([moved, _quaternion(qpos[ball.q_at :])])

    def twist(qpos: Array, qvel: Array) -> Array:
        v = axes @ np.array([qvel[joint.v_at] for joint in slides])
        turn = frame(np.zeros(3), _wxyz(qpos[ball.q_at :])).rotation
        return np.concatenate([turn.T @ v, qvel[ball.v_at : ball.v_at + 3]])

    return RootMotion(
        joints=tuple(joints), model=pin.JointModelFreeFlyer(), before=ball.at_point,
        behind=ball.at_point.inverse(),
        weight=rotors.of_slides(slides, gravity) + rotors.of_ball(ball), armature=np.zeros(6),
        pose=pose, twist=twist,
    )  # fmt: skip


def _is_spatial(joints: Sequence[Joint]) -> bool:
    """Return whether three slides and three hinges move a body freely from where it is drawn.

    Rotors on them would break the symmetry, but for slides ahead of hinges that turn about one
    point.
    """
    kinds = [joint.kind for joint in joints]
    if sorted(kinds) != ["hinge"] * 3 + ["slide"] * 3:
        return False
    heavy = {joint.kind for joint in joints if joint.armature.any()}
    points = [joint.point for joint in joints if joint.kind == "hinge"]
    apart = float(np.ptp(points, axis=0).max()) > _EXACT
    if "hinge" in heavy or (heavy and (apart or kinds[:3] != ["slide"] * 3)):
        return False
    at = [joint.q0 for joint in joints]
    return _rank([_twist(joints, at, rates).vector for rates in np.eye(6).tolist()]) == 6


def _spatial(joints: Sequence[Joint], gravity: Array) -> RootMotion:
    """Return the motion of three slides and three hinges, in any order.

    The joint's frame is the body's, moved to the first hinge.  With W that frame on the body's,
    the pose of the group is W⁻¹ P W of MuJoCo's motion P.
    """
    W = next(joint.at_point for joint in joints if joint.kind == "hinge")
    inverse = W.inverse()

    def pose(qpos: Array) -> Array:
        moved = pin.SE3.Identity()
        for joint in joints:
            moved = moved * joint.motion(qpos[joint.q_at])
        return np.asarray(pin.SE3ToXYZQUAT(inverse * moved * W))

    def twist(qpos: Array, qvel: Array) -> Array:
        at = [qpos[joint.q_at] for joint in joints]
        rates = [qvel[joint.v_at] for joint in joints]
        return np.asarray(inverse.act(_twist(joints, at, rates)).vector)

    return RootMotion(
        joints=tuple(joints), model=pin.JointModelFreeFlyer(), before=W, behind=inverse,
        weight=rotors.of_slides([j for j in joints if j.kind == "slide"], gravity),
        armature=np.zeros(6), pose=pose, twist=twist,
    )  # fmt: skip


def _planar(joints: Sequence[Joint], plane: _Plane, gravity: Array) -> RootMotion:
    """Return the motion of slides and hinges in a plane, and of one across it, in any order.

    The joint's frame has z along the hinges' normal and x along the first slide in the plane
    (with none, anywhere), its origin on the first hinge.  With W that frame on the body's, the
    pose of the group is W⁻¹ P W of MuJoCo's motion P.
    """
    W = pin.SE3(_axes(plane.hinges[0].axis, plane.slides), plane.hinges[0].point)
    inverse, axes = W.inverse(), list(plane.group.axes)

    def pose(qpos: Array) -> Array:
        moved = pin.SE3.Identity()
        for joint in joints:
            moved = moved * joint.motion(qpos[joint.q_at])
        turned = [
            (qpos[hinge.q_at] - hinge.q0) * np.sign(hinge.axis @ W.rotation[:, 2])
            for hinge in plane.hinges
        ]
        return np.append((inverse * moved * W).translation[axes[:-1]], sum(turned))

    def twist(qpos: Array, qvel: Array) -> Array:
        at = [qpos[joint.q_at] for joint in joints]
        rates = [qvel[joint.v_at] for joint in joints]
        return np.asarray(inverse.act(_twist(joints, at, rates)).vector[axes])

    return RootMotion(
        joints=tuple(joints), model=root_joint(plane.group), before=W, behind=inverse,
        weight=rotors.of_plane(joints, gravity), armature=np.zeros(len(axes)),
        pose=pose, twist=twist,
    )  # fmt: skip


@dataclass(frozen=True)
class _Plane:
    """Joints that move a body in a plane, and perhaps across it.

    group: SE(2) or ℝ × SE(2).  hinges: across the plane.  slides: in it.
    """

    group: Group
    hinges: tuple[Joint, ...]
    slides: tuple[Joint, ...]


def _plane(joints: Sequence[Joint]) -> _Plane | None:
    """Return the plane in which joints move a body, or None if they do not in all of it."""
    hinges = tuple(joint for joint in joints if joint.kind == "hinge")
    if len(joints) not in (3, 4) or {j.kind for j in joints} - {"slide", "hinge"} or not hinges:
        return None
    z = hinges[0].axis
    across = [joint for joint in joints if np.abs(np.cross(joint.axis, z)).max() <= _EXACT]
    along = [joint for joint in joints if abs(joint.axis @ z) <= _EXACT]
    climbs = [joint for joint in across if joint.kind == "slide"]
    in_plane = tuple(joint for joint in along if joint.kind == "slide")
    if len(climbs) != len(joints) - 3 or len(across) + len(in_plane) != len(joints):
        return None
    # Three hinges may lie in a row where the file has them, and still move in all directions.
    at = [joint.q0 + by for joint, by in zip(joints, _SOMEWHERE, strict=False)]
    twists = [_twist(joints, at, rates).vector for rates in np.eye(len(joints)).tolist()]
    if _rank(twists) != len(joints):
        return None
    return _Plane(RxSE2 if climbs else SE2, hinges, in_plane)


def _axes(z: Array, slides: Sequence[Joint]) -> Array:
    """Return the rotation to axes with a given z, and x along the first slide if there is one."""
    x = slides[0].axis if slides else np.eye(3)[np.argmin(np.abs(z))]
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    return np.array([np.cross(y, z), y, z]).T


def _twist(joints: Sequence[Joint], at: Sequence[float], rates: Sequence[float]) -> pin.Motion:
    """Return the body twist that joints at coordinates and with rates make together."""
    twist = pin.Motion.Zero()
    for joint, value, rate in zip(joints, at, rates, strict=True):
        twist = joint.motion(value).actInv(twist) + joint.twist(rate)
    return twist


def _rank(vectors: Sequence[Array]) -> int:
    return int(np.linalg.matrix_rank(np.array(vectors), tol=1e-9))


def _wxyz(values: Array) -> Array:
    """Return MuJoCo's quaternion at the front of coordinates; of length zero, it turns nothing."""
    quaternion = values[:4]
    return quaternion if quaternion.any() else np.array([1.0, 0.0, 0.0, 0.0])


def _quaternion(values: Array) -> Array:
    """Return the unit quaternion with the real part last, of MuJoCo's, which begins with it."""
    quaternion = _wxyz(values)
    return np.asarray(np.roll(quaternion, -1) / np.linalg.norm(quaternion))

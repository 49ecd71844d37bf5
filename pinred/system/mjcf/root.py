"""Conversion of the root body's joints to a single joint of a symmetry group.

MuJoCo has no planar joint: a file moves a body in a plane with three joints, which become SE(2).
With an additional slide normal to the plane they become ℝ × SE(2).  Three slides with a ball, or
with three hinges, become SE(3).  In all other cases the first joint alone is the root.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...lie.group import Group
from ...lie.planar_groups import SE2
from ...lie.r_se2 import RxSE2
from ..joints import root_joint
from . import rotors
from .mujoco_joints import Joint, frame, quaternion, wxyz

_EXACT = 1e-12  # sines, cosines and lengths [m] below this value count as zero
# Displacements from the reference configuration at which planar joints are tested [rad | m].
_GENERIC = (0.7, -0.4, 1.1, 0.2)


@dataclass(frozen=True, eq=False)
class RootMotion:
    """The motion of the body that carries all others, relative to the world.

    Attributes:
        joints: MuJoCo joints that produce the motion.
        model: Pinocchio joint with the same motion.
        before: Fixed frame of the joint, relative to the body in the reference configuration.
        behind: Frame of the body, relative to the moving frame of the joint.
        rotors: Inertia of the joints' rotors, in the moving frame.
        pose: Function from qpos to the pose in the group.
        twist: Function from qpos and qvel to the body twist.
        armature: Armature of the Pinocchio joint, (nv,) [kg m² | kg]; None for zero.
        in_world: Whether `before` is relative to the world instead of the body.
    """

    joints: tuple[Joint, ...]
    model: pin.JointModel
    before: pin.SE3
    behind: pin.SE3
    rotors: pin.Inertia
    pose: Callable[[Array], Array]
    twist: Callable[[Array, Array], Array]
    armature: Array | None = None
    in_world: bool = False

    @property
    def name(self) -> str:
        """Names of the joints."""
        return "+".join(joint.name for joint in self.joints)


def root_motion(joints: Sequence[Joint], gravity: Array, turn: Array) -> RootMotion:
    """Return the group motion that the first joints of the root body produce together.

    Args:
        joints: Joints of the body.
        gravity: Gravity in the world frame, (3,) [m/s²].
        turn: Rotation, (3, 3), from body axes in the reference configuration to world axes.
    Returns:
        The motion.
    Raises:
        ModelError: Armature breaks the symmetry of the base.
    """
    kinds, first = [joint.kind for joint in joints], joints[0]
    in_body = turn.T @ gravity
    if kinds == ["slide"] * 3 + ["ball"] and _rank([j.axis for j in joints[:3]]) == 3:
        return _slides_and_ball(joints, in_body)
    if (plane := _plane(joints)) is not None:
        return _planar(joints, plane, in_body)
    if _is_spatial(joints):
        return _spatial(joints, in_body)
    if first.kind == "free":
        return _free(first)
    return _ball(first) if first.kind == "ball" else _single(first, in_body)


def _single(joint: Joint, gravity: Array) -> RootMotion:
    """Return the motion of a slide or a hinge; its coordinate is unchanged."""
    slides = joint.kind == "slide"
    return RootMotion(
        joints=(joint,),
        model=joint.model(),
        before=joint.at_point * joint.displaced(-joint.q0),
        behind=joint.at_point.inverse(),
        rotors=rotors.of_slides([joint], gravity) if slides else pin.Inertia.Zero(),
        armature=None if slides else joint.armature,
        pose=lambda qpos: qpos[joint.q_at : joint.q_at + 1].copy(),
        twist=lambda _, qvel: qvel[joint.v_at : joint.v_at + 1].copy(),
    )


def _ball(joint: Joint) -> RootMotion:
    """Return the motion of a ball joint.  MuJoCo's angular velocity is in body axes too."""
    return RootMotion(
        joints=(joint,),
        model=pin.JointModelSpherical(),
        before=joint.at_point,
        behind=joint.at_point.inverse(),
        rotors=rotors.of_ball(joint),
        pose=lambda qpos: quaternion(qpos[joint.q_at :]),
        twist=lambda _, qvel: qvel[joint.v_at : joint.v_at + 3].copy(),
    )


def _free(joint: Joint) -> RootMotion:
    """Return the motion of a free joint.  MuJoCo's pose and linear velocity are in world axes."""
    q, v = joint.q_at, joint.v_at

    def twist(qpos: Array, qvel: Array) -> Array:
        turn = _rotation(qpos[q + 3 :])
        return np.concatenate([turn.T @ qvel[v : v + 3], qvel[v + 3 : v + 6]])

    return RootMotion(
        joints=(joint,),
        model=pin.JointModelFreeFlyer(),
        before=pin.SE3.Identity(),
        behind=pin.SE3.Identity(),
        rotors=pin.Inertia.Zero(),
        pose=lambda qpos: np.concatenate([qpos[q : q + 3], quaternion(qpos[q + 3 :])]),
        twist=twist,
        in_world=True,
    )


def _slides_and_ball(joints: Sequence[Joint], gravity: Array) -> RootMotion:
    """Return the motion of three slides followed by a ball."""
    *slides, ball = joints
    axes = np.array([joint.axis for joint in slides]).T

    def pose(qpos: Array) -> Array:
        shift = axes @ np.array([qpos[joint.q_at] - joint.q0 for joint in slides])
        return np.concatenate([shift, quaternion(qpos[ball.q_at :])])

    def twist(qpos: Array, qvel: Array) -> Array:
        v = axes @ np.array([qvel[joint.v_at] for joint in slides])
        turn = _rotation(qpos[ball.q_at :])
        return np.concatenate([turn.T @ v, qvel[ball.v_at : ball.v_at + 3]])

    return RootMotion(
        joints=tuple(joints),
        model=pin.JointModelFreeFlyer(),
        before=ball.at_point,
        behind=ball.at_point.inverse(),
        rotors=rotors.of_slides(slides, gravity) + rotors.of_ball(ball),
        pose=pose,
        twist=twist,
    )


def _is_spatial(joints: Sequence[Joint]) -> bool:
    """Return whether three slides and three hinges can move a body in all directions.

    The test is in the reference configuration.  Armature of these joints breaks the symmetry,
    except on slides before hinges whose axes meet in one point.
    """
    kinds = [joint.kind for joint in joints]
    if sorted(kinds) != ["hinge"] * 3 + ["slide"] * 3:
        return False
    heavy = {joint.kind for joint in joints if joint.armature.any()}
    points = [joint.point for joint in joints if joint.kind == "hinge"]
    distinct = float(np.ptp(points, axis=0).max()) > _EXACT
    if "hinge" in heavy or (heavy and (distinct or kinds[:3] != ["slide"] * 3)):
        return False
    return _moves_freely(joints, [joint.q0 for joint in joints])


def _spatial(joints: Sequence[Joint], gravity: Array) -> RootMotion:
    """Return the six-dimensional motion of three slides and three hinges, in any order."""
    first_hinge = next(joint for joint in joints if joint.kind == "hinge")
    slides = [joint for joint in joints if joint.kind == "slide"]
    weight = rotors.of_slides(slides, gravity)

    def pose(at: pin.SE3, _: Array) -> Array:
        return np.asarray(pin.SE3ToXYZQUAT(at))

    model, axes = pin.JointModelFreeFlyer(), list(range(6))
    return _combined(joints, first_hinge.at_point, model, axes, weight, pose)


def _planar(joints: Sequence[Joint], plane: _Plane, gravity: Array) -> RootMotion:
    """Return the motion of planar slides and hinges, and perhaps a slide normal to the plane.

    The joints may be in any order.

    The joint's frame has z along the hinge axes and x along the first slide in the plane, if there
    is such a slide.  Its origin is on the first hinge.
    """
    W = pin.SE3(_axes(plane.hinges[0].axis, plane.slides), plane.hinges[0].point)
    axes = list(plane.group.axes)

    def pose(at: pin.SE3, qpos: Array) -> Array:
        angles = [
            (qpos[hinge.q_at] - hinge.q0) * np.sign(hinge.axis @ W.rotation[:, 2])
            for hinge in plane.hinges
        ]
        return np.append(at.translation[axes[:-1]], sum(angles))

    model = root_joint(plane.group)
    return _combined(joints, W, model, axes, rotors.of_plane(joints, gravity), pose)


def _combined(
    joints: Sequence[Joint],
    W: pin.SE3,
    model: pin.JointModel,
    axes: list[int],
    weight: pin.Inertia,
    pose_of: Callable[[pin.SE3, Array], Array],
) -> RootMotion:
    """Combine several slides and hinges of one body into a single Pinocchio joint.

    Args:
        joints: Joints of the body.
        W: Frame of the Pinocchio joint, relative to the body.  If MuJoCo displaces the body by P,
            the pose of the joint is W⁻¹ P W.
        model: Pinocchio joint with the combined motion.
        axes: Indices of the twist components that the joint can produce.
        weight: Inertia of the rotors, in the joint's frame.
        pose_of: Function from W⁻¹ P W and qpos to the coordinates of the pose in the group.
    Returns:
        The combined motion.
    """
    inverse = W.inverse()

    def pose(qpos: Array) -> Array:
        motion = pin.SE3.Identity()
        for joint in joints:
            motion = motion * joint.motion(qpos[joint.q_at])
        return pose_of(inverse * motion * W, qpos)

    def twist(qpos: Array, qvel: Array) -> Array:
        values = [qpos[joint.q_at] for joint in joints]
        rates = [qvel[joint.v_at] for joint in joints]
        return np.asarray(inverse.act(_twist(joints, values, rates)).vector[axes])

    return RootMotion(tuple(joints), model, W, inverse, weight, pose, twist)


@dataclass(frozen=True)
class _Plane:
    """Joints that move a body in a plane, and perhaps along its normal.

    Attributes:
        group: SE(2), or ℝ × SE(2).
        hinges: Hinges normal to the plane.
        slides: Slides in the plane.
    """

    group: Group
    hinges: tuple[Joint, ...]
    slides: tuple[Joint, ...]


def _plane(joints: Sequence[Joint]) -> _Plane | None:
    """Return the planar motion that the joints produce, or None if it is not planar."""
    hinges = tuple(joint for joint in joints if joint.kind == "hinge")
    if len(joints) not in (3, 4) or {j.kind for j in joints} - {"slide", "hinge"} or not hinges:
        return None
    z = hinges[0].axis
    normal = [joint for joint in joints if np.abs(np.cross(joint.axis, z)).max() <= _EXACT]
    lifts = [joint for joint in normal if joint.kind == "slide"]
    slides = tuple(j for j in joints if j.kind == "slide" and abs(j.axis @ z) <= _EXACT)
    if len(lifts) != len(joints) - 3 or len(normal) + len(slides) != len(joints):
        return None
    # Three collinear hinges are singular in the reference configuration only, so test another one.
    values = [joint.q0 + by for joint, by in zip(joints, _GENERIC, strict=False)]
    if not _moves_freely(joints, values):
        return None
    return _Plane(RxSE2 if lifts else SE2, hinges, slides)


def _axes(z: Array, slides: Sequence[Joint]) -> Array:
    """Return the rotation whose z axis is `z`, with x along the first slide if there is one."""
    x = slides[0].axis if slides else np.eye(3)[np.argmin(np.abs(z))]
    y = np.cross(z, x)
    y /= np.linalg.norm(y)
    return np.array([np.cross(y, z), y, z]).T


def _twist(joints: Sequence[Joint], values: Sequence[float], rates: Sequence[float]) -> pin.Motion:
    """Compute the body twist of a chain of joints from joint values and rates."""
    twist = pin.Motion.Zero()
    for joint, value, rate in zip(joints, values, rates, strict=True):
        twist = joint.motion(value).actInv(twist) + joint.twist(rate)
    return twist


def _moves_freely(joints: Sequence[Joint], values: Sequence[float]) -> bool:
    """Return whether the joint twists are linearly independent at the given joint values."""
    twists = [_twist(joints, values, rates).vector for rates in np.eye(len(joints)).tolist()]
    return _rank(twists) == len(joints)


def _rank(vectors: Sequence[Array]) -> int:
    return int(np.linalg.matrix_rank(np.array(vectors), tol=1e-9))


def _rotation(values: Array) -> Array:
    return np.asarray(frame(np.zeros(3), wxyz(values)).rotation)

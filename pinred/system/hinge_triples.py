"""Hinge triples: three consecutive hinges that together are a ball, and why others are not.

Three hinges through one point turn the child in every direction if the second axis is at right
angles to the first and to the third.  These two angles are constant.  The first and the third axis
may have any angle: it depends on the second hinge's value.  With massless bodies between them, the
hinges and a ball move the child alike, except where the hinges lose a direction (gimbal lock).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.names import listed, quoted
from .joints import axes_of, is_prismatic, is_shape_joint, largest_step, root_chain

_MEET = 1e-9  # largest distance between axes that meet, relative to the robot's largest step
_RIGHT_ANGLE = 1e-5  # largest cosine of a right angle, for angles such as 1.5708 in files
_ROUND_OFF = 1e-14  # largest round-off of an attitude [rad]
_IN_LOCK = 1e-13  # largest sine between the first and third axes in gimbal lock
_CORRECTIONS = 5  # largest number of Newton's steps for axes near right angles
_SEPARATORS = "_-.:/ "


@dataclass(frozen=True, eq=False)
class HingeTriple:
    """Three consecutive hinges.

    Attributes:
        name: Name of the ball.
        hinges: Names of the hinges, from the parent to the child.
        axes: Unit axes of the hinges where all are at zero, in the child's axes, (3, 3); one row
            for each hinge.
        centre: Point where the axes meet, in the frame of the last hinge, (3,) [m].
        obstacle: Why the hinges do not move like a ball, and a remedy; "" if they do.
        difference: Why a ball cannot replace the hinges although it moves alike, and a remedy;
            "" if it can.
    """

    name: str
    hinges: tuple[str, str, str]
    axes: Array
    centre: Array
    obstacle: str = ""
    difference: str = ""

    @property
    def why_not(self) -> str:
        """Why the hinges cannot become a ball, and a remedy; "" if they can."""
        return self.obstacle or self.difference

    def __str__(self) -> str:
        return f"{', '.join(self.hinges)} → ball '{self.name}'"

    def attitude(self, angles: Array) -> Array:
        """Return the quaternion (x, y, z, w) of the ball for the angles of the hinges, (3,)."""
        return np.asarray(pin.Quaternion(self._rotation(angles)).normalized().coeffs())

    def angles(self, attitude: Array) -> Array:
        """Return angles of the hinges, (3,) [rad], at which the ball has an attitude.

        Of the two solutions, return the one with the smaller angles.  In gimbal lock the first
        angle is zero.  Near it, axes that are not exactly at right angles miss some attitudes by up
        to their error, at most 2e-5 rad; the angles are then those of a nearby attitude.

        Args:
            attitude: Unit quaternion (x, y, z, w), (4,).
        """
        R = pin.Quaternion(np.asarray(attitude, dtype=float)).toRotationMatrix()
        a1, a2, a3 = self.axes
        # With right angles, a1ᵀ R a3 = p cos β + s sin β = cos (β − φ) for p = a1·a3 = cos φ.
        phi = np.arctan2(a1 @ np.cross(a2, a3), a1 @ a3)
        tilt = np.arctan2(np.linalg.norm(np.cross(a1, R @ a3)), a1 @ R @ a3)
        solutions = [self._refined(self._angles_at(R, phi + t), R) for t in (tilt, -tilt)]
        errors = [self._error(angles, R) for angles in solutions]
        passing = [k for k in range(2) if errors[k] <= 2.0 * min(errors) + _ROUND_OFF]
        return min((solutions[k] for k in passing), key=lambda angles: float(angles @ angles))

    def _angles_at(self, R: Array, second: float) -> Array:
        """Return angles of the hinges for a rotation, (3, 3), and the angle of the second hinge."""
        a1, a2, a3 = self.axes
        # The first hinge turns one of these vectors, normal to its axis, into the other.
        before, after = np.cross(a1, pin.exp3(a2 * second) @ a3), np.cross(a1, R @ a3)
        sine, cosine = a1 @ np.cross(before, after), before @ after
        in_lock = np.hypot(sine, cosine) <= _IN_LOCK**2
        first = 0.0 if in_lock else float(np.arctan2(sine, cosine))
        remainder = pin.exp3(a2 * second).T @ pin.exp3(a1 * first).T @ R
        vee = np.array(
            [
                remainder[2, 1] - remainder[1, 2],
                remainder[0, 2] - remainder[2, 0],
                remainder[1, 0] - remainder[0, 1],
            ]
        )
        return np.array([first, second, np.arctan2(a3 @ vee, np.trace(remainder) - 1.0)])

    def _refined(self, angles: Array, R: Array) -> Array:
        """Correct angles for axes that are not exactly at right angles, with Newton's method."""
        for _ in range(_CORRECTIONS):
            error = self._error(angles, R)
            if error <= _ROUND_OFF:
                break
            columns = np.transpose([self.rate(angles, rate) for rate in np.eye(3)])
            step = np.linalg.lstsq(columns, pin.log3(self._rotation(angles).T @ R), rcond=None)[0]
            if not self._error(angles + step, R) < error:
                break
            angles = angles + step
        return angles

    def _rotation(self, angles: Array) -> Array:
        """Return the rotation, (3, 3), of the ball for the angles of the hinges, (3,)."""
        turns = [pin.exp3(axis * angle) for axis, angle in zip(self.axes, angles, strict=True)]
        return np.asarray(turns[0] @ turns[1] @ turns[2])

    def _error(self, angles: Array, R: Array) -> float:
        """Return the angle [rad] between the attitude at given angles and a rotation, (3, 3)."""
        return float(np.linalg.norm(pin.log3(self._rotation(angles).T @ R)))

    def rate(self, angles: Array, rates: Array) -> Array:
        """Return the angular velocity in the child's axes, (3,), for angles and rates, (3,)."""
        velocity = np.zeros(3)
        for axis, angle, rate in zip(self.axes, angles, rates, strict=True):
            velocity = pin.exp3(axis * angle).T @ velocity + rate * axis
        return velocity


def hinge_triples(
    model: pin.Model,
    kept: Collection[str] = (),
    actions: Mapping[str, Sequence[str]] | None = None,
) -> list[HingeTriple]:
    """Return the sequences of three hinges from parent to child, behind the root.

    Those that can become balls have no joint in common.

    Args:
        model: Model of hinges, slides and balls.
        kept: Joints that must stay, because they are locked or coupled.
        actions: Springs, dampers and friction at each joint, in words.
    Returns:
        The triples in the order of their first hinges.
    """
    chain = root_chain(model)
    first = 1 if chain is None else chain.last + 1
    triples: list[HingeTriple] = []
    used: set[str] = set()
    for joints in _sequences(model, first):
        triple = _triple(model, joints)
        names = triple.hinges
        difference = _kept_words([name for name in names if name in kept]) or _difference(
            model, joints, actions or {}
        )
        triple = replace(triple, difference=difference)
        if triple.why_not:
            triples.append(triple)
        elif used.isdisjoint(names):
            used |= {*names}
            triples.append(triple)
    return _with_unique_names(model, triples)


def _sequences(model: pin.Model, first: int) -> Iterator[tuple[int, int, int]]:
    """Yield the indices of three hinges from parent to child, all at least `first`."""
    hinges = {i for i in range(first, model.njoints) if _is_hinge(model.joints[i])}
    on_ground = model.inertias[0].mass == 0.0
    for k in sorted(hinges):
        j = int(model.parents[k])
        i = int(model.parents[j]) if j in hinges else 0
        # A hinge on a massless ground is the root.
        if i in hinges and not (on_ground and model.parents[i] == 0):
            yield i, j, k


def _is_hinge(joint: pin.JointModel) -> bool:
    return is_shape_joint(joint) and joint.nv == 1 and not is_prismatic(joint)


def _triple(model: pin.Model, joints: tuple[int, int, int]) -> HingeTriple:
    """Return three hinges as a triple, with an obstacle of its structure or geometry."""
    k = joints[-1]
    names = tuple(str(model.names[joint]) for joint in joints)
    on_child = _places(model, joints)
    axes = np.array([at.rotation @ axes_of(model.joints[n])[3:, 0] for n, at in on_child.items()])
    points = np.array([at.translation for at in on_child.values()])
    centre, distance = _meeting_point(points, axes)
    links = [f.name for f in model.frames if f.parentJoint == k and f.type == pin.FrameType.BODY]
    obstacle = _structure_obstacle(model, joints) or _geometry_obstacle(
        names, axes, distance, largest_step(model)
    )
    name = ball_name(names, links)
    return HingeTriple(name, (names[0], names[1], names[2]), axes, centre, obstacle)


def _places(model: pin.Model, joints: tuple[int, int, int]) -> dict[int, pin.SE3]:
    """Return the frames of three hinges at zero, relative to that of the last hinge."""
    _, j, k = joints
    behind = model.jointPlacements[k].inverse()
    first = behind * model.jointPlacements[j].inverse()
    return dict(zip(joints, (first, behind, pin.SE3.Identity()), strict=True))


def _meeting_point(points: Array, axes: Array) -> tuple[Array, float]:
    """Return the point nearest to three lines, (3,), and its largest distance from them.

    Args:
        points: A point on each line, (3, 3).
        axes: Unit directions, (3, 3).
    """
    # Lines along unit axes: the squared distance of p is |(1 − a aᵀ)(p − point)|².
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    target = np.einsum("kij,kj->i", across, points)
    centre = (
        points[2]
        + np.linalg.lstsq(across.sum(axis=0), target - across.sum(axis=0) @ points[2], rcond=1e-9)[
            0
        ]
    )
    # A point on a line is exact, so prefer the points of the file to a computed one.
    centre = min([*points[::-1], centre], key=lambda p: _distance(p, points, axes))
    return centre, _distance(centre, points, axes)


def _distance(p: Array, points: Array, axes: Array) -> float:
    """Return the largest distance of a point from lines."""
    return float(np.linalg.norm(np.cross(axes, p - points), axis=1).max())


def _structure_obstacle(model: pin.Model, joints: tuple[int, int, int]) -> str:
    """Return why bodies between three hinges forbid a ball; "" if they do not."""
    for joint, behind in pairwise(joints):
        name, body = model.names[joint], model.inertias[joint]
        if body.mass != 0.0 or body.inertia.any():
            return (
                f"the body between {quoted(name)} and {quoted(model.names[behind])} has mass "
                f"{body.mass:g} kg; only a massless body can be left out"
            )
        siblings = [str(model.names[n]) for n in model.children[joint] if n != behind]
        if siblings:
            return (
                f"the body moved by {quoted(name)} also carries {listed(siblings)}; attach these "
                f"to the body behind {quoted(model.names[joints[2]])}"
            )
    return ""


def _geometry_obstacle(names: Sequence[str], axes: Array, distance: float, unit: float) -> str:
    """Return why the axes of three hinges are not those of a ball; "" if they are.

    Args:
        names: Names of the hinges.
        axes: Unit axes, (3, 3).
        distance: Largest distance of the axes from a common point [m].
        unit: Largest distance between joints of the robot [m].
    """
    if distance > _MEET * unit:
        return (
            f"their axes do not meet at one point, but miss it by {distance:.3g} m; give the "
            "three hinges one position"
        )
    for k in range(2):
        cosine = abs(float(axes[k] @ axes[k + 1]))
        if cosine > _RIGHT_ANGLE:
            angle = np.degrees(np.arccos(min(cosine, 1.0)))
            return (
                f"the axes of {quoted(names[k])} and {quoted(names[k + 1])} are at {angle:.6g}°, "
                "so the hinges do not reach every attitude; set them at right angles"
            )
    return ""


def _kept_words(names: Sequence[str]) -> str:
    """Return why locked or coupled hinges cannot become a ball; "" without names."""
    if not names:
        return ""
    return f"{listed(names)} must stay, locked or coupled to others; unlock it, or uncouple it"


def _difference(
    model: pin.Model, joints: Sequence[int], actions: Mapping[str, Sequence[str]]
) -> str:
    """Return which values differ between hinges; "" if none does."""
    names = [str(model.names[i]) for i in joints]
    armature = [f"{model.armature[model.joints[i].idx_v]:g}" for i in joints]
    rotors = np.array([model.armature[model.joints[i].idx_v] for i in joints])
    if np.ptp(rotors) != 0.0:
        values = ", ".join(armature)
        return f"their armature differs ({values}); a ball has one value. Make the values equal"
    lists = [tuple(actions.get(name, ())) for name in names]
    if len(set(lists)) > 1:
        values = "; ".join(
            f"{name}: {', '.join(words) or 'none'}"
            for name, words in zip(names, lists, strict=True)
        )
        return (
            f"their springs, damping or friction differ ({values}); a ball has one value of each. "
            "Make the values equal"
        )
    return ""


def ball_name(hinges: Sequence[str], links: Sequence[str] = ()) -> str:
    """Return a name for the ball that replaces hinges: their common beginning.

    Hinges lfemurrz, lfemurry, lfemurrx of a link lfemur become "lfemur".  Without a common
    beginning, the name is that of the first hinge.

    Args:
        hinges: Names of the hinges.
        links: Names of the links that the last hinge moves.
    """
    letters = takewhile(lambda column: len(set(column)) == 1, zip(*hinges, strict=False))
    beginning = "".join(column[0] for column in letters)
    common = beginning.rstrip(_SEPARATORS)
    if common.endswith("r") and common[:-1].rstrip(_SEPARATORS) in links:
        return common[:-1].rstrip(_SEPARATORS)
    is_word = len(common) > 1 or (common and common != beginning)
    return common if is_word else hinges[0]


def _with_unique_names(model: pin.Model, triples: Sequence[HingeTriple]) -> list[HingeTriple]:
    """Name balls after their first hinges where their names are those of other joints."""
    names = [triple.name for triple in triples if not triple.why_not]
    unique = []
    for triple in triples:
        other_names = {str(name) for name in model.names} - {*triple.hinges}
        is_taken = triple.name in other_names or (
            not triple.why_not and names.count(triple.name) > 1
        )
        unique.append(replace(triple, name=triple.hinges[0]) if is_taken else triple)
    return unique

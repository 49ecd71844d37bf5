"""Describe a robot as a list of bodies and joints, and write it as a URDF or MJCF text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, positive, read_only, vector
from ..common.errors import InputError, ShapeError
from ..common.files import check_path, write_atomic
from ..common.names import brief, listed, nearest, quoted
from .joints import attitude_of

BodyJoint: TypeAlias = Literal["", "hinge", "slide", "ball", "fixed"]

_AXES = dict(zip("xyz", np.eye(3), strict=True))


@dataclass(frozen=True, eq=False)
class DescribedBody:
    """A body with the joint that carries it.

    Attributes:
        name: Name of the body and of its joint.
        mass: Mass [kg].
        inertia: Moment of inertia about the centre of mass, (3, 3), in the body's axes [kg m²].
        com: Centre of mass in the body frame, (3,) [m].
        joint: Type of the joint; "" for the base.
        parent: Name of the body that carries the joint; "" for the base.
        axis: Unit axis of a hinge or slide in the body's axes, (3,).
        at: Origin of the body frame in the parent's frame where the joint is at zero, (3,) [m].
        attitude: Attitude of the body relative to its parent, as a quaternion (x, y, z, w).
        limits: Lowest and highest value of a hinge or slide [rad | m], or None.
    """

    name: str
    mass: float
    inertia: Array
    com: Array
    joint: BodyJoint
    parent: str
    axis: Array
    at: Array
    attitude: Array
    limits: tuple[float, float] | None


def inertia_matrix(value: ArrayLike, what: str) -> Array:
    """Return a symmetric inertia matrix, (3, 3)."""
    entries = as_floats(value, f"inertia of {what}")
    if entries.shape not in ((), (3,), (3, 3)):
        raise ShapeError(
            f"inertia of {what}: expected one number, three principal moments or a matrix (3, 3), "
            f"got shape {entries.shape}"
        )
    matrix = entries if entries.ndim == 2 else np.diag(np.broadcast_to(entries, 3))
    if not np.isfinite(matrix).all() or not np.array_equal(matrix, matrix.T):
        raise InputError(f"inertia of {what} must be finite and symmetric, got {brief(value)}")
    return read_only(np.array(matrix))


def unit_axis(value: str | ArrayLike, what: str) -> Array:
    """Return a unit vector from the name of an axis or from a vector."""
    if isinstance(value, str):
        name = value.removeprefix("-")
        if name not in _AXES:
            raise InputError(
                f"axis of {what} must be x, y, z, -x, -y, -z or a vector, got {quoted(value)}"
            )
        return read_only(-_AXES[name] if value[0] == "-" else _AXES[name].copy())
    direction = vector(value, 3, f"axis of {what}")
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise InputError(f"axis of {what} must not be zero")
    return read_only(direction / length)


def checked_mass(mass: float, inertia: Array, com: Array, joint: str, what: str) -> float:
    """Return the mass of a body.  A body on a fixed joint may be a frame without mass."""
    if joint == "fixed" and isinstance(mass, (int, float)) and mass == 0:
        if inertia.any() or com.any():
            raise InputError(f"{what}: a frame without mass has neither inertia nor com")
        return 0.0
    return positive(mass, f"mass of {what}")


def increasing_limits(value: tuple[float, float] | None, what: str) -> tuple[float, float] | None:
    """Return increasing limits, or None."""
    if value is None:
        return None
    low, high = vector(value, 2, f"limits of {what}")
    if low >= high:
        raise InputError(f"limits of {what} must increase, got {brief(value)}")
    return float(low), float(high)


_URDF_TYPES = {"slide": "prismatic", "fixed": "fixed"}


def urdf_of(name: str, bodies: Sequence[DescribedBody]) -> str:
    """Return a described robot as a URDF text, with three hinges for each ball."""
    robot = Element("robot", name=name)
    for body in bodies:
        parent = body.parent
        at, rpy = _numbers(body.at), _numbers(pin.rpy.matrixToRpy(_rotation(body.attitude)))
        if body.joint == "ball":
            for axis in "yx":
                carrier = f"{body.name}_{axis}_carrier"
                SubElement(robot, "link", name=carrier)
                _joint(robot, f"{body.name}_{axis}", "continuous", parent, carrier, at, rpy, axis)
                parent, at, rpy = carrier, "0 0 0", "0 0 0"
            _joint(robot, f"{body.name}_z", "continuous", parent, body.name, at, rpy, "z")
        elif body.joint:
            kind = _URDF_TYPES.get(body.joint, "revolute" if body.limits else "continuous")
            joint = _joint(robot, body.name, kind, parent, body.name, at, rpy, body.axis)
            if kind in ("revolute", "prismatic"):
                low, high = (-np.inf, np.inf) if body.limits is None else body.limits
                most = float(np.finfo(float).max)
                SubElement(
                    joint, "limit", lower=repr(max(low, -most)), upper=repr(min(high, most)),
                    effort="0", velocity="0",
                )  # fmt: skip
        _link(robot, body)
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"


def _joint(
    robot: Element, name: str, kind: str, parent: str, child: str, at: str, rpy: str,
    axis: str | Array,
) -> Element:  # fmt: skip
    """Add a joint to a URDF robot."""
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=at, rpy=rpy)
    if kind != "fixed":
        vector = np.eye(3)["xyz".index(axis)] if isinstance(axis, str) else axis
        SubElement(joint, "axis", xyz=_numbers(vector))
    return joint


def _link(robot: Element, body: DescribedBody) -> None:
    """Add a link with its inertia, if it has mass, to a URDF robot."""
    link = SubElement(robot, "link", name=body.name)
    if not body.mass:
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(body.com))
    SubElement(inertial, "mass", value=repr(body.mass))
    entries = {
        f"i{'xyz'[i]}{'xyz'[j]}": repr(float(body.inertia[i, j]))
        for i in range(3)
        for j in range(i, 3)
    }
    SubElement(inertial, "inertia", entries)


def mjcf_of(name: str, bodies: Sequence[DescribedBody]) -> str:
    """Return a described robot as an MJCF text, with a free joint at the base."""
    root = Element("mujoco", model=name)
    # Every inertia is written; shapes, of which there are none, would not change it.
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    elements = {"": SubElement(root, "worldbody")}
    for body in bodies:
        x, y, z, w = body.attitude
        element = SubElement(
            elements[body.parent], "body", name=body.name, pos=_numbers(body.at),
            quat=_numbers(np.array([w, x, y, z])),
        )  # fmt: skip
        elements[body.name] = element
        if not body.joint:
            SubElement(element, "freejoint")
        elif body.joint != "fixed":
            joint = SubElement(element, "joint", name=body.name, type=body.joint)
            if body.joint != "ball":
                joint.set("axis", _numbers(body.axis))
            if body.limits is not None:
                joint.set("range", _numbers(np.array(body.limits)))
        if not body.mass:
            continue
        SubElement(
            element, "inertial", _moments(body.inertia), pos=_numbers(body.com),
            mass=repr(body.mass),
        )  # fmt: skip
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _moments(inertia: Array) -> dict[str, str]:
    """Return the MJCF attribute of an inertia.  MuJoCo accepts zeros in principal moments only."""
    products = inertia[np.triu_indices(3, 1)]
    if not products.any():
        return {"diaginertia": _numbers(np.diag(inertia))}
    return {"fullinertia": _numbers(np.append(np.diag(inertia), products))}


def _numbers(values: Array) -> str:
    """Return numbers as text, separated by blanks, which reads back as the same numbers."""
    return " ".join(repr(float(value)) for value in values)


def _rotation(attitude: Array) -> Array:
    """Return the rotation matrix of a quaternion (x, y, z, w)."""
    return np.asarray(pin.Quaternion(np.array(attitude)).matrix())


_ORIGIN = (0.0, 0.0, 0.0)


@checks_arguments
@dataclass(frozen=True, eq=False)
class Model:
    """A robot as a list of bodies, each carried by a joint of the same name.

    Every call returns a new model with one more body, so that calls can be chained.  Lengths are
    in metres.  `pinred.load` accepts the model; `save` writes it as a file.

    Attributes:
        name: Name of the robot.
        bodies: The bodies, the base first.
    """

    name: str = "robot"
    bodies: tuple[DescribedBody, ...] = ()

    def body(
        self, name: str, *, mass: float, inertia: ArrayLike = 0.0, com: ArrayLike = _ORIGIN
    ) -> Model:
        """Return the model with a base.

        Args:
            name: Name of the body.
            mass: Mass [kg].
            inertia: Moment of inertia about the centre of mass [kg m²]: one number for all axes,
                three principal moments, or a symmetric matrix (3, 3).
            com: Centre of mass in the body frame, (3,) [m].
        Raises:
            InputError: The model has a base, or a value is not valid.
        """
        if self.bodies:
            raise InputError(
                f"body {quoted(name)}: the base is {quoted(self.bodies[0].name)} already; add "
                "further bodies with hinge, slide, ball or fixed"
            )
        return self._with("", name, "", mass, inertia, com)

    def hinge(
        self,
        name: str,
        *,
        parent: str,
        axis: str | ArrayLike,
        at: ArrayLike = _ORIGIN,
        attitude: ArrayLike = _ORIGIN,
        mass: float,
        inertia: ArrayLike = 0.0,
        com: ArrayLike = _ORIGIN,
        limits: tuple[float, float] | None = None,
    ) -> Model:
        """Return the model with a body on a hinge.

        Args:
            name: Name of the body and of its joint.
            parent: Name of the body that carries the hinge.
            axis: "x", "y", "z", "-x", "-y", "-z" or a vector, (3,), in the new body's axes.
            at: Origin of the new body frame, on the axis, in the parent's frame, (3,) [m].
            attitude: Attitude of the new body where the joint is at zero: rotation vector [rad] or
                quaternion (x, y, z, w).
            mass: Mass [kg].
            inertia: Moment of inertia about the centre of mass (see `body`) [kg m²].
            com: Centre of mass in the new body frame, (3,) [m].
            limits: Lowest and highest angle [rad].
        Raises:
            InputError: A name is taken or unknown, or a value is not valid.
        """
        return self._with("hinge", name, parent, mass, inertia, com, axis, at, attitude, limits)

    def slide(
        self,
        name: str,
        *,
        parent: str,
        axis: str | ArrayLike,
        at: ArrayLike = _ORIGIN,
        attitude: ArrayLike = _ORIGIN,
        mass: float,
        inertia: ArrayLike = 0.0,
        com: ArrayLike = _ORIGIN,
        limits: tuple[float, float] | None = None,
    ) -> Model:
        """Return the model with a body on a slide.

        Args:
            name: Name of the body and of its joint.
            parent: Name of the body that carries the slide.
            axis: Direction (see `hinge`).
            at: Origin of the new body frame in the parent's frame, (3,) [m].
            attitude: Attitude of the new body (see `hinge`).
            mass: Mass [kg].
            inertia: Moment of inertia about the centre of mass (see `body`) [kg m²].
            com: Centre of mass in the new body frame, (3,) [m].
            limits: Lowest and highest displacement [m].
        Raises:
            InputError: A name is taken or unknown, or a value is not valid.
        """
        return self._with("slide", name, parent, mass, inertia, com, axis, at, attitude, limits)

    def ball(
        self,
        name: str,
        *,
        parent: str,
        at: ArrayLike = _ORIGIN,
        attitude: ArrayLike = _ORIGIN,
        mass: float,
        inertia: ArrayLike = 0.0,
        com: ArrayLike = _ORIGIN,
    ) -> Model:
        """Return the model with a body on a ball joint.

        Args:
            name: Name of the body and of its joint.
            parent: Name of the body that carries the ball.
            at: Centre of the ball, the origin of the new body frame, in the parent's frame [m].
            attitude: Attitude of the new body where the joint is at zero (see `hinge`).
            mass: Mass [kg].
            inertia: Moment of inertia about the centre of mass (see `body`) [kg m²].
            com: Centre of mass in the new body frame, (3,) [m].
        Raises:
            InputError: A name is taken or unknown, or a value is not valid.
        """
        return self._with("ball", name, parent, mass, inertia, com, "z", at, attitude)

    def fixed(
        self,
        name: str,
        *,
        parent: str,
        at: ArrayLike = _ORIGIN,
        attitude: ArrayLike = _ORIGIN,
        mass: float = 0.0,
        inertia: ArrayLike = 0.0,
        com: ArrayLike = _ORIGIN,
    ) -> Model:
        """Return the model with a body, or a frame without mass, that is fixed to another.

        Args:
            name: Name of the body.
            parent: Name of the body to which it is fixed.
            at: Origin of the new body frame in the parent's frame, (3,) [m].
            attitude: Attitude of the new body (see `hinge`).
            mass: Mass [kg].  A body without mass is a frame: the tip of a tool, or the end of a
                loop.
            inertia: Moment of inertia about the centre of mass (see `body`) [kg m²].
            com: Centre of mass in the new body frame, (3,) [m].
        Raises:
            InputError: A name is taken or unknown, or a value is not valid.
        """
        return self._with("fixed", name, parent, mass, inertia, com, "z", at, attitude)

    @property
    def balls(self) -> tuple[str, ...]:
        """Names of the ball joints."""
        return tuple(body.name for body in self.bodies if body.joint == "ball")

    def urdf(self) -> str:
        """Return the robot as a URDF text.

        URDF has no ball joint: a ball becomes three hinges, which `load(…, balls=model.balls)`
        merges again.
        """
        return urdf_of(self.name, self._complete())

    def mjcf(self) -> str:
        """Return the robot as an MJCF text, with a free joint at the base."""
        return mjcf_of(self.name, self._complete())

    def save(self, path: str | Path) -> Path:
        """Write the robot to a file: URDF for .urdf, MJCF for .xml.

        Args:
            path: Path of the file, which is replaced.
        Returns:
            The path.
        Raises:
            InputError: The suffix is another one, or the model has no bodies.
        """
        target = check_path(path, (".urdf", ".xml"))
        text = self.urdf() if target.suffix == ".urdf" else self.mjcf()
        write_atomic(target, lambda file: file.write(text.encode()))
        return target

    def _complete(self) -> tuple[DescribedBody, ...]:
        if not self.bodies:
            raise InputError(f"model {quoted(self.name)} has no bodies; begin with body(…)")
        return self.bodies

    def _with(
        self,
        joint: BodyJoint,
        name: str,
        parent: str,
        mass: float,
        inertia: ArrayLike,
        com: ArrayLike,
        axis: str | ArrayLike = "z",
        at: ArrayLike = _ORIGIN,
        attitude: ArrayLike = _ORIGIN,
        limits: tuple[float, float] | None = None,
    ) -> Model:
        """Return the model with one more body."""
        names = [body.name for body in self.bodies]
        what = f"{joint or 'body'} {quoted(name)}"
        if not name or name in names or name.startswith("world"):
            taken = f"its bodies are {listed(names, 20)}" if name in names else "it is reserved"
            raise InputError(f"{what}: this name cannot be used in {quoted(self.name)}; {taken}")
        if joint and parent not in names:
            raise InputError(
                f"{what}: no body {quoted(parent)} carries it; {nearest(parent, names)}the bodies "
                f"are {listed(names, 20) or 'none, so begin with body(…)'}"
            )
        moments = inertia_matrix(inertia, what)
        centre = read_only(vector(com, 3, f"com of {what}"))
        body = DescribedBody(
            name, checked_mass(mass, moments, centre, joint, what), moments, centre,
            joint, parent, unit_axis(axis, what),
            read_only(vector(at, 3, f"at of {what}")),
            read_only(attitude_of(attitude, f"attitude of {what}")),
            increasing_limits(limits, what),
        )  # fmt: skip
        return replace(self, bodies=(*self.bodies, body))

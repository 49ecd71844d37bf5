"""Describe a robot as a list of bodies and joints, and write it as a URDF or MJCF file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import read_only, vector
from ..common.errors import InputError
from ..common.files import check_path, write_atomic
from ..common.names import listed, nearest, quoted
from .attitude import attitude_of
from .described_body import (
    BodyJoint,
    DescribedBody,
    checked_mass,
    increasing_limits,
    inertia_matrix,
    unit_axis,
)
from .description_texts import mjcf_of, urdf_of

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

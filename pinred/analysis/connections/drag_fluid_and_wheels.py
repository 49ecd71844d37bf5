"""The physics that defines a connection: momenta, drag, a perfect fluid, or wheels.

Horizontal motions have zero momentum (mechanical connection).  In a viscous fluid, at low Reynolds
number, the total drag on the robot vanishes.  In a perfect fluid, the momentum of robot and fluid
vanishes.  Wheels that do not slip determine the motion of the body (kinematic connection).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, positive, vector
from ...common.errors import InputError
from ...common.machine_code import NativeCode
from ...common.memo import once
from ...common.names import joint_index, listed, nearest, quoted
from ...kernels.connection.connection_code import ConnectionCode, cached_code
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...kernels.kernel import evaluate
from ...kernels.reference_state import length_of, steps_of
from ...kernels.validation import require_agreement
from ...lie.rotations import hat
from ...reduction.pointwise_reduction import mass_matrix
from ...reduction.tree.all_joints import joint_values
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.momenta import (
    centre_of_mass,
    inertia_tensors,
    locked,
    momenta,
    speed_along,
    tensors_of,
    twists_at,
)
from ...system.system import System, checked_system


def mechanical_form(system: System) -> ConnectionForm:
    """Return the symmetric form H(x) that maps velocities (ξ, ẋ) to the momenta (μ, π)."""
    system = checked_system(system, "Connection.mechanical")
    return form_of(
        system.group, system.shape_names, system.units, f"the momenta of '{system.name}'",
        partial(momenta, system), partial(mass_matrix, system), symmetric=True, momentum=True,
        locked=partial(locked, system), space=system.space,
    )  # fmt: skip


def mechanical_code(system: System) -> ConnectionCode:
    """Return the compiled mechanical connection of a system; it is cached."""
    system = checked_system(system, "Connection.mechanical")
    return once(system, mechanical_code, lambda: ConnectionCode(mechanical_form(system)))


def centres_of_mass(system: System, x: Array) -> Array:
    """Return the centre of mass in the root body's frame at shapes x (N, nx), (N, 3) [m]."""
    shape = ca.SX.sym("x", system.nx)

    def make() -> NativeCode:
        joints = joint_values(system, [shape[k] for k in range(system.nx)])
        com = ca.vertcat(*centre_of_mass(bodies_of(system), joints))
        graph = ca.Function("com", [shape, ca.SX.sym("none")], [ca.densify(com)], {"cse": True})
        code = cached_code(graph.serialize(), "com", lambda: graph)
        _validate_com(system, code)
        return code

    code = once(system, centres_of_mass, make)
    return evaluate(code.address, np.zeros(1), x, 3)


def _validate_com(system: System, code: NativeCode) -> None:
    """Compare with Pinocchio's centre of mass at a random shape.  Raises KernelMismatch."""
    displacement = np.random.default_rng(0).uniform(-2.0, 2.0, system.m)
    displacement *= steps_of(system, length_of(system))[system.r :]
    x = system.space.integrate(system.space.neutral, displacement)
    model, data = system.sorted_model, system.sorted_data
    com = pin.centerOfMass(model, data, system.sorted_q(system.group.identity(), x))
    reach = sum(float(np.linalg.norm(place.translation)) for place in model.jointPlacements)
    slides = [unit == "m" for unit in system.units]
    reach += float(np.abs(displacement[slides]).sum()) + length_of(system)
    require_agreement(
        f"the machine code of '{system.name}'", "the centre of mass",
        evaluate(code.address, np.zeros(1), x[None], 3)[0], data.oMi[1].actInv(com), reach,
    )  # fmt: skip


_ROUND_OFF = 1e-14  # largest asymmetry of a symmetric tensor, relative to its largest entry


@dataclass(frozen=True)
class Link:
    """A link, or any other frame of the model.

    Attributes:
        joint: Index in the model of the joint that moves the link; 1 is the root joint.
        placement: Placement in the frame of that joint.
    """

    joint: int
    placement: pin.SE3


def link_named(system: System, name: str, what: str) -> Link:
    """Return a moving link by name.

    Args:
        system: The system.
        name: Name of the link, or of another frame.
        what: Name of the argument, for error messages.
    Returns:
        The link.
    Raises:
        InputError: No moving link has this name; the message lists the moving links.
    """
    model = system.sorted_model
    moving = {
        frame.name: frame
        for frame in model.frames
        if frame.parentJoint >= 1 and frame.type == pin.FrameType.BODY
    }
    frame = moving.get(name)
    # Pinocchio raises exceptions for names that are not UTF-8, so the names are compared here.
    candidate = next((entry for entry in model.frames if entry.name == name), None)
    if frame is None and candidate is not None and candidate.parentJoint >= 1:
        frame = candidate
    if frame is None:
        names = list(moving)
        raise InputError(
            f"{what}: no moving link {quoted(str(name))}; {nearest(str(name), names)}"
            f"the links are {listed(names)}"
        )
    return Link(frame.parentJoint, pin.SE3(frame.placement))


def tensors_by_body(system: System, by_link: Mapping[str, Array], what: str) -> list[Array]:
    """Sum the tensors of links for each body.

    Args:
        system: The system.
        by_link: Symmetric tensors (6, 6), each in its link's frame.
        what: Name of the argument, for error messages.
    Returns:
        Tensors (6, 6) of all bodies in their joint frames, root first.
    Raises:
        InputError: A link is unknown, or a tensor is not symmetric.
    """
    tensors = [np.zeros((6, 6)) for _ in range(1, system.model.njoints)]
    for name, tensor in by_link.items():
        link = link_named(system, name, what)
        D = np.asarray(tensor, dtype=float)
        if not _is_symmetric(D):
            raise InputError(f"{what}: the tensor of {quoted(name)} must be symmetric, (6, 6)")
        X = link.placement.inverse().toActionMatrix()
        tensors[link.joint - 1] += X.T @ D @ X
    return tensors


def _is_symmetric(D: Array) -> bool:
    """Return whether D is a finite symmetric matrix (6, 6), up to round-off of a rotation."""
    if D.shape != (6, 6) or not np.isfinite(D).all():
        return False
    return bool(np.allclose(D, D.T, atol=_ROUND_OFF * float(np.abs(D).max())))


def summed(system: System, tensors: Sequence[Array], x: Array) -> Array:
    """Compute Σ JᵀDJ over all bodies with the Jacobians J of Pinocchio.

    Args:
        system: The system.
        tensors: Tensors D (6, 6) of all bodies in their joint frames, root first.
        x: Shape, (m,).
    Returns:
        Sum of the tensors on velocities (ξ, ẋ), (n, n).
    """
    model, data = system.sorted_model, system.sorted_data
    pin.computeJointJacobians(model, data, system.sorted_q(system.group.identity(), x))
    total = np.zeros((model.nv, model.nv))
    for i, D in enumerate(tensors):
        J = pin.getJointJacobian(model, data, i + 1, pin.LOCAL)
        total += J.T @ D @ J
    return system.coupled_matrix(total)


def link_jacobian(system: System, link: Link, x: Array) -> Array:
    """Compute the Jacobian of a link's twist in its frame, (6, n), at shape x (m,)."""
    model, data = system.sorted_model, system.sorted_data
    pin.computeJointJacobians(model, data, system.sorted_q(system.group.identity(), x))
    J = pin.getJointJacobian(model, data, link.joint, pin.LOCAL)
    in_frame = link.placement.inverse().toActionMatrix() @ J
    return np.asarray(system.on_shape(in_frame))


@checks_arguments
@dataclass(frozen=True)
class Rod:
    """A slender rod in a viscous fluid, modelled with resistive-force theory.

    Its drag is diag(c_t L, c_n L, c_n L) on translation and c_n L³/12 on rotation across its axis.
    It does not resist rotation about its axis.

    Attributes:
        length: Length L [m].
        across: Drag coefficient c_n normal to the rod, per length [N s/m²].
        along: Drag coefficient c_t along the rod, per length [N s/m²].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of the rod in its link's frame, (3,).
        tensor: Drag tensor, (6, 6), in its link's frame about the origin.
    """

    length: float
    across: float
    along: float
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        L, c_n, c_t = (
            np.float64(positive(getattr(self, name), name))
            for name in ("length", "across", "along")
        )
        with np.errstate(all="ignore"):
            rotation = c_n * L**3 / 12.0
            about_centre = np.diag([c_t * L, c_n * L, c_n * L, 0.0, rotation, rotation])
        tensor = in_link_frame(about_centre, self.centre, self.axis, "length, across, along")
        object.__setattr__(self, "tensor", tensor)


def in_link_frame(tensor: Array, centre: ArrayLike, axis: ArrayLike, sizes: str) -> Array:
    """Transform the tensor of a body to its link's frame.

    Args:
        tensor: Tensor about the body's centre, with x along its axis, (6, 6).
        centre: Centre in the link's frame, (3,) [m].
        axis: Direction of the body's axis in the link's frame, (3,).
        sizes: Names of the arguments that determine the tensor, for messages.
    Returns:
        (6, 6), about the origin of the link's frame.
    Raises:
        InputError: The axis is zero, or the tensor is not finite.
    """
    d, c = vector(axis, 3, "axis"), vector(centre, 3, "centre")
    if not np.linalg.norm(d) > 0.0:
        raise InputError(f"axis must be a nonzero vector, got {d}")
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), d / np.linalg.norm(d))
    X = pin.SE3(turn.toRotationMatrix(), c).inverse().toActionMatrix()
    with np.errstate(all="ignore"):
        at_link = np.asarray(X.T @ tensor @ X)
    if not np.isfinite(at_link).all():
        raise InputError(
            f"{sizes}: expected values whose tensor is finite, got one with {tensor.max():g}. "
            "Use other units"
        )
    return at_link


def viscous_form(system: System, drag: Mapping[str, Rod | ArrayLike]) -> ConnectionForm:
    """Return the symmetric form Σ JᵀDJ of the drag forces; for `drag` see `Connection.viscous`."""
    system = checked_system(system, "Connection.viscous")
    tensors = _tensors(system, drag, "drag", "Rod")
    return tensor_form(system, tensors, f"drag forces on '{system.name}'", rotors=False)


def _tensors(system: System, bodies: Mapping[str, Any], what: str, kinds: str) -> list[Array]:
    """Return the tensor of each body of a robot from bodies or tensors by link."""
    if not isinstance(bodies, Mapping) or not bodies:
        raise InputError(f"{what} must be {{link: {kinds} or tensor (6, 6)}}, of at least one link")
    by_link = {
        name: np.asarray(getattr(body, "tensor", body), dtype=float)
        for name, body in bodies.items()
    }
    return tensors_by_body(system, by_link, what)


def tensor_form(system: System, tensors: list[Array], what: str, *, rotors: bool) -> ConnectionForm:
    """Return the symmetric form Σ JᵀDJ that the tensors D of all bodies define.

    Args:
        system: The system.
        tensors: Tensors (6, 6) in joint frames, root first.
        what: Short description for messages.
        rotors: Whether the tensors are inertias, so that the armature of joints is added.
    Returns:
        The form.
    """
    body_tensors = tensors_of(system, tensors)
    armature = np.diag(np.array(system.sorted_model.armature)) if rotors else 0.0

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        return momenta(system, x, v, body_tensors, rotors=rotors)

    def reference(x: Array) -> Array:
        return summed(system, tensors, x) + system.coupled_matrix(np.asarray(armature)) * rotors

    return form_of(
        system.group, system.shape_names, system.units, what, values, reference,
        symmetric=True, momentum=rotors,
        locked=lambda x: locked(system, x, body_tensors, rotors=rotors), space=system.space,
    )  # fmt: skip


@checks_arguments
@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid in a perfect fluid, with the formulas of Lamb, Hydrodynamics, §114 and §373.

    With the volume V, its added mass per density along a is V α/(2 − α), and its added moment of
    inertia about a is (V/5) (b² − c²)² (γ − β) / (2 (b² − c²) + (b² + c²) (β − γ)); the others
    follow by cyclic permutation.

    Attributes:
        semi_axes: Semi-axes a, b, c, (3,) [m].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of a in its link's frame, (3,).
        tensor: Added inertia per density, (6, 6), in its link's frame about the origin.
    """

    semi_axes: ArrayLike
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        axes = vector(self.semi_axes, 3, "semi_axes", ("a", "b", "c"))
        if not (axes > 0.0).all():
            raise InputError(f"semi_axes must be above zero, got {axes}")
        with np.errstate(all="ignore"):
            about_centre = np.diag(np.concatenate(added_masses(axes)))
        tensor = in_link_frame(about_centre, self.centre, self.axis, "semi_axes")
        object.__setattr__(self, "tensor", tensor)


@checks_arguments
@dataclass(frozen=True)
class Ellipse:
    """An elliptic cylinder across the plane of a planar robot, per metre of its height.

    Its added masses per density are π b² along a, and π a² along b.

    Attributes:
        a: Semi-axis along `axis` [m].
        b: Semi-axis perpendicular to `axis` [m].
        centre: Centre in its link's frame, (3,) [m].
        axis: Direction of a in its link's frame, (3,).
        convention: Added moment of inertia per density: "textbook", π/8 (a² − b²)² (Lamb, §71;
            Kelly and Murray), or "sysplotter", (a² − b²)², as in the program of that name.
        tensor: Added inertia per density, (6, 6), in its link's frame about the origin.
    """

    a: float
    b: float
    centre: ArrayLike = (0.0, 0.0, 0.0)
    axis: ArrayLike = (1.0, 0.0, 0.0)
    convention: Literal["textbook", "sysplotter"] = "textbook"
    tensor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        a, b = (np.float64(positive(getattr(self, name), name)) for name in "ab")
        factors = {"textbook": np.pi / 8.0, "sysplotter": 1.0}
        if self.convention not in factors:
            raise InputError(f"convention must be {' or '.join(factors)}, got {self.convention!r}")
        with np.errstate(all="ignore"):
            moment = factors[self.convention] * (a**2 - b**2) ** 2
            about_centre = np.diag([np.pi * b**2, np.pi * a**2, 0.0, 0.0, 0.0, moment])
        tensor = in_link_frame(about_centre, self.centre, self.axis, "a, b")
        object.__setattr__(self, "tensor", tensor)


def added_masses(semi_axes: Array) -> tuple[Array, Array]:
    """Return the added masses [m³] and moments [m⁵] of an ellipsoid per density, (3,) each."""
    from scipy.special import elliprd

    a, b, c = semi_axes
    volume = 4.0 / 3.0 * np.pi * a * b * c
    # α = abc ∫ dλ / ((a² + λ) Δ) is Carlson's R_D, symmetric in its first two arguments.
    squares = semi_axes**2
    alpha = np.array(
        [
            2.0 / 3.0 * a * b * c
            * elliprd(squares[(k + 1) % 3], squares[(k + 2) % 3], squares[k])
            for k in range(3)
        ]
    )  # fmt: skip
    mass = volume * alpha / (2.0 - alpha)
    moment = np.zeros(3)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        difference, total = squares[i] - squares[j], squares[i] + squares[j]
        dalpha = alpha[i] - alpha[j]
        # The moment tends to zero with b − c: a rotationally symmetric body drags no fluid along.
        if abs(difference) > 1e-12 * total:
            denominator = 2.0 * difference + total * dalpha
            moment[k] = volume / 5.0 * difference**2 * -dalpha / denominator
    return mass, moment


def fluid_form(
    system: System, density: float, bodies: Mapping[str, Ellipsoid | Ellipse | ArrayLike]
) -> ConnectionForm:
    """Return the symmetric form of the momenta of a robot and the fluid around it.

    Args:
        system: The system.
        density: Density of the fluid, see `Connection.fluid`.
        bodies: Bodies by link, see `Connection.fluid`.
    Returns:
        The form.
    Raises:
        InputError: There are no bodies.
    """
    system = checked_system(system, "Connection.fluid")
    rho = positive(density, "density")
    added = _tensors(system, bodies, "bodies", "Ellipsoid, Ellipse")
    tensors = [a + rho * b for a, b in zip(inertia_tensors(system), added, strict=True)]
    what = f"the momenta of '{system.name}' and the fluid around it"
    return tensor_form(system, tensors, what, rotors=True)


@checks_arguments
@dataclass(frozen=True)
class Wheel:
    """A wheel, or a pair of wheels on one axle, that does not slip along the axle.

    Attributes:
        link: Name of the link that carries the wheel.
        at: Contact point in the link's frame, (3,) [m].
        axle: Direction of the axle in the link's frame, (3,).
    """

    link: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    axle: ArrayLike = (0.0, 1.0, 0.0)


@checks_arguments
@dataclass(frozen=True)
class Rolling:
    """A wheel that rolls without slipping: its centre moves at radius times its joint's rate.

    Attributes:
        joint: Name of the hinge that rotates the wheel.
        radius: Radius [m].
        link: Name of the link that carries the wheel.
        at: Centre of the wheel in the link's frame, (3,) [m].
        heading: Direction of motion at positive rates in the link's frame, (3,).
    """

    joint: str
    radius: float
    link: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    heading: ArrayLike = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Slip:
    """A constraint: the speed of a point minus `radius` times the rate of a coordinate vanishes.

    Attributes:
        link: The link.
        direction: Direction of the measured speed, (3,), in the joint frame of the link's body.
        point: The point, (3,) [m], in the same frame.
        coordinate: Index of the shape rate, −1 for none.
        radius: Radius [m].
    """

    link: Link
    direction: Array
    point: Array
    coordinate: int
    radius: float


def slips_of(system: System, wheels: Sequence[Wheel | Rolling]) -> list[Slip]:
    """Return the constraints of wheels.  Raises InputError for unknown links or joints."""
    slips = []
    for wheel in wheels:
        if not isinstance(wheel, (Wheel, Rolling)):
            raise InputError(f"wheels must be Wheel or Rolling, got {wheel!r}")
        link = link_named(system, wheel.link, "wheels")
        coordinate, radius = -1, 0.0
        if isinstance(wheel, Rolling):
            d = vector(wheel.heading, 3, "heading")
            coordinate = joint_index(wheel.joint, system.shape_names, "wheels")
            system.space.coordinates_of([coordinate])  # rejects the axes of balls
            radius = positive(wheel.radius, "radius")
        else:
            d = vector(wheel.axle, 3, "axle")
        if not np.linalg.norm(d) > 0.0:
            raise InputError(f"the direction of a wheel on '{wheel.link}' must not be zero")
        direction = link.placement.rotation @ (d / np.linalg.norm(d))
        point = link.placement.act(vector(wheel.at, 3, "at"))
        slips.append(Slip(link, direction, point, coordinate, radius))
    return slips


def slip_rows(system: System, slips: Sequence[Slip], x: ca.SX, v: ca.SX) -> ca.SX:
    """Return the slip speeds of all wheels, (k,), as CasADi expressions; zero without slip.

    Args:
        system: The system.
        slips: The constraints.
        x: Shape symbols, (nx,).
        v: Velocity symbols (ξ, ẋ), (n,).
    Returns:
        Slip speeds, (k,) [m/s].
    """
    bodies, twists = bodies_of(system), twists_at(system, x, v)
    rows = []
    for slip in slips:
        i = slip.link.joint - 1
        row = speed_along(bodies[i], twists[i], slip.direction, slip.point)
        if slip.coordinate >= 0:
            row = row - slip.radius * v[system.r + slip.coordinate]
        rows.append(row)
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *rows)
    return column


def slip_matrix(system: System, slips: Sequence[Slip], x: Array) -> Array:
    """Compute the constraint matrix (W_b, W_s), (k, n), at x (nx,) with Pinocchio's Jacobians."""
    rows = []
    for slip in slips:
        body = Link(slip.link.joint, slip.link.placement.Identity())
        J = link_jacobian(system, body, x)
        row = slip.direction @ (J[:3] - hat(slip.point) @ J[3:])
        if slip.coordinate >= 0:
            row[system.r + slip.coordinate] -= slip.radius
        rows.append(row)
    return np.array(rows).reshape(-1, system.n)


def kinematic_form(system: System, wheels: Sequence[Wheel | Rolling]) -> ConnectionForm:
    """Return the form of slip speeds, for as many wheels as the group has dimensions."""
    system = checked_system(system, "Connection.kinematic")
    slips = slips_of(system, list(wheels))
    if len(slips) != system.r:
        raise InputError(
            f"{system.group.name} has {system.r} dimensions, so a kinematic connection needs "
            f"{system.r} wheels, got {len(slips)}; with fewer, see mixed_connection"
        )
    return form_of(
        system.group, system.shape_names, system.units, f"the wheels of '{system.name}'",
        partial(slip_rows, system, slips), partial(slip_matrix, system, slips), symmetric=False,
        space=system.space,
    )  # fmt: skip

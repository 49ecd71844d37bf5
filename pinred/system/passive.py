"""Springs, dampers, dry friction and limits at joints, as a robot file can state them.

Springs at ball joints are potentials of the attitude R of the child relative to the parent.  With
the rotation vector r = log R and the angle θ = |r|, the laws and their moments in the axes of the
child are

    angle     ½ k θ²             −k r              as in MuJoCo; has a kink at θ = π
    cosine    k (1 − cos θ)      −k sin θ r/θ      smooth everywhere
    vector    ½ rᵀ K r           −J⁻ᵀ K r          J: right Jacobian of the rotation vector
    trace     tr (G (1 − R))     −vee(G R − (G R)ᵀ)

Moments follow from the potentials as expressions of the quaternion.  R is taken relative to the
attitude at rest.

No simulation enforces the limits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias, get_args

import numpy as np
import pinocchio as pin

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, dimensions, positive, read_only
from ..common.errors import InputError, ModelError
from ..common.memo import once
from ..common.names import brief, plain, quoted
from ..common.parameter import Parameter, checked_number, value_of
from .force_interface import Force, Symbols, Terms, finite, settle
from .joints import attitude_of
from .robot_file_contents import Contents, LeftOut
from .system import System, nominal

if TYPE_CHECKING:
    import casadi as ca

# Kinds of actions that pinred does not simulate (LeftOut.what).
BASE = "springs, damping and friction of the base"
MERGED = "springs, damping and friction of merged hinges"
SLIDING = "dry friction against sliding in a plane"
UNEVEN = "dry friction that is not the same in both directions"
POSITION, VELOCITY, EFFORT = ("joint limits", "velocity limits", "effort limits")

LimitKind: TypeAlias = Literal["position", "rate", "effort"]
UNLIMITED = 1.7e308  # position limit that represents infinity; URDF parsers cannot read "inf"
# Added to the squared length of the vector part of a quaternion, so that its root has a derivative.
_TINY = 1e-300


class JointForce(Force):
    """A force at a joint, or between two joints."""

    kind: ClassVar[str]
    joint: str
    to: str | None = None

    @property
    def label(self) -> str:
        """Kind of force and its joint, or both joints."""
        ends = plain(self.joint) if self.to is None else f"{plain(self.joint)}–{plain(self.to)}"
        return f"{self.kind} {ends}"


@checks_arguments
@dataclass(frozen=True)
class Spring(JointForce):
    """A spring with potential V = ½ k y², where y = x − rest, or x − x_to − rest.

    With higher powers, the torque is τ = −(k y + k₂ y² + k₃ y³ + …).

    Attributes:
        joint: Name of the joint.
        stiffness: Stiffness k [N·m/rad | N/m].
        rest: Rest position [rad | m].
        to: Name of the joint at the other end, or None for the joint's own carrier.
        polynomial: Coefficients k₂, k₃, … of higher powers.
    """

    kind: ClassVar[str] = "spring"

    joint: str
    stiffness: float | Parameter
    rest: float | Parameter = 0.0
    to: str | None = None
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        settle(self, "stiffness", "rest")
        _settle_polynomial(self)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the potential.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the potential.
        Raises:
            InputError: The force connects a joint with itself.
        """
        k, j = _ends(self, s)
        length = s.position(k, self.label)
        if j is not None:
            length = length - s.position(j, self.label)
        stretch = length - number(self.rest)
        potential = 0.5 * number(self.stiffness) * stretch * stretch
        power = stretch * stretch
        for k, coefficient in enumerate(self.polynomial, start=3):
            power = power * stretch
            potential += number(coefficient) / k * power
        return Terms(potential=potential)


@checks_arguments
@dataclass(frozen=True)
class Damper(JointForce):
    """A damper with torque τ = −c v, where v = ẋ, or ẋ − ẋ_to between two joints.

    With higher powers, the torque is τ = −v (c + c₂ |v| + c₃ |v|² + …).

    Attributes:
        joint: Name of the joint.
        coefficient: Coefficient c [N·m·s/rad | N·s/m].
        to: Name of the joint at the other end, or None for the joint's own carrier.
        polynomial: Coefficients c₂, c₃, … of higher powers.
    """

    kind: ClassVar[str] = "damper"

    joint: str
    coefficient: float | Parameter
    to: str | None = None
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        settle(self, "coefficient")
        _settle_polynomial(self)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torques.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the torques.
        Raises:
            InputError: The force connects a joint with itself.
        """
        import casadi as ca

        k, j = _ends(self, s)
        v, c = s.xdot[k] if j is None else s.xdot[k] - s.xdot[j], number(self.coefficient)
        for power, coefficient in enumerate(self.polynomial, start=1):
            # Use |v| for odd powers only, so that laws with even powers stay smooth.
            size = v**power if power % 2 == 0 else ca.fabs(v) * v ** (power - 1)
            c = c + number(coefficient) * size
        torque = -c * v
        return Terms(torque={k: torque} if j is None else {k: torque, j: -torque})


@checks_arguments
@dataclass(frozen=True)
class Friction(JointForce):
    """Dry friction at a joint, as the smooth law τ = −most · tanh(ẋ / width).

    At a rate of twice the width, the torque is 96 % of `most`.  Under this law a loaded joint
    creeps where dry friction would hold it at rest.  Friction in a robot file has no width; it
    acts only if the scene sets a width.

    Attributes:
        joint: Name of the joint.
        most: Largest torque [N·m | N].
        width: Rate within which the torque changes its sign [rad/s | m/s], or None.
    """

    kind: ClassVar[str] = "friction"

    joint: str
    most: float | Parameter
    width: float | Parameter | None = None

    def __post_init__(self) -> None:
        settle(self, "most")
        if value_of(self.most) < 0.0:
            most = value_of(self.most)
            raise InputError(f"most of a {self.label} must not be negative, got {most:g}")
        if self.width is not None:
            width = checked_number(self.width, lambda w: positive(w, f"width of a {self.label}"))
            object.__setattr__(self, "width", width)

    def smoothed(self, width: float) -> Friction:
        """Return this friction with a width, so that it acts.

        Args:
            width: Rate within which the torque changes its sign [rad/s | m/s].
        Returns:
            Friction with the width.
        Raises:
            InputError: The width is not positive.
        """
        return replace(self, width=width)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the torque.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the torque.
        Raises:
            InputError: The friction has no width.
        """
        import casadi as ca

        if self.width is None:
            raise InputError(
                f"{self.label} has no width (the rate within which it changes sign). Give one, as "
                "in friction.smoothed(0.01), or simulate(…, friction=0.01) for all friction in the "
                "file."
            )
        k = s.joint(self.joint, self.label)
        return Terms(torque={k: -number(self.most) * ca.tanh(s.xdot[k] / number(self.width))})


def relative_attitude(rest: Array, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return vector part (3,) and real part of rest⁻¹ ∘ q for unit quaternions."""
    import casadi as ca

    u, w = ca.DM(-rest[:3]), float(rest[3])
    v, s = q[:3], q[3]
    return w * v + s * u + ca.cross(u, v), w * s - ca.dot(u, v)


def rotation_vector(vector: ca.SX, real: ca.SX) -> ca.SX:
    """Return the rotation vector, (3,), with θ ≤ π; it has a derivative at zero."""
    import casadi as ca

    n = ca.sqrt(ca.dot(vector, vector) + _TINY)
    sign = ca.if_else(real < 0.0, -1.0, 1.0)
    rotation: ca.SX = sign * 2.0 * ca.atan2(n, sign * real) / n * vector
    return rotation


@checks_arguments
@dataclass(frozen=True, eq=False)
class BallSpring(Force):
    """A spring at a ball joint.

    Attributes:
        joint: Name of the ball joint.
        stiffness: Stiffness k [N·m/rad]; for the laws "vector" and "trace" also a symmetric
            matrix, (3, 3), in the axes of the child.
        rest: Attitude at rest: a rotation vector, (3,) [rad], or a quaternion (x, y, z, w).
        law: "angle" ½ k θ², "cosine" k (1 − cos θ), "vector" ½ rᵀ K r, or "trace" tr (G (1 − R)).
        polynomial: Coefficients k₂, k₃, … of the law "angle", whose moment is then
            −(k + k₂ θ + k₃ θ² + …) r.
    """

    LAWS: ClassVar[tuple[str, ...]] = ("angle", "cosine", "vector", "trace")

    joint: str
    stiffness: Any
    rest: Any = (0.0, 0.0, 0.0)
    law: str = "angle"
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        if self.law not in self.LAWS:
            raise InputError(
                f"law of a {self.label}: expected one of {', '.join(self.LAWS)}, "
                f"got {brief(self.law)}"
            )
        object.__setattr__(self, "rest", attitude_of(self.rest, f"rest of a {self.label}"))
        what = f"stiffness of a {self.label}"
        if isinstance(self.stiffness, Parameter) or dimensions(self.stiffness) == 0:
            object.__setattr__(self, "stiffness", finite(self.stiffness, what))
        else:
            self._check_matrix(what)
        terms = tuple(finite(c, f"polynomial of a {self.label}") for c in self.polynomial)
        if terms and self.law != "angle":
            raise InputError(f"polynomial of a {self.label}: only the law angle has powers")
        object.__setattr__(self, "polynomial", terms)

    def _check_matrix(self, what: str) -> None:
        """Reject a stiffness that is not a symmetric matrix of the law."""
        matrix = as_floats(self.stiffness, what)
        if self.law not in ("vector", "trace") or matrix.shape != (3, 3):
            raise InputError(
                f"{what}: expected a number, or a matrix (3, 3) for the laws vector and trace, got "
                f"{brief(self.stiffness)} for the law {self.law}"
            )
        if not (np.isfinite(matrix).all() and np.array_equal(matrix, matrix.T)):
            raise InputError(f"{what}: expected a finite symmetric matrix, got {brief(matrix)}")
        object.__setattr__(self, "stiffness", read_only(matrix.copy()))

    @property
    def label(self) -> str:
        """Kind of force and its joint."""
        return f"spring {plain(self.joint)}"

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the potential.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the potential.
        Raises:
            InputError: There is no such ball joint.
        """
        import casadi as ca

        q, _ = s.ball(self.joint, self.label)
        vector, real = relative_attitude(self.rest, q)
        matrix = isinstance(self.stiffness, np.ndarray)
        k = ca.DM(self.stiffness) if matrix else number(self.stiffness)
        if self.law == "cosine":
            return Terms(potential=2.0 * k * ca.dot(vector, vector))
        if self.law == "trace":
            # 1 − R = −2 (w û + û²) with û² = u uᵀ − |u|² 1; G is symmetric, so w û drops out.
            G = k if matrix else k * ca.DM.eye(3)
            square = ca.dot(vector, vector) * ca.trace(G)
            return Terms(potential=2.0 * (square - ca.bilin(ca.SX(G), vector, vector)))
        r = rotation_vector(vector, real)
        if self.law == "vector" and matrix:
            return Terms(potential=0.5 * ca.bilin(ca.SX(k), r, r))
        theta = 2.0 * ca.atan2(ca.sqrt(ca.dot(vector, vector) + _TINY), ca.fabs(real))
        potential = 0.5 * k * theta * theta
        for n, coefficient in enumerate(self.polynomial, start=3):
            potential += number(coefficient) / n * theta**n
        return Terms(potential=potential)


def _ends(force: Spring | Damper, s: Symbols) -> tuple[int, int | None]:
    """Return the indices of both joints of a force; the second index is None for one joint."""
    first = s.joint(force.joint, force.label)
    second = None if force.to is None else s.joint(force.to, force.label)
    if first == second:
        raise InputError(f"{force.label}: both ends are the same joint")
    return first, second


def _settle_polynomial(force: Any) -> None:
    """Convert the polynomial of a force to finite numbers or Parameters."""
    what = f"polynomial of a {force.label}"
    message = f"{what} must be a list of numbers, got {force.polynomial!r}"
    if isinstance(force.polynomial, str):
        raise InputError(message)
    try:
        coefficients = tuple(force.polynomial)
    except TypeError:
        raise InputError(message) from None
    object.__setattr__(force, "polynomial", tuple(finite(value, what) for value in coefficients))


def rate_labels(name: str, nv: int) -> tuple[str, ...]:
    """Return the labels of the rates of a hinge or slide (nv = 1), or of the axes of a ball."""
    return (name,) if nv == 1 else tuple(f"{name}.{axis}" for axis in "xyz")


def passive_contents(
    raw: pin.Model,
    shape: Sequence[str],
    locked: Collection[str],
    sliding: Sequence[str] = (),
    springs: Sequence[Spring] = (),
) -> Contents:
    """Return the dampers and dry friction of a model, and the actions that are not simulated.

    Args:
        raw: Model with all joints, as read from a URDF's <dynamics>.
        shape: Names of the shape joints.
        locked: Names of frozen joints.  All remaining joints belong to the base.
        sliding: Names of joints whose dry friction acts against sliding in a plane.
        springs: Springs at joints.
    Returns:
        Contents with `passive` and `left_out`.
    Raises:
        ModelError: A number is not finite.
    """
    forces: list[Force] = []
    base: list[str] = []
    uneven: list[str] = []
    for i in range(1, raw.njoints):
        name, joint = str(raw.names[i]), raw.joints[i]
        entries = slice(joint.idx_v, joint.idx_v + joint.nv)
        damping, most = raw.damping[entries], raw.upperDryFrictionLimit[entries]
        least = raw.lowerDryFrictionLimit[entries]
        numbers = np.concatenate([damping, most, least])
        joint_springs = [spring for spring in springs if spring.joint == name]
        if name in locked or not (joint_springs or numbers.any()):
            continue
        if not np.isfinite(numbers).all():
            raise ModelError(
                f"joint {quoted(name)} has damping or friction that is not a finite number"
            )
        if name not in shape:
            base.append(name)
            continue
        forces += joint_springs
        for label, d, upper, lower in zip(
            rate_labels(name, joint.nv), damping, most, least, strict=True
        ):
            if d:
                forces.append(Damper(label, float(d)))
            if upper != -lower:
                uneven.append(label)
            elif upper:
                forces.append(Friction(label, float(upper)))
    names = {BASE: base, UNEVEN: uneven, SLIDING: sliding}
    left_out = [LeftOut(kind, tuple(joints)) for kind, joints in names.items() if joints]
    return Contents(left_out=tuple(left_out), passive=tuple(forces))


@dataclass(frozen=True)
class StatedLimit:
    """A limit of one joint in the robot's file.

    Attributes:
        joint: Name of the joint.
        kind: "position", "rate" or "effort".
        lower: Lowest value [rad | m | rad/s | m/s | N·m | N].
        upper: Highest value.
    """

    joint: str
    kind: LimitKind
    lower: float
    upper: float


def stated_limits(
    raw: pin.Model, *, locked: Collection[str] = (), merged: Collection[str] = ()
) -> tuple[LeftOut, ...]:
    """Return the limits of the joints that can move, by kind.

    A velocity or effort limit of zero counts as not stated, because the format of URDF demands
    both numbers and many files fill them with zeros.

    Args:
        raw: Model with all joints of the file.
        locked: Names of locked joints, whose limits do not matter.
        merged: Names of hinges that became balls.  Their position limits are listed elsewhere.
    """
    names: dict[str, list[str]] = {POSITION: [], VELOCITY: [], EFFORT: []}
    for i in range(1, raw.njoints):
        name, joint = str(raw.names[i]), raw.joints[i]
        if name in locked:
            continue
        q = slice(joint.idx_q, joint.idx_q + joint.nq)
        v = slice(joint.idx_v, joint.idx_v + joint.nv)
        positions = [raw.lowerPositionLimit[q], raw.upperPositionLimit[q]]
        # Positions that are no angle or length, such as cosines, have bounds by their nature.
        if joint.nq == joint.nv and name not in merged and _has_bound(*positions):
            names[POSITION].append(name)
        if _has_bound(_nonzero(raw.lowerVelocityLimit[v]), _nonzero(raw.upperVelocityLimit[v])):
            names[VELOCITY].append(name)
        if _has_bound(_nonzero(raw.lowerEffortLimit[v]), _nonzero(raw.upperEffortLimit[v])):
            names[EFFORT].append(name)
    return tuple(
        LeftOut(kind, tuple(joints), demanded=True) for kind, joints in names.items() if joints
    )


@dataclass(frozen=True)
class JointLimits:
    """The lowest and highest values of the joints of a shape; infinite where the file states none.

    Attributes:
        position: Positions, (m, 2) [rad | m]; infinite for continuous joints and balls.
        rate: Rates, (m, 2) [rad/s | m/s]; infinite for balls.
        effort: Torques, (m, 2) [N·m | N]; infinite for balls.
    """

    position: Array
    rate: Array
    effort: Array


def joint_limits(system: System) -> JointLimits:
    """Return the limits in a robot's file; a rate or effort limit of zero is none.

    Args:
        system: The robot.
    """
    limits = {kind: np.tile([-np.inf, np.inf], (system.m, 1)) for kind in get_args(LimitKind)}
    rows = {name: k for k, name in enumerate(system.shape_names)}
    for limit in limits_of(system):
        if limit.joint in rows:
            limits[limit.kind][rows[limit.joint]] = limit.lower, limit.upper
    return JointLimits(limits["position"], limits["rate"], limits["effort"])


def _nonzero(limits: Array) -> Array:
    return np.asarray(limits[limits != 0.0])


def _has_bound(*limits: Array) -> bool:
    """Return whether any of the limits is a number instead of an infinity."""
    return any(bool((np.abs(values) < UNLIMITED).any()) for values in limits)


def limits_of_angle(angle: float) -> Array:
    """Return the limits (2, 4) of a ball's quaternion whose rotation has a largest angle [rad]."""
    limits = np.outer([-np.inf, np.inf], np.ones(4))
    if angle < np.pi:  # the largest angle of any rotation
        limits[0, 3] = np.cos(0.5 * angle)
    return limits


def angles_of_balls(system: System) -> dict[str, float]:
    """Return the largest angles of the balls that the robot's file bounds [rad]."""
    model, angles = system.sorted_model, dict[str, float]()
    for ball in system.space.balls:
        least = float(model.lowerPositionLimit[model.joints[model.getJointId(ball.name)].idx_q + 3])
        if 0.0 < least < 1.0:
            angles[ball.name] = 2.0 * float(np.arccos(least))
    return angles


def limits_of(system: System) -> tuple[StatedLimit, ...]:
    """Return the limits of joints with one rate, followers included; see `stated_limits`."""

    def make() -> tuple[StatedLimit, ...]:
        model, limits = system.sorted_model, list[StatedLimit]()
        for i in range(2, model.njoints):
            joint, name = model.joints[i], str(model.names[i])
            if joint.nv != 1:
                continue
            q, v = joint.idx_q, joint.idx_v
            low, high = float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q])
            if joint.nq == 1 and low <= high and (abs(low) < UNLIMITED or abs(high) < UNLIMITED):
                limits.append(StatedLimit(name, "position", low, high))
            most: dict[LimitKind, float] = {
                "rate": float(model.upperVelocityLimit[v]),
                "effort": float(model.upperEffortLimit[v]),
            }
            limits += [StatedLimit(name, k, -m, m) for k, m in most.items() if 0.0 < m < UNLIMITED]
        return tuple(limits)

    return once(nominal(system), StatedLimit, make)

"""Loop constraints φ(q), their Jacobian and its time derivative, of a model or a system.

With the placement X = (R, p) of frame b in frame a, the equations are p = 0 and, for the rotation,
½ vee(R − Rᵀ) = 0 ("6d"), or e_i · R e_k = 0 for both axes i ≠ k ("x", "y", "z" with axis k).  The
relative twist in frame b is V = D v with D = J_b − Ad(X⁻¹) J_a, so

    ṗ = R V_lin,   Ṙ = R V̂_ang,   Ḋ = J̇_b − Ad(X⁻¹) J̇_a + ad(V) Ad(X⁻¹) J_a.

Polynomials between two joints are the constraints φ = x_f − x_f⁰ − Σ c_k (x_l − x_l⁰)^k.
Surfaces of balls are polynomials of quaternions (see BallSurface).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.names import listed, nearest, quoted
from ...lie.group import Group
from ..coordinates import InitialState, ShapeSpace
from ..coupling import Coupled
from ..joints import is_prismatic
from ..robot_file_contents import Keyframe, Origin
from .loop import BallSurface, Constraint, JointPolynomial, Loop, quaternion_parts


class _RowLaw(ABC):
    """The constraint of one equation, with its row of the Jacobian."""

    @abstractmethod
    def row_rate(self, q: Array, v: Array) -> Array:
        """Return the time derivative of the row at velocity v (nv,), (1, nv)."""

    def bias(self, q: Array, v: Array) -> Array:
        """Return the acceleration of the constraint at zero joint acceleration, (1,)."""
        return np.asarray(self.row_rate(q, v) @ v)


class JointLaw(_RowLaw):
    """The constraint of a polynomial, with its row of the Jacobian.

    Attributes:
        is_length: Whether the constraint is a length [m], instead of an angle [rad].
        joints: Indices in the model of follower and leader.
    """

    def __init__(self, model: pin.Model, law: JointPolynomial) -> None:
        """Find the joints of a polynomial in the model."""
        self.joints = tuple(_joint(model, law, name) for name in (law.follower, law.leader))
        follower, leader = (model.joints[i] for i in self.joints)
        self.is_length = is_prismatic(follower)
        self._q, self._v = (follower.idx_q, leader.idx_q), (follower.idx_v, leader.idx_v)
        self._zeros, self._nv = (law.follower_zero, law.leader_zero), int(model.nv)
        self._polynomial = Polynomial(law.coefficients)
        self._slope, self._curvature = self._polynomial.deriv(), self._polynomial.deriv(2)

    def value(self, q: Array) -> Array:
        """Return φ, (1,) [rad | m], at configuration q (nq,)."""
        follower, leader = q[self._q[0]] - self._zeros[0], q[self._q[1]] - self._zeros[1]
        return np.array([follower - self._polynomial(leader)])

    def row(self, q: Array) -> Array:
        """Return the row of the Jacobian, (1, nv)."""
        row = np.zeros((1, self._nv))
        row[0, self._v[0]] = 1.0
        row[0, self._v[1]] -= self._slope(q[self._q[1]] - self._zeros[1])
        return row

    def row_rate(self, q: Array, v: Array) -> Array:
        """Return the time derivative of the row at velocity v (nv,), (1, nv)."""
        rate, leader = np.zeros((1, self._nv)), self._v[1]
        rate[0, leader] = -self._curvature(q[self._q[1]] - self._zeros[1]) * v[leader]
        return rate


class BallLaw(_RowLaw):
    """The constraint of a surface of a ball's attitudes, with its row of the Jacobian.

    Attributes:
        is_length: Whether the constraint is a length [m]; it has no unit.
        joints: Index in the model of the ball.
    """

    is_length = False

    def __init__(self, model: pin.Model, law: BallSurface) -> None:
        """Find the ball in the model."""
        self.joints = (int(model.getJointId(law.ball)),)
        joint = model.joints[self.joints[0]]
        self._q, self._v = (slice(k, k + n) for k, n in ((joint.idx_q, 4), (joint.idx_v, 3)))
        self._nv, (self._S, self._l, self._c) = int(model.nv), law.form

    def value(self, q: Array) -> Array:
        """Return φ, (1,), at configuration q (nq,)."""
        ball = q[self._q]
        return np.array([(0.5 * self._S @ ball + self._l) @ ball - self._c])

    def row(self, q: Array) -> Array:
        """Return the row of the Jacobian, (1, nv)."""
        row = np.zeros((1, self._nv))
        row[0, self._v] = (self._S @ q[self._q] + self._l) @ rates_of_quaternion(q[self._q])
        return row

    def row_rate(self, q: Array, v: Array) -> Array:
        """Return the time derivative of the row at velocity v (nv,), (1, nv)."""
        ball, rate = q[self._q], np.zeros((1, self._nv))
        turn = rates_of_quaternion(ball) @ v[self._v]
        rate[0, self._v] = (self._S @ turn) @ rates_of_quaternion(ball)
        rate[0, self._v] += (self._S @ ball + self._l) @ rates_of_quaternion(turn)
        return rate


def rates_of_quaternion(q: Array) -> Array:
    """Return the map from the rates of a ball to those of its quaternion q (4,), (4, 3)."""
    a, b, c, d = q
    return 0.5 * np.array([[d, -c, b], [c, d, -a], [-b, a, d], [-a, -b, -c]])


def on_surfaces(surfaces: Sequence[BallSurface], q: Array) -> Array:
    """Return the unit quaternion on surfaces of one ball for a quaternion near them, (4,)."""
    parts = [(radius, projector @ q) for projector, radius in quaternion_parts(surfaces)]
    attitude = sum(radius / max(float(np.linalg.norm(p)), 1e-300) * p for radius, p in parts)
    return np.asarray(attitude)


def law_of(model: pin.Model, law: JointPolynomial | BallSurface) -> JointLaw | BallLaw:
    """Return a constraint between joint values, with its row of the Jacobian."""
    return BallLaw(model, law) if isinstance(law, BallSurface) else JointLaw(model, law)


def _joint(model: pin.Model, law: JointPolynomial, name: str) -> int:
    names = [str(n) for n in model.names]
    scalar = [n for i, n in enumerate(names) if i > 1 and model.joints[i].nq == 1]
    if name not in scalar:
        raise InputError(
            f"loops: {quoted(law.name)} needs a hinge or slide {quoted(name)} with one coordinate, "
            f"behind the root; {nearest(name, scalar)}these are {listed(scalar, 60)}"
        )
    return names.index(name)


_LOCAL = pin.ReferenceFrame.LOCAL
_AXES = {"x": 0, "y": 1, "z": 2}
_TYPES = (
    pin.FrameType.BODY,
    pin.FrameType.OP_FRAME,
    pin.FrameType.FIXED_JOINT,
    pin.FrameType.JOINT,
)


@dataclass(frozen=True, eq=False)
class LoopEnd:
    """A frame of a loop.

    Attributes:
        joint: Index in the model of the joint that moves the frame; 0 for the world.
        placement: Placement of the frame in the joint's frame.
    """

    joint: int
    placement: pin.SE3

    @cached_property
    def from_joint(self) -> Array:
        """Matrix that maps twists in the joint's frame to twists in this frame, (6, 6)."""
        return np.asarray(self.placement.toActionMatrixInverse())


def loop_ends(model: pin.Model, loop: Loop) -> tuple[LoopEnd, LoopEnd]:
    """Find the two frames of a loop in a model.

    Args:
        model: Pinocchio model.
        loop: The loop.
    Returns:
        Frames a and b.
    Raises:
        InputError: A frame is unknown, or its name is ambiguous.
    """
    return _find_end(model, loop.frame_a), _find_end(model, loop.frame_b)


def _find_end(model: pin.Model, name: str) -> LoopEnd:
    frame = model.frames[find_frame(model, name)]
    return LoopEnd(int(frame.parentJoint), frame.placement.copy())


def find_frame(model: pin.Model, name: str) -> int:
    """Return the index of the frame that a loop names; links take precedence.

    Args:
        model: Pinocchio model.
        name: Name of a link or frame.
    Raises:
        InputError: The frame is unknown, or its name is ambiguous.
    """
    for kind in _TYPES:
        matches = [k for k, f in enumerate(model.frames) if f.name == name and f.type == kind]
        if len(matches) == 1:
            return matches[0]
        if matches:
            raise InputError(f"loops: the robot has {len(matches)} frames {quoted(name)}")
    links = [str(f.name) for f in model.frames if f.type == pin.FrameType.BODY]
    raise InputError(
        f"loops: no link or frame {quoted(name)}; {nearest(name, links)}the links are "
        f"{listed(links, 60)}"
    )


def rotation_axes(kind: str) -> list[tuple[int, int]]:
    """Return the pairs (i, k) of the equations e_i · R e_k = 0 of an axis kind."""
    k = _AXES[kind]
    return [((k + 1) % 3, k), ((k + 2) % 3, k)]


class FrameLaw:
    """The constraint between two frames of a loop, with its rows of the Jacobian.

    Placements and velocities of the joints are those of a work space, which the caller updates.

    Attributes:
        is_length: Whether each equation is a length [m], instead of an angle [rad], (c,).
    """

    def __init__(self, model: pin.Model, data: pin.Data, loop: Loop) -> None:
        """Find the frames in the model."""
        self._model, self._data, self._kind = model, data, loop.kind
        self._a, self._b = loop_ends(model, loop)
        self._root = int(model.joints[1].nv)
        self.is_length = np.arange(loop.equations) < 3

    def placement(self) -> pin.SE3:
        """Return the placement X of frame b in frame a."""
        a, b, oMi = self._a, self._b, self._data.oMi
        return (oMi[a.joint] * a.placement).actInv(oMi[b.joint] * b.placement)

    def value(self, q: Array) -> Array:  # noqa: ARG002
        """Return φ, (c,) [m | rad], for the placements of the joints."""
        return _values(self._kind, self.placement())

    def row(self, q: Array) -> Array:  # noqa: ARG002
        """Return the rows of the Jacobian, (c, nv), for the Jacobians of the joints."""
        X = self.placement()
        return _rows(self._kind, X.rotation, self._relative(X))

    def row_rate(self, q: Array, v: Array) -> Array:  # noqa: ARG002
        """Return the time derivative of the rows at velocity v (nv,), (c, nv)."""
        X = self.placement()
        R, D = X.rotation, self._relative(X)
        V = D @ v
        Rdot = R @ pin.skew(V[3:])
        return _rows(self._kind, Rdot, D) + _rows(self._kind, R, self._relative_rate(X, V))

    def bias(self, q: Array, v: Array) -> Array:  # noqa: ARG002
        """Return J̇ v, (c,), for the accelerations of the joints."""
        X, a, b = self.placement(), self._a, self._b
        v_joints, a_joints = self._data.v, self._data.a
        V_a, rate_a = (
            X.actInv(a.placement.actInv(twists[a.joint])) for twists in (v_joints, a_joints)
        )
        V_b, rate_b = (b.placement.actInv(twists[b.joint]) for twists in (v_joints, a_joints))
        V = V_b - V_a
        Vdot, V = (rate_b - rate_a + V.cross(V_a)).vector, V.vector
        by_rotation = _rows(self._kind, X.rotation @ pin.skew(V[3:]), V[:, None])
        return (by_rotation + _rows(self._kind, X.rotation, Vdot[:, None]))[:, 0]

    def _relative(self, X: pin.SE3) -> Array:
        """Return D, (6, nv), with the relative twist V = D v in frame b."""
        J_a, J_b = (
            end.from_joint @ pin.getJointJacobian(self._model, self._data, end.joint, _LOCAL)
            for end in (self._a, self._b)
        )
        D = J_b - X.toActionMatrixInverse() @ J_a
        D[:, : self._root] = 0.0  # The root moves both frames alike; this removes round-off.
        return np.asarray(D)

    def _relative_rate(self, X: pin.SE3, V: Array) -> Array:
        """Return Ḋ, (6, nv), at the relative twist V, (6,)."""
        model, data, a, b = self._model, self._data, self._a, self._b
        J_a = a.from_joint @ pin.getJointJacobian(model, data, a.joint, _LOCAL)
        rate_a, rate_b = (
            end.from_joint @ pin.getJointJacobianTimeVariation(model, data, end.joint, _LOCAL)
            for end in (a, b)
        )
        change = X.toActionMatrixInverse()
        rate = rate_b - change @ rate_a + pin.Motion(V).action @ (change @ J_a)
        rate[:, : self._root] = 0.0
        return np.asarray(rate)


class LoopKinematics:
    """The constraints of all loops of a model.  Not thread-safe.

    Attributes:
        loops: The loops.
        rows: Slice of the equations of each loop.
        is_length: Whether each equation is a length [m], instead of an angle [rad], (c,).
    """

    def __init__(self, model: pin.Model, loops: Sequence[Constraint]) -> None:
        """Find the frames and joints of the loops in the model."""
        self.loops = tuple(loops)
        self._model, self._data = model, model.createData()
        self._laws: list[FrameLaw | JointLaw | BallLaw] = [
            FrameLaw(model, self._data, loop) if isinstance(loop, Loop) else law_of(model, loop)
            for loop in loops
        ]
        self._root = int(model.joints[1].nv)
        first = np.cumsum([0, *(loop.equations for loop in loops)]).tolist()
        self.rows = [slice(a, b) for a, b in pairwise(first)]
        self.is_length = np.hstack([np.empty(0, dtype=bool), *(l.is_length for l in self._laws)])

    def placements(self, q: Array) -> list[pin.SE3 | None]:
        """Return the placement of frame b in frame a of each loop at configuration q, (nq,).

        Polynomials of joints have None.
        """
        pin.forwardKinematics(self._model, self._data, q)
        return [law.placement() if isinstance(law, FrameLaw) else None for law in self._laws]

    def values(self, q: Array) -> Array:
        """Return φ(q), (c,) [m | rad | 1]."""
        pin.forwardKinematics(self._model, self._data, q)
        return np.concatenate([law.value(q) for law in self._laws])

    def jacobian(self, q: Array) -> Array:
        """Return the Jacobian J(q), (c, nv), with φ̇ = J v."""
        pin.computeJointJacobians(self._model, self._data, q)
        return np.vstack([law.row(q) for law in self._laws])

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """Return the time derivative of the Jacobian at velocity v (nv,), (c, nv)."""
        pin.computeJointJacobiansTimeVariation(self._model, self._data, q, v)
        return np.vstack([law.row_rate(q, v) for law in self._laws])

    def bias(self, q: Array, v: Array) -> Array:
        """Return J̇ v, (c,): the accelerations of the constraints at zero joint acceleration."""
        beside_root = v.copy()
        beside_root[: self._root] = 0.0  # The root moves both frames alike; this removes round-off.
        pin.forwardKinematics(self._model, self._data, q, beside_root, np.zeros(len(v)))
        return np.concatenate([law.bias(q, v) for law in self._laws])


def _values(kind: str, X: pin.SE3) -> Array:
    R, p = X.rotation, X.translation
    if kind == "3d":
        return np.array(p)
    if kind == "6d":
        return np.concatenate([p, 0.5 * pin.unSkew(R - R.T)])
    return np.append(p, [R[i, k] for i, k in rotation_axes(kind)])


def _rows(kind: str, R: Array, D: Array) -> Array:
    """Return the rows of the Jacobian, which are linear in R and in D."""
    linear = R @ D[:3]
    if kind == "3d":
        return np.asarray(linear)
    if kind == "6d":
        return np.vstack([linear, 0.5 * (np.trace(R) * np.eye(3) - R.T) @ D[3:]])
    turns = [-(R @ pin.skew(np.eye(3)[k]))[i] @ D[3:] for i, k in rotation_axes(kind)]
    return np.vstack([linear, *turns])


T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Closure(FrozenArrays):
    """A closed shape of a robot with loops, and its independent equations.  Arrays are read-only.

    Attributes:
        x: A closed shape, (nx,) [rad | m].
        rows: Indices of independent equations, (k,).
        equations: Number of all equations.
        length: Size of the loops [m].
        least: Smallest singular value of the scaled independent equations at generic shapes.
    """

    x: Array
    rows: Array
    equations: int
    length: float
    least: float

    @property
    def rank(self) -> int:
        """Number of independent equations."""
        return len(self.rows)


class LoopedSystem(Protocol):
    """The members of System on which loops depend; System imports this module."""

    @property
    def sorted_model(self) -> pin.Model: ...  # noqa: D102

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def loops(self) -> tuple[Constraint, ...]: ...  # noqa: D102

    @property
    def closure(self) -> Closure | None: ...  # noqa: D102

    @property
    def group(self) -> Group: ...  # noqa: D102

    @property
    def space(self) -> ShapeSpace: ...  # noqa: D102

    @property
    def tree(self) -> ShapeSpace: ...  # noqa: D102

    @property
    def coupled(self) -> Coupled | None: ...  # noqa: D102

    @property
    def initial(self) -> InitialState | None: ...  # noqa: D102

    @property
    def origin(self) -> Origin | None: ...  # noqa: D102

    @property
    def keyframes(self) -> Mapping[str, Keyframe]: ...  # noqa: D102

    @property
    def r(self) -> int: ...  # noqa: D102

    @property
    def m(self) -> int: ...  # noqa: D102

    @property
    def shape_dim(self) -> int: ...  # noqa: D102

    @property
    def units(self) -> tuple[str, ...]: ...  # noqa: D102

    def workspace(self, key: Hashable, make: Callable[[], T]) -> T: ...  # noqa: D102

    def on_shape(self, forces: Array) -> Array: ...  # noqa: D102

    def joint_rates(self, v: Array) -> Array: ...  # noqa: D102

    def sorted_q(self, pose: Array, x: Array) -> Array: ...  # noqa: D102


def loop_kinematics(system: LoopedSystem) -> LoopKinematics:
    """Return the loop constraints of a system, one object per thread."""
    return system.workspace(
        LoopKinematics, lambda: LoopKinematics(system.sorted_model, system.loops)
    )


def loop_values(system: LoopedSystem, x: Array) -> Array:
    """Return φ(x), (c,) [m | 1], at shape x (nx,)."""
    return loop_kinematics(system).values(configuration(system, x))


def loop_jacobian(system: LoopedSystem, x: Array) -> Array:
    """Return the Jacobian of the loops along the shape rates, (c, m)."""
    J = loop_kinematics(system).jacobian(configuration(system, x))
    return system.on_shape(J)[:, system.r :]


def loop_jacobian_rate(system: LoopedSystem, x: Array, xdot: Array) -> Array:
    """Return the time derivative of the Jacobian at shape rate ẋ (m,), (c, m)."""
    v = system.joint_rates(np.concatenate([np.zeros(system.r), xdot]))
    rate = loop_kinematics(system).jacobian_rate(configuration(system, x), v)
    return system.on_shape(rate)[:, system.r :]


def configuration(system: LoopedSystem, x: Array) -> Array:
    """Return the configuration of the model at shape x (nx,), with the base at the identity."""
    return system.sorted_q(system.group.identity(), x)

"""Free-floating arms: how a hand moves if the base that carries the arm is free.

At zero momentum ξ = −A ẋ, so that the twist of a frame is V = J_b ξ + J_s ẋ = J_g ẋ with the
generalised Jacobian J_g = J_s − J_b A.  Sources: Y. Umetani, K. Yoshida, "Resolved motion rate
control of space manipulators with generalized Jacobian matrix", IEEE Trans. Robotics and
Automation 5 (1989); E. Papadopoulos, S. Dubowsky, "Dynamic singularities in free-floating space
manipulators", J. Dyn. Sys., Meas., Control 115 (1993); D. Nenchev, Y. Umetani, K. Yoshida,
"Analysis of a redundant free-flying spacecraft/manipulator system", IEEE Trans. Robotics and
Automation 8 (1992).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, freeze, read_only, vector, vectors, whole
from ..common.errors import InputError
from ..common.names import joint_index, listed, nearest, quoted
from ..system.system import System, checked_system
from .arm_workspace import Workspace, workspace_of
from .full_reduction import Reduction

Axes = Literal["local", "world"]
_FRAMES = {"local": pin.LOCAL, "world": pin.LOCAL_WORLD_ALIGNED}
_NO_REACTION = 1e-10  # of the largest singular value of A; below it there is none
_SEARCHED = 721  # values of a joint between which roots are looked for


@dataclass(frozen=True)
class Singularity:
    """How far a free-floating arm is from a dynamic singularity at a shape.

    values: (k,) singular values of the task's rows of J_g, the largest first.  determinant: of
    these rows if they are square, else the product of the values.  lost: (k,) unit twist that the
    joints move least, in the task's rows.  joints: (m,) rates that move the hand least.
    """

    values: Array
    determinant: float
    lost: Array
    joints: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def least(self) -> float:
        """Least singular value: 0 at a singularity."""
        return float(self.values[-1])

    @property
    def condition(self) -> float:
        """Largest over least singular value."""
        return float(self.values[0] / self.values[-1]) if self.values[-1] > 0.0 else np.inf


@dataclass(frozen=True, eq=False)
class FloatingArm:
    """The hand of a robot whose base is free.

    frame: name of the hand, a link or any other frame of the model.  task: which rows of its
    twist [linear; angular] matter, by index among the six of space; by default as many of the
    group's as the joints can move: all its motions, or the translations.  Twists of the hand are
    (6,), in its own axes ("local"), or at its origin along the fixed axes ("world").
    """

    system: System
    frame: str
    task: tuple[int, ...] = ()
    _reduction: Reduction = field(init=False, repr=False)
    _id: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        system = checked_system(self.system, "FloatingArm")
        if not isinstance(self.frame, str) or not system.model.existFrame(self.frame):
            names = [frame.name for frame in system.model.frames if frame.parentJoint]
            raise InputError(
                f"no frame {quoted(str(self.frame))} on '{system.name}'; "
                f"{nearest(str(self.frame), names)}the frames are {listed(names)}"
            )
        group = system.group
        linear = tuple(axis for axis in group.axes if axis < 3)
        task = tuple(self.task) or (group.axes if system.m >= group.dim or not linear else linear)
        if not set(task) <= set(range(6)) or len(set(task)) != len(task):
            raise InputError(f"task must be rows of a twist, 0 to 5, each once, got {self.task}")
        object.__setattr__(self, "task", tuple(int(row) for row in task))
        object.__setattr__(self, "_reduction", Reduction(system))
        object.__setattr__(self, "_id", system.model.getFrameId(self.frame))

    def generalized_jacobian(
        self, x: ArrayLike, *, axes: Axes = "local", pose: ArrayLike | None = None
    ) -> Array:
        """J_g = J_s − J_b A, (6, m): twist of the hand per joint rate, at zero momentum.

        pose: of the base, the identity if not given; it matters for world axes only.
        """
        x, g = self._at(x, pose)
        J = self._jacobian(x, g, axes)
        r = self.system.r
        return read_only(J[:, r:] - J[:, :r] @ self._reduction.local_connection(x))

    def rate(
        self, x: ArrayLike, xdot: ArrayLike, *, axes: Axes = "local", pose: ArrayLike | None = None
    ) -> Array:
        """J̇_g = J̇_s − J̇_b A − J_b Ȧ, (6, m), on the horizontal motion ξ = −A ẋ.

        The acceleration of the hand is J_g ẍ + J̇_g ẋ, as that of its twist's entries.
        """
        x, g = self._at(x, pose)
        system, r = self.system, self.system.r
        rates = vector(xdot, system.m, "xdot", system.shape_names)
        at = self._reduction.at(x)
        A, dA = at.local_connection, np.einsum("rab,b->ra", at.dA, rates)
        J = self._jacobian(x, g, axes)
        model, data = system.model, system.data
        q, v = system.model_q(g, x), system.model_v(-A @ rates, rates)
        pin.computeJointJacobiansTimeVariation(model, data, q, v)
        pin.updateFramePlacements(model, data)
        Jdot = pin.getFrameJacobianTimeVariation(model, data, self._id, _FRAMES[axes])
        Jdot = system.on_shape(Jdot)
        return read_only(Jdot[:, r:] - Jdot[:, :r] @ A - J[:, :r] @ dA)

    def drift(
        self, x: ArrayLike, mu: ArrayLike, *, axes: Axes = "local", pose: ArrayLike | None = None
    ) -> Array:
        """J_b I⁻¹ μ, (6,): twist of the hand with frozen joints under body momentum mu (r,)."""
        x, g = self._at(x, pose)
        mu = vector(mu, self.system.r, "mu", self.system.group.twist_names)
        omega = np.linalg.solve(self._reduction.locked_inertia(x), mu)
        return read_only(self._jacobian(x, g, axes)[:, : self.system.r] @ omega)

    def hand_pose(self, x: ArrayLike, *, pose: ArrayLike | None = None) -> pin.SE3:
        """Return the pose of the hand in the world frame, for a pose of the base."""
        x, g = self._at(x, pose)
        model, data = self.system.model, self.system.data
        pin.framesForwardKinematics(model, data, self.system.model_q(g, x))
        return pin.SE3(data.oMf[self._id])

    def singularity(self, x: ArrayLike) -> Singularity:
        """Return singular values of the task's rows of J_g, and what is lost first."""
        J = self.generalized_jacobian(x)[list(self.task)]
        k = min(J.shape)
        if not k:
            raise InputError(f"'{self.system.name}' has no joints to move the hand")
        left, values, right = np.linalg.svd(J)
        square = J.shape[0] == J.shape[1]
        determinant = float(np.linalg.det(J)) if square else float(np.prod(values))
        return Singularity(values, determinant, left[:, k - 1].copy(), right[k - 1].copy())

    def determinants(self, shapes: ArrayLike) -> Array:
        """Return the determinant, as of `singularity`, at shapes (..., m), (...,): a map."""
        system = self.system
        x = vectors(shapes, system.m, "shapes", system.shape_names)
        flat = x.reshape(-1, system.m)
        r, g = system.r, system.group.identity()
        A = self._reduction.grid(flat).local_connection
        J = np.array([self._jacobian(one, g, "local") for one in flat]).reshape(-1, 6, system.n)
        task = (J[..., r:] - J[..., :r] @ A)[:, list(self.task)]
        if task.shape[1] == task.shape[2]:
            out = np.linalg.det(task)
        else:
            out = np.prod(np.linalg.svd(task, compute_uv=False), axis=1)
        return read_only(np.asarray(out).reshape(x.shape[:-1]))

    def singular_values_of(
        self, joint: str, x: ArrayLike, *, limits: tuple[float, float] = (-np.pi, np.pi)
    ) -> Array:
        """Return the values of one joint within limits at which the arm is singular, (K,).

        x: (m,) where the other joints stand.  For as many joints as rows of the task, where the
        determinant changes sign.
        """
        system = self.system
        k = joint_index(joint, system.shape_names, "singular_values_of")
        start = vector(x, system.m, "x", system.shape_names)
        low, high = float(limits[0]), float(limits[1])
        if not low < high:
            raise InputError(f"limits must be (low, high), got {limits}")

        def to(share: float) -> Array:
            out = start.copy()
            out[k] = low + share * (high - low)
            return out

        return read_only(low + (high - low) * self._roots(to))

    def singular_along(self, start: ArrayLike, end: ArrayLike) -> Array:
        """Return the shares of a straight path at which the arm is singular, (K,) in [0, 1]."""
        system = self.system
        a = vector(start, system.m, "start", system.shape_names)
        b = vector(end, system.m, "end", system.shape_names)
        return read_only(self._roots(lambda share: a + share * (b - a)))

    def null_space(self, x: ArrayLike, *, of: Literal["base", "attitude"] = "base") -> Array:
        """Return orthonormal joint rates, (m, k), that do not move the base: the kernel of A.

        of: the whole base, or its attitude only.
        """
        if of not in ("base", "attitude"):
            raise InputError(f"of must be base or attitude, got {of!r}")
        A = self._reduction.local_connection(self._at(x, None)[0])
        if of == "attitude":
            A = A[self.system.group.linear :]
        if not A.size:
            return read_only(np.eye(self.system.m))
        _, values, right = np.linalg.svd(A)
        rank = int((values > _NO_REACTION * max(float(values[0]), 1e-300)).sum())
        return read_only(right[rank:].T.copy())

    def workspace(
        self,
        *,
        limits: Sequence[tuple[float, float]] | None = None,
        samples: int = 121,
        seed: int = 0,
    ) -> Workspace:
        """Return which distances from the centre of mass the hand reaches, and how surely.

        limits: (low, high) of each joint; a whole turn if not given.  samples: of each of one or
        two joints on a grid; of more joints, so many straight lines through their box, of random
        directions (seed).  Singular shapes are found where the determinant changes sign between
        samples, so that ranges are as sure as samples are dense; the reach is found by descent.
        For as many joints as rows of the task.
        """
        system = self.system
        if not system.m or len(self.task) != system.m:
            raise InputError(
                f"workspaces are made for as many joints as rows of the task; there are {system.m} "
                f"and {len(self.task)}"
            )
        given = [(-np.pi, np.pi)] * system.m if limits is None else limits
        bounds = vectors(given, 2, "limits")
        if bounds.shape != (system.m, 2) or not (bounds[:, 0] < bounds[:, 1]).all():
            raise InputError(f"limits must be (low, high) for each of {system.m} joints")
        return workspace_of(
            self._radius, self._radius_slope, self.determinants, bounds,
            whole(samples, "samples", 2), whole(seed, "seed", 0),
        )  # fmt: skip

    def _radius(self, shapes: Array) -> Array:
        """Distance of the hand from the centre of mass, (...,) [m], at shapes (..., m)."""
        system, model, data = self.system, self.system.model, self.system.data
        flat, g = shapes.reshape(-1, system.m), system.group.identity()
        out = np.empty(len(flat))
        for k, x in enumerate(flat):
            q = system.model_q(g, x)
            com = pin.centerOfMass(model, data, q)
            pin.updateFramePlacements(model, data)
            out[k] = np.linalg.norm(data.oMf[self._id].translation - com)
        return out.reshape(shapes.shape[:-1])

    def _radius_slope(self, x: Array) -> Array:
        """Return the derivative of that distance by the joints, (m,), for the base at rest."""
        system, model, data = self.system, self.system.model, self.system.data
        q = system.model_q(system.group.identity(), x)
        arm = pin.jacobianCenterOfMass(model, data, q)
        hand = pin.computeFrameJacobian(model, data, q, self._id, pin.LOCAL_WORLD_ALIGNED)[:3]
        pin.updateFramePlacements(model, data)
        reach = data.oMf[self._id].translation - data.com[0]
        along = reach / max(float(np.linalg.norm(reach)), 1e-300)
        return np.asarray(along @ system.on_shape(hand - arm))[system.r :]

    def _roots(self, to: Callable[[float], Array]) -> Array:
        """Return shares in [0, 1] at which the determinant along a path changes sign."""
        from scipy.optimize import brentq

        if len(self.task) != self.system.m:
            raise InputError(
                f"singular shapes are found for as many joints as rows of the task; there are "
                f"{self.system.m} and {len(self.task)}"
            )

        def det(share: float) -> float:
            return float(self.determinants(to(share)))

        shares = np.linspace(0.0, 1.0, _SEARCHED)
        values = self.determinants(np.array([to(share) for share in shares]))
        out = [float(share) for share in shares[values == 0.0]]
        between = np.flatnonzero(values[:-1] * values[1:] < 0.0)
        out += [float(brentq(det, shares[k], shares[k + 1], xtol=1e-15)) for k in between]
        return np.array(sorted(out))

    def _at(self, x: ArrayLike, pose: ArrayLike | None) -> tuple[Array, Array]:
        system = self.system
        shape = vector(x, system.m, "x", system.shape_names)
        return shape, system.group.identity() if pose is None else system.group.pose(pose)

    def _jacobian(self, x: Array, g: Array, axes: str) -> Array:
        """Return (J_b, J_s), (6, n)."""
        if axes not in _FRAMES:
            raise InputError(f"axes must be {' or '.join(_FRAMES)}, got {axes!r}")
        model, data = self.system.model, self.system.data
        q = self.system.model_q(g, x)
        J = pin.computeFrameJacobian(model, data, q, self._id, _FRAMES[axes])
        return np.asarray(self.system.on_shape(J))

"""The closed shapes of a robot with loops, as the surface on which equilibria are searched.

At a closed shape, N is an orthonormal basis of the displacements that keep the loops closed,
J N = 0.  A step moves along N and then to the nearest closed shape.  With the multipliers λ of the
loops, which make ∂U − Jᵀλ as small as possible, the derivatives of U along the surface are

    gradient Nᵀ ∂U,   Hessian Nᵀ (∂∂U − Σ λ_i ∂∂φ_i) N.

At an equilibrium ∂U = Jᵀλ, so λ are the generalised forces of the loops.
Source: P.-A. Absil, R. Mahony, R. Sepulchre, "Optimization algorithms on matrix manifolds", 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.loop_constraints import constraint_values
from ...system.coordinates import ShapeSpace
from ...system.loops.kinematics import loop_kinematics
from ...system.loops.loop_assembly import CLOSED, loop_gaps, rate_units
from ...system.system import System


def displaced_shape(space: ShapeSpace, x: ca.SX, w: ca.SX) -> ca.SX:
    """Return x exp(w), (nx,), up to terms of second order in w.

    Args:
        space: Manifold of the shapes.
        x: Shape, (nx,).
        w: Displacement along the frame, (m,).
    """
    shape = ca.SX(space.nx, 1)
    for joint in space.joints:
        q, v = x[joint.x.start : joint.x.stop], w[joint.v.start : joint.v.stop]
        if joint.kind.is_ball:
            real = 1.0 - ca.sumsqr(v) / 8.0
            vector = real * q[:3] + 0.5 * (q[3] * v + ca.cross(q[:3], v))
            shape[joint.x] = ca.vertcat(vector, real * q[3] - 0.5 * ca.dot(q[:3], v))
        else:
            shape[joint.x] = q + v
    return shape


_STEPS = 30  # largest number of Gauss–Newton steps to a closed shape
_LONGEST = 0.5  # longest step [rad, or fraction of the loops' length]
_CLOSED = 1e-13  # last step of a closed shape [rad, or fraction of the loops' length]
_SHORTER = (1.0, 0.25, 0.0625)  # fractions of a step that are tried until the loops close
_SAME_GAP = 100.0  # largest gap, relative to that of an assembled loop
_SINGULAR = 1e-6  # least singular value of the equations, relative to that of generic shapes


@dataclass(frozen=True, eq=False)
class LoopSurface:
    """The closed shapes of the active joints of a problem.

    Attributes:
        system: The system, with loops.
        space: Manifold of the active joints.
        active: Indices of the rates of the active joints, (a,).
        active_x: Indices in x of their coordinates.
        rest: Shape that states the other joints, (nx,).
    """

    system: System
    space: ShapeSpace
    active: NDArray[np.intp]
    active_x: Sequence[int]
    rest: Array
    _functions: dict[str, ca.Function] = field(default_factory=dict, repr=False)

    @property
    def rank(self) -> int:
        """Number of independent equations."""
        assert self.system.closure is not None
        return self.system.closure.rank

    def tangents(self, x: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the bases N of closed displacements.

        Args:
            x: Coordinates of the active joints, (N, k).
        Returns:
            N, (N, a, d), and whether the equations are independent, (N,).
        """
        assert self.system.closure is not None
        J = self._evaluated(x)[1]
        _, singular, right = np.linalg.svd(J * self._units)
        regular = singular[:, -1] > _SINGULAR * self.system.closure.least
        bases = np.linalg.qr(self._units[:, None] * np.swapaxes(right[:, self.rank :], 1, 2))[0]
        return bases, regular

    def curvature(self, x: Array, gradient: Array) -> Array:
        """Return Σ λ_i ∂∂φ_i, (N, a, a), with the multipliers of a gradient (N, a)."""
        if not len(x):
            return np.empty((0, self.space.m, self.space.m))
        J = self._evaluated(x)[1]
        multipliers = np.linalg.pinv(np.swapaxes(J, 1, 2)) @ gradient[..., None]
        second = self._second(self._shapes(x).T, multipliers[..., 0].T)
        return np.array(second).T.reshape(len(x), self.space.m, self.space.m)

    def moved(self, x: Array, step: Array) -> Array:
        """Return closed shapes after steps.

        Args:
            x: Closed shapes, coordinates of the active joints (N, k).
            step: Steps along the bases N, (N, d).
        Returns:
            Coordinates, (N, k); x where the loops do not close after the step.
        """
        direction = (self.tangents(x)[0] @ step[..., None])[..., 0]
        result, waiting = x.copy(), np.arange(len(x))
        for fraction in _SHORTER:
            if not len(waiting):
                break
            start = self.space.integrate(x[waiting], fraction * direction[waiting])
            closed, is_closed = self.closed(start)
            result[waiting[is_closed]] = closed[is_closed]
            waiting = waiting[~is_closed]
        return result

    def closed(self, x: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the closed shapes near given shapes, by Gauss–Newton steps of least size.

        Args:
            x: Coordinates of the active joints, (N, k).
        Returns:
            Coordinates, (N, k), and whether the loops close there, (N,).
        """
        x, is_closed = x.copy(), np.zeros(len(x), dtype=bool)
        running = np.flatnonzero(np.isfinite(x).all(axis=1))
        for _ in range(_STEPS):
            if not len(running):
                break
            phi, J = self._evaluated(x[running])
            inverse = np.linalg.pinv(J * self._units, rcond=1e-9)
            step = -(inverse @ phi[..., None])[..., 0]
            size = np.abs(step).max(axis=1)
            step *= (np.minimum(1.0, _LONGEST / np.maximum(size, 1e-300)))[:, None] * self._units
            x[running] = self.space.integrate(x[running], step)
            done = size <= _CLOSED
            is_closed[running[done]] = True
            running = running[~done]
        # The equations of rotations also hold for frames that are half a turn apart.
        is_closed[is_closed] = self.is_closed(x[is_closed])
        return x, is_closed

    def is_closed(self, x: Array) -> NDArray[np.bool_]:
        """Return whether all loops are closed at shapes (N, k), (N,)."""
        assert self.system.closure is not None
        length = self.system.closure.length
        gaps = [loop_gaps(self.system, shape, length).max() for shape in self._shapes(x)]
        return np.array(gaps, dtype=float) <= _SAME_GAP * CLOSED

    def random(self, x: Array, rng: np.random.Generator) -> Array:
        """Return closed shapes near given shapes, (N, k); random copies replace failures."""
        closed, is_closed = self.closed(x)
        assert self.system.closure is not None
        chosen = closed[is_closed]
        if not len(chosen):
            chosen = self.system.closure.x[None, self.active_x]
        closed[~is_closed] = chosen[rng.integers(len(chosen), size=int((~is_closed).sum()))]
        return closed

    @property
    def _units(self) -> Array:
        """Rates that count as one, (a,)."""
        assert self.system.closure is not None
        return rate_units(self.system, self.system.closure.length)[self.active]

    def _shapes(self, x: Array) -> Array:
        shapes = np.tile(self.rest, (len(x), 1))
        shapes[:, self.active_x] = x
        return shapes

    def _evaluated(self, x: Array) -> tuple[Array, Array]:
        """Return φ, (N, c), and J along the active rates, (N, c, a)."""
        count = len(x)
        if not count:
            return np.empty((0, self.rank)), np.empty((0, self.rank, self.space.m))
        phi, J = (np.array(value) for value in self._first(self._shapes(x).T))
        return phi.T, np.swapaxes(J.T.reshape(count, self.space.m, self.rank), 1, 2)

    @property
    def _first(self) -> ca.Function:
        if "first" not in self._functions:
            self._compile()
        return self._functions["first"]

    @property
    def _second(self) -> ca.Function:
        if "second" not in self._functions:
            self._compile()
        return self._functions["second"]

    def _compile(self) -> None:
        """Differentiate φ along displacements w of the active joints at w = 0."""
        system = self.system
        x, w = ca.SX.sym("x", system.nx), ca.SX.sym("w", system.m)
        multipliers = ca.SX.sym("multipliers", self.rank)
        entries = ca.vertsplit(displaced_shape(system.space, x, w))
        assert system.closure is not None
        is_length = loop_kinematics(system).is_length[system.closure.rows]
        weights = np.where(is_length, 1.0 / system.closure.length, 1.0)
        values = constraint_values(system, bodies_of(system), entries)
        phi = ca.vertcat(*(c * value for c, value in zip(weights.tolist(), values, strict=True)))
        J = ca.jacobian(phi, w)[:, self.active.tolist()]
        H = ca.hessian(ca.dot(phi, multipliers), w)[0]
        H = H[self.active.tolist(), self.active.tolist()]
        at_zero = [ca.substitute(term, w, ca.SX.zeros(system.m)) for term in (phi, J, H)]
        phi, J, H = (ca.densify(term) for term in at_zero)
        options = {"cse": True}
        self._functions["first"] = ca.Function("first", [x], [phi, ca.vec(J)], options)
        self._functions["second"] = ca.Function("second", [x, multipliers], [ca.vec(H)], options)

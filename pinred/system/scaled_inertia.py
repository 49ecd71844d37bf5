"""A scaled inertia of a joint over shapes, whose zeros are singular shapes of the mass matrix."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.rotations import left_jacobian, quaternion_exp
from .joints import axes_of, is_prismatic
from .massless_motions import largest_step

# Number of random shapes.  A motion that moves no mass at these shapes moves none at any shape.
SHAPES = 4
_EXAMPLES = 4  # largest number of singular shapes that a message names
_CORNERS = 64  # largest number of starting shapes made of quarter turns
_DESCENTS = 10  # number of minimisations from the best corners, and also from random shapes
_EVALUATIONS = 3000  # largest number of mass matrices per search, which take about 0.3 s
_SAMPLES = 32  # number of random shapes that determine the typical inertia of a joint
_FAR = 100.0  # largest value of prismatic joints, in units of the largest step of the tree
LOST = 1e-11  # scaled inertias below count as zero, given the decimals of numbers in a file
_SMALLEST = 1e-12  # smallest inertia, relative to the robot's, that is scaled to one
_LEADING = 0.1  # a joint takes part in a motion if its entry exceeds this fraction of the largest


@dataclass(frozen=True)
class SingularShape:
    """A shape at which a joint moves no mass.

    Attributes:
        joint: Name of the joint.
        at: Values of the joints on which the singularity depends, {joint: value} [rad | m].  A ball
            has the entries of its rotation vector, {"neck.x": value}.
    """

    joint: str
    at: Mapping[str, float]


class ScaledInertia:
    """A scaled inertia s(y) over shapes y that is zero where the mass matrix is singular.

        s(y) = min uᵀ H u,  u = P w,  |w| = 1 in the first `bound` entries of w

    H is the mass matrix, P spans the admissible velocities u, and w are scaled coordinates.  The
    minimum is over all entries of w; those after the first `bound` are free.  For a single joint,
    its descendant joints are free, so s is zero where the joint moves no mass.  For coupled joints,
    P = G and no entry is free, so s is the smallest eigenvalue of GᵀHG.
    """

    def __init__(
        self, model: pin.Model, joints: Sequence[int], P: Array, offset: Array, bound: int
    ) -> None:
        """Determine the typical inertias, which scale the entries of w.

        Args:
            model: Model; it is copied.
            joints: Index of the first joint, then indices of the joints with values y, (m,): a
                number for a hinge or slide, a rotation vector for a ball.
            P: Basis of admissible velocities, (nv, k): the first joint's columns, then the others'.
            offset: Values of all joints at y = 0, (nv,) [rad | m]; zero for balls.
            bound: Number of leading entries of w with unit norm; the other entries are free.
        """
        self._model = model.copy()
        self._model.gravity.setZero()
        self._data = self._model.createData()
        self._P, self._offset, self._bound = P, offset, bound
        first, *others = joints
        self._lead = int(model.joints[first].nv)
        widths = [int(model.joints[k].nv) for k in others]
        names = [str(model.names[k]) for k in others]
        self._names = [
            name if width == 1 else f"{name}.{axis}"
            for name, width in zip(names, widths, strict=True)
            for axis in "xyz"[:width]
        ]
        self._entry_names = [str(model.names[first])] * self._lead + self._names
        self._slides = np.repeat([is_prismatic(model.joints[k]) for k in others], widths) > 0
        self._hinges = ~self._slides & (np.repeat(widths, widths) == 1)
        behind = list(model.joints)[2:]
        self._balls = [joint for joint in behind if joint.nv == 3]
        lines = [(joint.idx_q, joint.idx_v) for joint in behind if (joint.nq, joint.nv) == (1, 1)]
        turns = [(joint.idx_q, joint.idx_v) for joint in behind if (joint.nq, joint.nv) == (2, 1)]
        # Indices in q and v of joints with one coordinate, and with a cosine and a sine.
        self._lines = np.array(lines, dtype=np.intp).reshape(-1, 2).T
        self._circles = np.array(turns, dtype=np.intp).reshape(-1, 2).T
        self._neutral: Array = np.array(pin.neutral(model))
        self._reach = largest_step(model)
        self._evaluations = 0
        self._usual: Array = np.ones(P.shape[1])
        rng = np.random.default_rng(1)
        starts = [self._configuration(self._random(rng)) for _ in range(_SAMPLES)]
        samples = [np.diag(self._matrix(q)) for q in starts]
        # Inertias below the round-off of the robot's inertia must not be scaled to 1.
        is_turn = np.append(axes_of(model.joints[first])[3:].any(axis=0), ~self._slides)
        mass = sum(body.mass for body in list(model.inertias)[1:])
        natural = mass * np.where(is_turn, self._reach**2, 1.0)
        self._usual = np.sqrt(np.maximum(np.max(samples, axis=0), _SMALLEST * natural))

    def massless_joints(self, tolerance: float) -> tuple[str, ...]:
        """Return the joints to lock so that the matrix is regular at one random shape or more."""
        rng = np.random.default_rng(0)
        matrices = [self._matrix(self._configuration(self._random(rng))) for _ in range(SHAPES)]
        free, names = list(range(self._bound)), []
        while free:
            pairs = [np.linalg.eigh(H[np.ix_(free, free)]) for H in matrices]
            values, directions = max(pairs, key=lambda pair: float(pair[0][0]))
            if values[0] > tolerance:
                break
            k = free[_last_entry(directions[:, 0])]
            free.remove(k)
            names.append(self._entry_names[k])
        return tuple(names)

    def search(self) -> list[SingularShape]:
        """Return examples of shapes y at which s(y) is zero."""
        if not self._names:
            return []
        rng = np.random.default_rng(0)
        quarters = [(0.0,) if s else (0.0, np.pi / 2, np.pi, -np.pi / 2) for s in self._slides]
        corners = itertools.islice(itertools.product(*quarters), _CORNERS)
        starts = sorted(map(np.array, corners), key=lambda y: self._at(y)[0])[:_DESCENTS]
        starts += [self._random(rng) for _ in range(_DESCENTS)]
        shapes: list[SingularShape] = []
        for start in starts:
            y = self._descend(start)
            # Skip distant slides, where typical inertias are negligible and s is small everywhere.
            if (np.abs(y[self._slides]) <= _FAR * self._reach).all() and self._vanishes(y):
                _, _, w = self._least(y)
                name = self._entry_names[_last_entry(w[: self._bound])]
                shape = SingularShape(name, self._deciding_values(y, rng))
                if shape not in shapes:
                    shapes.append(shape)
            if self._evaluations > _EVALUATIONS or len(shapes) >= _EXAMPLES:
                break
        return shapes

    def _random(self, rng: np.random.Generator) -> Array:
        y = rng.uniform(-np.pi, np.pi, len(self._names))
        return np.asarray(np.where(self._slides, y * self._reach / np.pi, y))

    def _vanishes(self, y: Array) -> bool:
        return self._at(y)[0] <= LOST

    def _descend(self, y: Array) -> Array:
        """Minimise s locally, starting from y; return the minimiser."""
        if self._vanishes(y):
            return y
        from scipy.optimize import minimize

        # Use SciPy's Python BFGS; the Fortran version starts threads even for few unknowns.
        options = {"gtol": 1e-12, "maxiter": 80}
        # Derivatives may overflow where the inertia of a descendant joint is zero.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(minimize(self._at, y, jac=True, method="BFGS", options=options).x)

    def _deciding_values(self, y: Array, rng: np.random.Generator) -> dict[str, float]:
        """Return {joint: value} for the joints on which the zero of s at y depends."""
        irrelevant = np.zeros(len(y), dtype=bool)
        for k in range(len(y)):
            other = y.copy()
            other[k] += 1.1 * (self._reach if self._slides[k] else 1.0)
            irrelevant[k] = self._vanishes(other)
        if not self._vanishes(np.where(irrelevant, self._random(rng), y)):
            irrelevant[:] = False
        wrapped = np.where(self._hinges, np.arctan2(np.sin(y), np.cos(y)), y)
        return {
            name: round(float(value), 6) + 0.0
            for name, value, skip in zip(self._names, wrapped, irrelevant, strict=True)
            if not skip
        }

    def _at(self, y: Array) -> tuple[float, Array]:
        """Return s(y) and its gradient (m,)."""
        value, q, w = self._least(y)
        if not np.isfinite(value):
            return value, np.zeros(len(y))
        u, still = self._P @ (w / self._usual), np.zeros(self._model.nv)
        slope = pin.computeRNEADerivatives(self._model, self._data, q, still, u)[0]
        along = u @ slope
        for ball in self._balls:  # derivatives along the axes of a ball, by its rotation vector
            at = slice(ball.idx_v, ball.idx_v + 3)
            along[at] = along[at] @ left_jacobian(-self._values(y)[at])
        return value, np.asarray(along @ self._P[:, self._lead :])

    def _least(self, y: Array) -> tuple[float, Array, Array]:
        """Return s(y), Pinocchio's q, and the minimising scaled motion w, (k,)."""
        q, b = self._configuration(y), self._bound
        H = self._matrix(q)
        behind = H[b:, b:]
        size = np.sqrt(np.maximum(np.diag(behind), 1e-300))
        scaled = behind / np.outer(size, size)
        if not np.isfinite(scaled).all():  # The line search overflowed.
            return np.inf, q, np.zeros(len(H))
        # The pseudo-inverse allows for descendant joints whose inertia is zero at this shape.
        values, vectors = np.linalg.eigh(scaled)
        kept = np.abs(values) > 1e-14 * np.abs(values).max(initial=0.0)
        inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
        follow = -inverse @ (H[b:, :b] / size[:, None])
        U = np.vstack([np.eye(b), follow / size[:, None]])
        S = U.T @ H @ U
        values, directions = np.linalg.eigh(0.5 * (S + S.T))
        return float(values[0]), q, U @ directions[:, 0]

    def _matrix(self, q: Array) -> Array:
        """Return PᵀHP at a configuration, scaled by the typical inertias, (k, k)."""
        self._evaluations += 1
        upper: Array = np.triu(pin.crba(self._model, self._data, q))
        H = self._P.T @ ((upper + np.triu(upper, 1).T) @ self._P)
        return np.asarray(H / np.outer(self._usual, self._usual))

    def _configuration(self, y: Array) -> Array:
        q, values = self._neutral.copy(), self._values(y)
        q[self._lines[0]] = values[self._lines[1]]
        at, angles = self._circles[0], values[self._circles[1]]
        q[at], q[at + 1] = np.cos(angles), np.sin(angles)
        for ball in self._balls:
            value = values[ball.idx_v : ball.idx_v + 3]
            q[ball.idx_q : ball.idx_q + 4] = quaternion_exp(value)
        return q

    def _values(self, y: Array) -> Array:
        """Return the values of all joints, (nv,)."""
        return np.asarray(self._offset + self._P[:, self._lead :] @ y)


def _last_entry(motion: Array) -> int:
    """Return the index of the last entry of a motion that is not negligible."""
    size = np.abs(motion)
    return int(np.flatnonzero(size > _LEADING * size.max())[-1])

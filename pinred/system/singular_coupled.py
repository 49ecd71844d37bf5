"""At which shapes the mass matrix of coupled joints, GᵀHG, is singular.

Asked only of trees that are not regular with all joints free.  A motion of coupled joints that
moves no mass is one of the whole tree, which the rule over subspaces does not know of; so the
matrix itself is looked at: at random shapes, and where descents of its least part end.
"""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from ..common.arrays import Array
from .coupling import Coupled
from .joints import axes_of, is_prismatic
from .massless_motions import largest_step
from .singular_shapes import SingularShape, SingularShapes

_SHAPES = 4  # random ones; a motion that moves no mass at all of them moves none at any
_EXACT = 1e-13  # of the matrix, each joint scaled by its own inertia, below which it is round-off
_NEARLY = 1e-11  # the same for the decimals of a file, and where a descent ends
_SMALLEST = 1e-12  # of the robot's inertia, that of a joint that counts as one of its own
_LEADING = 0.1  # of a motion's largest part: the last joint that has as much is named
_CORNERS = 256
_DESCENTS = 8  # from shapes whose angles are quarter turns, and from random ones
_EVALUATIONS = 3000
_EXAMPLES = 4


def coupled_singular_shapes(model: pin.Model, coupled: Coupled) -> SingularShapes:
    """Return where GᵀHG is singular; joint 1 of the model is the root."""
    least = _Least(model, coupled)
    rng = np.random.default_rng(0)
    shapes = [least.random(rng) for _ in range(_SHAPES)]
    least.scale_by(shapes)
    everywhere = least.at_all(shapes, _EXACT)
    if everywhere:
        return SingularShapes(everywhere=everywhere)
    if nearly := least.at_all(shapes, _NEARLY):
        return SingularShapes(nearly=nearly)
    found: list[SingularShape] = []
    corners = sorted(least.corners(), key=lambda y: least.at(y)[0])[:_DESCENTS]
    for start in [*corners, *(least.random(rng) for _ in range(_DESCENTS))]:
        end = least.descend(start)
        if least.at(end)[0] <= _NEARLY and (shape := least.named(end)) not in found:
            found.append(shape)
        if least.evaluations > _EVALUATIONS or len(found) >= _EXAMPLES:
            break
    return SingularShapes(isolated=tuple(found))


class _Least:
    """The least part of GᵀHG over shapes y (m,), each coordinate scaled by its usual inertia."""

    def __init__(self, model: pin.Model, coupled: Coupled) -> None:
        self._model = model.copy()
        self._model.gravity.setZero()
        self._data = self._model.createData()
        self._coupled, self._r = coupled, int(model.joints[1].nv)
        self._neutral: Array = np.array(pin.neutral(model))
        leads = [2 + j for j in coupled.leads.tolist()]
        joints = [model.joints[i] for i in leads]
        self._names = [str(model.names[i]) for i in leads]
        self._slides = np.array([is_prismatic(joint) for joint in joints], dtype=bool)
        self._reach = largest_step(model)
        self._size: Array = np.ones(self._r + len(joints))
        self.evaluations = 0

    def random(self, rng: np.random.Generator) -> Array:
        """Return a random shape."""
        y = rng.uniform(-np.pi, np.pi, len(self._names))
        return np.asarray(np.where(self._slides, y * self._reach / np.pi, y))

    def corners(self) -> list[Array]:
        """Return shapes whose angles are quarter turns and whose slides are at zero."""
        quarters = [(0.0,) if s else (0.0, np.pi / 2, np.pi, -np.pi / 2) for s in self._slides]
        return [np.array(c) for c in itertools.islice(itertools.product(*quarters), _CORNERS)]

    def scale_by(self, shapes: list[Array]) -> None:
        """Take the largest inertia of each coordinate at some shapes for its usual one.

        What is round-off of the robot's mass, at the distance of its largest step, is not scaled.
        """
        largest = np.max([np.diag(self._matrix(y)) for y in shapes], axis=0)
        turns = axes_of(self._model.joints[1])[3:].any(axis=0)
        turns = np.append(turns, ~self._slides)
        mass = sum(body.mass for body in list(self._model.inertias)[1:])
        natural = mass * np.where(turns, self._reach**2, 1.0)
        self._size = np.sqrt(np.maximum(largest, _SMALLEST * natural))

    def at_all(self, shapes: list[Array], tolerance: float) -> tuple[str, ...]:
        """Return the joints to lock so that the matrix is regular at one of the shapes at least."""
        scale = np.outer(self._size, self._size)
        matrices = [self._matrix(y) / scale for y in shapes]
        left, found = list(range(len(self._size))), []
        while left:
            parts = [np.linalg.eigh(H[np.ix_(left, left)]) for H in matrices]
            values, directions = max(parts, key=lambda part: float(part[0][0]))
            if values[0] > tolerance:
                break
            k = left[self._leading(directions[:, 0])]
            left.remove(k)
            found.append(self._name(k))
        return tuple(found)

    def at(self, y: Array) -> tuple[float, Array]:
        """Return the least part, and its gradient (m,)."""
        values, directions = np.linalg.eigh(self._matrix(y) / np.outer(self._size, self._size))
        u = self._coupled.rates(directions[:, 0] / self._size, self._r)
        rest = np.zeros(self._model.nv)
        slope = pin.computeRNEADerivatives(self._model, self._data, self._q(y), rest, u)[0]
        return float(values[0]), self._coupled.forces(u @ slope, self._r)[self._r :]

    def descend(self, y: Array) -> Array:
        """Return where a descent from y ends."""
        # BFGS in Python: that in Fortran starts threads even for these few numbers.
        options = {"gtol": 1e-12, "maxiter": 80}
        return np.asarray(minimize(self.at, y, jac=True, method="BFGS", options=options).x)

    def named(self, y: Array) -> SingularShape:
        """Return who moves no mass at y, and the values of the joints that decide it."""
        _, directions = np.linalg.eigh(self._matrix(y) / np.outer(self._size, self._size))
        who = self._leading(directions[:, 0])
        decides = [k for k in range(len(y)) if self._decides(y, k)] or list(range(len(y)))
        turned = np.where(self._slides, y, np.arctan2(np.sin(y), np.cos(y)))
        at = {self._names[k]: round(float(turned[k]), 6) + 0.0 for k in decides}
        return SingularShape(self._name(who), at)

    def _decides(self, y: Array, k: int) -> bool:
        other = y.copy()
        other[k] += 1.1 * (self._reach if self._slides[k] else 1.0)
        return self.at(other)[0] > _NEARLY

    def _leading(self, motion: Array) -> int:
        part = np.abs(motion)
        return int(np.flatnonzero(part > _LEADING * part.max())[-1])

    def _name(self, k: int) -> str:
        return str(self._model.names[1]) if k < self._r else self._names[k - self._r]

    def _matrix(self, y: Array) -> Array:
        self.evaluations += 1
        upper: Array = np.triu(pin.crba(self._model, self._data, self._q(y)))
        return self._coupled.matrix(upper + np.triu(upper, 1).T, self._r)

    def _q(self, y: Array) -> Array:
        q = self._neutral.copy()
        for value, joint in zip(self._coupled.values(y), list(self._model.joints)[2:], strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            )
        return q

"""A bounded search for shapes at which a joint moves no mass, where several angles decide.

Made least is the inertia that a joint has left when all joints behind it are free to move,

    s(x) = min uᵀ H u  with u = 1 at the joint (a unit twist, at the root),

which is zero exactly where the joint moves no mass.  Descents start from shapes whose angles
are quarter turns, where what people draw is singular, and from random ones.
"""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from ..common.arrays import Array
from .joints import is_prismatic

_EVALUATIONS = 3000  # of the mass matrix: some tenths of a second
_CORNERS = 64
_DESCENTS = 10  # from corners, and from random shapes
_SAMPLES = 32  # random shapes from which the joint's usual inertia is taken
_FAR = 100.0  # times the largest step of the subtree
_LOST = 1e-11  # of the usual inertia: the square of the decimals of a file


def search(model: pin.Model, joint: int, most: int) -> list[dict[str, float]]:
    """Return up to `most` shapes, as values by joint name, at which a joint moves no mass.

    joint: 0 for the root, k for the model's joint k + 1.  Values of joints that do not matter
    are left out.
    """
    left = _Left(model, joint)
    if not left.behind:
        return []
    rng = np.random.default_rng(0)
    corners = sorted(left.corners(), key=lambda x: left.at(x)[0])
    starts = corners[:_DESCENTS] + [left.random(rng) for _ in range(_DESCENTS)]
    found: list[dict[str, float]] = []
    for start in starts:
        end = left.descend(start)
        if not left.within(end):
            continue
        if left.at(end)[0] <= _LOST and (values := left.named(end, rng)) not in found:
            found.append(values)
        if left.evaluations > _EVALUATIONS or len(found) >= most:
            break
    return found


class _Left:
    """The inertia that a joint has left, over the values of the joints behind it."""

    def __init__(self, model: pin.Model, joint: int) -> None:
        """Find the joints behind it, and its usual inertia."""
        self._model = model.copy()
        self._model.gravity.setZero()
        self._data = pin.Data(self._model)
        self._neutral: Array = np.array(pin.neutral(model))
        subtree = [int(k) for k in model.subtrees[joint + 1]]
        self.behind = [k for k in subtree if k != joint + 1]
        first = model.joints[joint + 1]
        self._own = first.nv
        self._rows = np.array(
            [first.idx_v + k for k in range(first.nv)]
            + [model.joints[k].idx_v for k in self.behind]
        )
        self._slides = np.array([is_prismatic(model.joints[k]) for k in self.behind], dtype=bool)
        steps = [np.linalg.norm(model.jointPlacements[k].translation) for k in subtree]
        self._reach = max(steps) or 1.0
        self.evaluations = 0
        self._usual = np.ones(first.nv)
        rng = np.random.default_rng(1)
        inertias = []
        for _ in range(_SAMPLES):
            H = self._matrix(self.random(rng))
            inertias.append(np.diag(H)[: self._own])
        self._usual = np.sqrt(np.max(inertias, axis=0))

    def corners(self) -> list[Array]:
        """Return shapes whose angles are quarter turns and whose slides are at zero."""
        quarters = [(0.0,) if s else (0.0, np.pi / 2, np.pi, -np.pi / 2) for s in self._slides]
        return [np.array(c) for c in itertools.islice(itertools.product(*quarters), _CORNERS)]

    def descend(self, x: Array) -> Array:
        """Return where a descent from x ends."""
        if self.at(x)[0] <= _LOST:
            return x
        # BFGS in Python: that in Fortran starts threads even for these few numbers.
        options = {"gtol": 1e-9, "maxiter": 80}
        # Where a joint behind it has lost its own inertia, slopes may be beyond all numbers.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(minimize(self.at, x, jac=True, method="BFGS", options=options).x)

    def within(self, x: Array) -> bool:
        """Return whether slides are where a robot is: far out, other inertias are none."""
        return bool((np.abs(x[self._slides]) <= _FAR * self._reach).all())

    def at(self, x: Array) -> tuple[float, Array]:
        """Return the inertia left over the usual one, and its gradient (k,)."""
        own = self._own
        H = self._matrix(x)
        rest = H[own:, own:]
        size = np.sqrt(np.maximum(np.diag(rest), 1e-300))
        scaled = rest / np.outer(size, size)
        if not np.isfinite(scaled).all():  # a step beyond all numbers is one too far
            return np.inf, np.zeros(len(x))
        # Joints behind it may have lost their own inertia here.
        follow = -np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) @ (
            H[own:, :own] / size[:, None]
        )
        U = np.vstack([np.eye(own), follow / size[:, None]])
        S = (U.T @ H @ U) / np.outer(self._usual, self._usual)
        values, directions = np.linalg.eigh(0.5 * (S + S.T))
        u = np.zeros(self._model.nv)
        u[self._rows] = U @ (directions[:, 0] / self._usual)
        slope = pin.computeRNEADerivatives(
            self._model, self._data, self._q(x), np.zeros(self._model.nv), u
        )[0]
        gradient = u @ slope[:, self._rows[own:]]
        return float(values[0]), np.asarray(gradient)

    def named(self, x: Array, rng: np.random.Generator) -> dict[str, float]:
        """Return the values, by name, of the joints that decide that the inertia is lost at x."""
        free = np.zeros(len(x), dtype=bool)
        for k in range(len(x)):
            other = x.copy()
            other[k] += 1.1 * (self._reach if self._slides[k] else 1.0)
            free[k] = self.at(other)[0] <= _LOST
        everything = np.where(free, self.random(rng), x)
        if self.at(everything)[0] > _LOST:
            free[:] = False
        turned = np.where(self._slides, x, np.arctan2(np.sin(x), np.cos(x)))
        return {
            str(self._model.names[k]): round(float(turned[j]), 6) + 0.0
            for j, k in enumerate(self.behind)
            if not free[j]
        }

    def _matrix(self, x: Array) -> Array:
        self.evaluations += 1
        upper: Array = np.triu(pin.crba(self._model, self._data, self._q(x)))
        return np.asarray((upper + np.triu(upper, 1).T)[np.ix_(self._rows, self._rows)])

    def _q(self, x: Array) -> Array:
        q = self._neutral.copy()
        for value, k in zip(x, self.behind, strict=True):
            joint = self._model.joints[k]
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            )
        return q

    def random(self, rng: np.random.Generator) -> Array:
        """Return a random shape."""
        x = rng.uniform(-np.pi, np.pi, len(self.behind))
        return np.asarray(np.where(self._slides, x * self._reach / np.pi, x))

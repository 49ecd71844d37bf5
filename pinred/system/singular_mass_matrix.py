"""Detect shapes at which a mass matrix is singular: every shape, isolated examples, or none.

Random shapes show whether a joint moves no mass at every shape.  Subspaces that contain the
massless motions at every shape prove that the matrix is regular (`bound_massless_twists`).  If
singularity depends on child joints only, closed forms provide the joint values.  In all other
cases, local minimisation from quarter turns and from random shapes searches for examples (only in
trees without balls).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from ..common.arrays import Array
from .coupling import Coupled
from .joints import axes_of, is_prismatic, joint_configuration
from .massless_motions import (
    EXACT,
    NEARLY,
    Tree,
    bound_massless_twists,
    intersect,
    largest_step,
    massless_twists,
    moves_no_mass,
    tree_of,
    undoing_twists,
)

# Number of random shapes.  A motion that moves no mass at these shapes moves none at any shape.
_SHAPES = 4
_EXAMPLES = 4  # largest number of singular shapes that a message names
_CORNERS = 64  # largest number of starting shapes made of quarter turns
_DESCENTS = 10  # number of minimisations from the best corners, and also from random shapes
_EVALUATIONS = 3000  # largest number of mass matrices per search, which take about 0.3 s
_SAMPLES = 32  # number of random shapes that determine the typical inertia of a joint
_FAR = 100.0  # largest value of prismatic joints, in units of the largest step of the tree
# Scaled inertias below these limits count as zero: _LOST_EXACT allows for round-off, _LOST for the
# decimals of numbers in a file.
_LOST_EXACT, _LOST = 1e-13, 1e-11
_SMALLEST = 1e-12  # smallest inertia, relative to the robot's, that is scaled to one
_LEADING = 0.1  # a joint takes part in a motion if its entry exceeds this fraction of the largest


@dataclass(frozen=True)
class SingularShape:
    """A shape at which a joint moves no mass.

    Attributes:
        joint: Name of the joint.
        at: Values of the joints on which the singularity depends, {joint: value} [rad | m].
    """

    joint: str
    at: Mapping[str, float]


@dataclass(frozen=True)
class SingularShapes:
    """Shapes at which a mass matrix is singular.

    Attributes:
        everywhere: Names of joints that move no mass at any shape.  If these joints are locked,
            the matrix is regular at most shapes.
        nearly: Joints that move no mass at any shape if the decimals of a file are not exact.
        isolated: Examples of isolated singular shapes; always empty for trees with balls.
    """

    everywhere: tuple[str, ...] = ()
    nearly: tuple[str, ...] = ()
    isolated: tuple[SingularShape, ...] = ()


def singular_shapes(model: pin.Model, coupled: Coupled | None = None) -> SingularShapes:
    """Return the shapes at which the mass matrix H, or GᵀHG of coupled joints, is singular.

    Args:
        model: Model whose joint 1 is the root.  Inertias and axes are finite, masses and moments
            are not negative.
        coupled: Dependence of follower joints on independent joints; None without followers.
    """
    tree = tree_of(model)
    if not tree.suspects:
        return SingularShapes()
    bounds = bound_massless_twists(tree, NEARLY)
    suspects = [i for i, N in enumerate(bounds) if moves_no_mass(tree, i, N, NEARLY)]
    if not suspects:
        return SingularShapes()
    rng = np.random.default_rng(0)
    shapes = [_random_displacements(tree, rng) for _ in range(_SHAPES)]
    everywhere = _massless_joints(tree, shapes, EXACT)
    nearly = [] if everywhere else _massless_joints(tree, shapes, NEARLY)
    usual = massless_twists(tree, shapes[0], NEARLY)
    isolated: list[SingularShape] = []
    has_balls = any(axes.shape[1] > 1 for axes in tree.axes[1:])
    for i in () if everywhere or has_balls else suspects:
        if i in nearly:
            continue
        values = _by_children(model, tree, i, bounds, usual)
        if values is None:
            isolated += _free_inertia(model, i + 1).search()
        else:
            isolated += [SingularShape(tree.names[i], at) for at in values]
    singular = SingularShapes(
        tuple(tree.names[i] for i in everywhere),
        tuple(tree.names[i] for i in nearly),
        tuple(isolated),
    )
    if coupled is None or has_balls or singular == SingularShapes():
        # Couplings restrict the motions, so a regular mass matrix stays regular.
        return singular
    return _coupled_singular_shapes(model, coupled)


def _random_displacements(tree: Tree, rng: np.random.Generator) -> list[Array | float]:
    """Return a random displacement of each joint: a number, or a ball's rotation vector."""
    balls = [False, *(axes.shape[1] > 1 for axes in tree.axes[1:])]
    return [rng.uniform(-1.0, 1.0, 3) if b else float(rng.uniform(-np.pi, np.pi)) for b in balls]


def _massless_joints(tree: Tree, shapes: list[list[Array | float]], tolerance: float) -> list[int]:
    """Return the joints to lock so that every other joint moves mass, deepest joint first."""
    joints: list[int] = []
    while True:
        bodies = [massless_twists(tree, x, tolerance) for x in shapes]
        for i in reversed(range(len(tree.names))):
            if all(moves_no_mass(tree, i, N[i], tolerance) for N in bodies):
                joints.append(i)
                # A locked joint cannot cancel the motions of its ancestors.
                stiff = tuple(s or k == i for k, s in enumerate(tree.stiff))
                tree = replace(tree, stiff=stiff)
                break
        else:
            return joints


def _by_children(
    model: pin.Model, tree: Tree, i: int, bounds: list[Array], usual: list[Array]
) -> list[dict[str, float]] | None:
    """Return the child joint values at which joint i moves no mass; None if not determined.

    Joint i moves no mass if every child can cancel its twist.  `bounds` contain the massless
    twists at every shape.  If a bound has the dimension of the massless twists at a usual shape,
    bound and massless twists agree at nearly all shapes, and the children decide alone.  If
    the mass matrix is singular at nearly all shapes with given child values, then by continuity
    it is singular at all shapes with these values.
    """
    axes = intersect(bounds[i], tree.axes[i], NEARLY)
    if axes.shape[1] > 1:
        return None
    choices: list[list[tuple[str, float]]] = []
    children = [c for c, parent in enumerate(tree.parents) if parent == i]
    for c in children:
        prismatic = is_prismatic(model.joints[c + 1])
        P = undoing_twists(tree, c, bounds[c])
        values = _solutions(tree, c, P, axes[:, 0], prismatic=prismatic)
        if values is not None:
            scale = tree.unit if prismatic else 1.0
            choices.append([(tree.names[c], scale * value) for value in sorted(values)])
    if not all(choices):
        return []
    if any(bounds[c].shape != usual[c].shape for c in children):
        return None
    return [dict(choice) for choice in itertools.product(*choices)]


def _solutions(tree: Tree, c: int, P: Array, S: Array, *, prismatic: bool) -> list[float] | None:
    """Return the values of joint c at which it can cancel the parent's twist S; None if all.

    The joint can cancel S if S is in the subspace P (see `undoing_twists`).  The values solve
    a + b cos x + c sin x = 0 (revolute) or a + b x = 0 (prismatic), with vectors a, b, c.
    """
    off = np.eye(6) - P @ P.T
    samples = [0.0, 1.0] if prismatic else [0.0, np.pi / 2, np.pi]
    residuals = [off @ np.linalg.solve(tree.moved(c, x), S) for x in samples]
    if prismatic:
        coefficients = np.array([residuals[0], residuals[1] - residuals[0]])
    else:
        mean = 0.5 * (residuals[0] + residuals[2])
        coefficients = np.array([mean, residuals[0] - mean, residuals[1] - mean])
    a, *slopes = coefficients
    if max(float(np.linalg.norm(b)) for b in slopes) <= NEARLY:
        return None if np.linalg.norm(a) <= NEARLY else []
    if prismatic:
        (b,) = slopes
        candidates = [float(-(a @ b) / (b @ b))]
        terms = np.array([[1.0, x] for x in candidates])
    else:
        candidates = _flattest(a, *slopes)
        terms = np.array([[1.0, np.cos(x), np.sin(x)] for x in candidates])
    sizes = np.linalg.norm(terms @ coefficients, axis=1)
    return [x for x, size in zip(candidates, sizes, strict=True) if size <= NEARLY]


def _flattest(a: Array, b: Array, c: Array) -> list[float]:
    """Return the angles in (−π, π] at which |a + b cos x + c sin x| is stationary.

    With z = exp(ix), the derivative of the square is a polynomial of degree 4 in z over z².
    """
    # Fourier coefficients of the derivative of
    # |f|² = a² + 2ab cos + 2ac sin + b² cos² + c² sin² + 2bc cos sin.
    sin1, cos1 = -2.0 * float(a @ b), 2.0 * float(a @ c)
    sin2, cos2 = float(c @ c - b @ b), 2.0 * float(b @ c)
    half = [0.5 * (cos2 - 1j * sin2), 0.5 * (cos1 - 1j * sin1)]
    roots = np.roots([*half, 0.0, *np.conj(half[::-1])])
    angles: list[float] = []
    for x in np.angle(roots).tolist():
        x = np.pi if x < 1e-9 - np.pi else 0.0 if abs(x) < 1e-15 else x
        if all(abs(np.exp(1j * x) - np.exp(1j * y)) > 1e-5 for y in angles):
            angles.append(x)
    return angles


class _Inertia:
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
            joints: Index of the first joint, then indices of the joints with values y, (m,).
            P: Basis of admissible velocities, (nv, k): the first joint's columns, then the others'.
            offset: Values of all joints at y = 0, (nv,) [rad | m].
            bound: Number of leading entries of w with unit norm; the other entries are free.
        """
        self._model = model.copy()
        self._model.gravity.setZero()
        self._data = self._model.createData()
        self._P, self._offset, self._bound = P, offset, bound
        first, *others = joints
        self._lead = int(model.joints[first].nv)
        self._names = [str(model.names[k]) for k in others]
        self._entry_names = [str(model.names[first])] * self._lead + self._names
        self._slides = np.array([is_prismatic(model.joints[k]) for k in others], dtype=bool)
        self._reach = largest_step(model)
        self._evaluations = 0
        self._usual: Array = np.ones(P.shape[1])
        rng = np.random.default_rng(1)
        samples = [np.diag(self._matrix(self._random(rng))) for _ in range(_SAMPLES)]
        # Inertias below the round-off of the robot's inertia must not be scaled to 1.
        turns = np.append(axes_of(model.joints[first])[3:].any(axis=0), ~self._slides)
        mass = sum(body.mass for body in list(model.inertias)[1:])
        natural = mass * np.where(turns, self._reach**2, 1.0)
        self._usual = np.sqrt(np.maximum(np.max(samples, axis=0), _SMALLEST * natural))

    def massless_joints(self, tolerance: float) -> tuple[str, ...]:
        """Return the joints to lock so that the matrix is regular at one random shape or more."""
        rng = np.random.default_rng(0)
        matrices = [self._matrix(self._random(rng)) for _ in range(_SHAPES)]
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
        return self._at(y)[0] <= _LOST

    def _descend(self, y: Array) -> Array:
        """Minimise s locally, starting from y; return the minimiser."""
        if self._vanishes(y):
            return y
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
        wrapped = np.where(self._slides, y, np.arctan2(np.sin(y), np.cos(y)))
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
        return value, np.asarray(u @ slope @ self._P[:, self._lead :])

    def _least(self, y: Array) -> tuple[float, Array, Array]:
        """Return s(y), Pinocchio's q, and the minimising scaled motion w, (k,)."""
        H, b = self._matrix(y), self._bound
        behind = H[b:, b:]
        size = np.sqrt(np.maximum(np.diag(behind), 1e-300))
        scaled = behind / np.outer(size, size)
        if not np.isfinite(scaled).all():  # The line search overflowed.
            return np.inf, self._configuration(y), np.zeros(len(H))
        # The pseudo-inverse allows for descendant joints whose inertia is zero at this shape.
        follow = -np.linalg.pinv(scaled, rcond=1e-14, hermitian=True) @ (H[b:, :b] / size[:, None])
        U = np.vstack([np.eye(b), follow / size[:, None]])
        S = U.T @ H @ U
        values, directions = np.linalg.eigh(0.5 * (S + S.T))
        return float(values[0]), self._configuration(y), U @ directions[:, 0]

    def _matrix(self, y: Array) -> Array:
        """Return PᵀHP, scaled by the typical inertias, (k, k)."""
        self._evaluations += 1
        upper: Array = np.triu(pin.crba(self._model, self._data, self._configuration(y)))
        H = self._P.T @ ((upper + np.triu(upper, 1).T) @ self._P)
        return np.asarray(H / np.outer(self._usual, self._usual))

    def _configuration(self, y: Array) -> Array:
        q: Array = np.array(pin.neutral(self._model))
        values = self._offset + self._P[:, self._lead :] @ y
        for joint in self._model.joints[2:]:
            entries = slice(joint.idx_q, joint.idx_q + joint.nq)
            q[entries] = joint_configuration(joint, values[joint.idx_v])
        return q


def _last_entry(motion: Array) -> int:
    """Return the index of the last entry of a motion that is not negligible."""
    size = np.abs(motion)
    return int(np.flatnonzero(size > _LEADING * size.max())[-1])


def _free_inertia(model: pin.Model, joint: int) -> _Inertia:
    """Return the inertia of a joint when its descendant joints are free to move."""
    subtree = [joint, *(int(k) for k in model.subtrees[joint] if k != joint)]
    columns = [v for k in subtree for v in range(model.idx_vs[k], model.idx_vs[k] + model.nvs[k])]
    P = np.eye(model.nv)[:, columns]
    return _Inertia(model, subtree, P, np.zeros(model.nv), model.joints[joint].nv)


def _coupled_singular_shapes(model: pin.Model, coupled: Coupled) -> SingularShapes:
    """Return the shapes at which the mass matrix GᵀHG of coupled joints is singular."""
    r = int(model.joints[1].nv)
    n = r + len(coupled.leads)
    offset = np.append(np.zeros(r), coupled.values(np.zeros(n - r)))
    joints = [1, *(2 + coupled.leads).tolist()]
    inertia = _Inertia(model, joints, coupled.rates(np.eye(n), r).T, offset, n)
    if everywhere := inertia.massless_joints(_LOST_EXACT):
        return SingularShapes(everywhere=everywhere)
    if nearly := inertia.massless_joints(_LOST):
        return SingularShapes(nearly=nearly)
    return SingularShapes(isolated=tuple(inertia.search()))

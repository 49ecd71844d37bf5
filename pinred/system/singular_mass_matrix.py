"""Detect shapes at which a mass matrix is singular: every shape, isolated examples, or none.

Random shapes show whether a joint moves no mass at every shape.  Subspaces that contain the
massless motions at every shape prove that the matrix is regular (`bound_massless_twists`).  If
singularity depends on child joints only, closed forms provide the joint values.  In all other
cases, local minimisation from quarter turns and from random shapes searches for examples.  Its
unknowns are the values of hinges and slides, and the rotation vectors of balls.

Massless motions make the mass matrix of a tree singular.  Let the bodies have positive
semidefinite inertias Y.  A twist of body i moves no mass if motions of the joints behind it can
cancel the twist in all bodies of its subtree.  These massless twists are

    N_i(x) = ker Y_i ∩ ⋂_c X_c Ad(exp(x_c S_c)) P_c,    P_c = N_c ⊕ span S_c,

over the children c of body i with placements X and axes S.  P_c contains the parent's twists that
child c can cancel.  A joint with armature cannot cancel a twist, so P_c = N_c.  (N_i is the kernel
of Featherstone's articulated inertia.)

The mass matrix is singular at x exactly if S_i ∈ N_i(x) for a joint i without armature, or if
the motions of the root intersect N of the root.  If every body has positive mass and moments, all
N are zero.

Lengths are in units of the tree's largest step and angles in radians, so that directions of
twists can be compared.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.groups import SE3
from ..lie.rotations import left_jacobian, quaternion_exp
from .coordinates import tree_space
from .coupling import Coupled
from .joints import axes_of, is_prismatic, largest_step

# Sines of angles between directions below which the directions count as equal: EXACT allows for
# round-off, NEARLY for the decimals of numbers in a file.
EXACT, NEARLY = 1e-9, 1e-6
# A moment of inertia below this fraction of the moments to which it is added counts as round-off.
_ZERO = 1e-14


@dataclass(frozen=True)
class Tree:
    """The properties of a tree that decide which motions move no mass.

    Index 0 is the root body with joint 1 of the model, index k the body of joint k + 1.

    Attributes:
        names: Names of the joints that move the bodies.
        parents: Index of the parent of each body; −1 for the root.
        axes: Unit twists of the joints, (6, nv), in their bodies' frames.
        placements: Matrices, (6, 6), that transform twists from each body's frame, at joint value
            zero, to its parent's frame.
        still: Orthonormal twists of each body, (6, k), at which the body has no kinetic energy.
        stiff: Whether each joint has armature or is locked, so that it cannot cancel twists.
        unit: Unit of length [m].
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    axes: tuple[Array, ...]
    placements: tuple[Array, ...]
    still: tuple[Array, ...]
    stiff: tuple[bool, ...]
    unit: float

    @property
    def suspects(self) -> bool:
        """Whether any body lacks mass or a moment of inertia."""
        return any(basis.shape[1] for basis in self.still)

    def moved(self, i: int, displacement: Array | float) -> Array:
        """Return the (6, 6) matrix from twists in body i's frame to its parent's.

        displacement: Displacement of the joint from rest; for a ball, a rotation vector
            [rad | units of length].
        """
        twist = self.axes[i] * displacement
        turn = pin.exp6(pin.Motion(twist.sum(axis=1))).action
        return np.asarray(self.placements[i] @ turn)


def tree_of(model: pin.Model) -> Tree:
    """Return the tree of a model whose joint 1 is the root and whose inertias are finite."""
    count, unit, axes = range(1, model.njoints), largest_step(model), []
    for i in count:
        S = axes_of(model.joints[i])
        axes.append(S / np.linalg.norm(S, axis=0))
    placements = []
    for i in count:
        at = model.jointPlacements[i]
        placements.append(pin.SE3(at.rotation, at.translation / unit).action)
    stiff = [bool(model.armature[model.joints[i].idx_v] > 0.0) for i in count]
    return Tree(
        names=tuple(model.names[i] for i in count),
        parents=tuple(model.parents[i] - 1 for i in count),
        axes=tuple(axes),
        placements=tuple(placements),
        still=tuple(_energy_free_twists(model.inertias[i], unit) for i in count),
        stiff=tuple(stiff),
        unit=unit,
    )


def no_moment(inertia: pin.Inertia, unit: float) -> float:
    """Return the moment of inertia below which a body's moments count as round-off [kg m²].

    unit: Largest distance between joints of the robot, which sets the round-off [m].
    """
    reach = max(float(np.linalg.norm(inertia.lever)), 0.01 * unit) if inertia.mass > 0.0 else 0.0
    return _ZERO * max(float(np.abs(inertia.inertia).max()), float(inertia.mass) * reach**2)


def _energy_free_twists(inertia: pin.Inertia, unit: float) -> Array:
    """Return an orthonormal basis, (6, k), of the twists at which a body has no kinetic energy."""
    moments, directions = np.linalg.eigh(inertia.inertia)
    lever = inertia.lever if inertia.mass > 0.0 else np.zeros(3)
    axes = directions[:, moments <= no_moment(inertia, unit)]
    if inertia.mass > 0.0 and not axes.size:
        return np.zeros((6, 0))
    about_mass = np.vstack([np.cross(lever / unit, axes, axisb=0, axisc=0), axes])
    if inertia.mass > 0.0:
        return _orthonormal(about_mass)
    return _orthonormal(np.hstack([np.eye(6, 3), about_mass]))


def massless_twists(tree: Tree, x: Sequence[Array | float], tolerance: float) -> list[Array]:
    """Return orthonormal bases, (6, k), of the massless twists N of every body at a shape.

    Args:
        tree: Tree of bodies and joints.
        x: Displacement of every joint from rest [rad | units of length]; the root's entry is not
            used.
        tolerance: Sine of the largest angle between directions that count as equal.
    """
    N = list(tree.still)
    for i in range(len(N) - 1, 0, -1):
        parent = tree.parents[i]
        if N[parent].shape[1]:
            P = undoing_twists(tree, i, N[i])
            N[parent] = intersect(N[parent], tree.moved(i, x[i]) @ P, tolerance)
    return N


def bound_massless_twists(tree: Tree, tolerance: float) -> list[Array]:
    """Return bases, (6, k), of subspaces that contain the massless twists N at every shape.

    The bases are orthonormal, one for each body.  The images of P under all motions of a joint are
    replaced by the smallest subspace that contains P and is invariant under these motions.
    """
    N = list(tree.still)
    for i in range(len(N) - 1, 0, -1):
        parent = tree.parents[i]
        if N[parent].shape[1]:
            K = _invariant_closure(undoing_twists(tree, i, N[i]), tree.axes[i])
            N[parent] = intersect(N[parent], tree.placements[i] @ K, tolerance)
    return N


def undoing_twists(tree: Tree, i: int, N: Array) -> Array:
    """Return an orthonormal basis, (6, k), of P, the parent's twists that joint i can cancel.

    N: Massless twists of body i, (6, k).
    """
    return N if tree.stiff[i] else _sum_of(N, tree.axes[i])


def moves_no_mass(tree: Tree, i: int, N: Array, tolerance: float) -> bool:
    """Return whether joint i, or a motion of the root, moves no mass.

    Args:
        tree: Tree of bodies and joints.
        i: Index of the body that the joint moves.
        N: Massless twists of that body, (6, k).
        tolerance: Sine of the largest angle between directions that count as equal.
    """
    return not tree.stiff[i] and intersect(N, tree.axes[i], tolerance).shape[1] > 0


def intersect(A: Array, B: Array, tolerance: float) -> Array:
    """Return an orthonormal basis of the intersection of two column spaces.

    Args:
        A: Orthonormal columns, (6, k).
        B: Columns, (6, l).
        tolerance: Sine of the largest angle between directions that count as equal.
    """
    if not (A.shape[1] and B.shape[1]):
        return A[:, :0]
    Q = _orthonormal(B)
    _, sines, directions = np.linalg.svd(A - Q @ (Q.T @ A), full_matrices=False)
    return np.asarray(A @ directions[sines <= tolerance].T)


def _invariant_closure(P: Array, axes: Array) -> Array:
    """Return a basis of the smallest subspace that contains P and is invariant under [axis, ·].

    axes: Twists of a joint, (6, nv).
    """
    brackets, K = [SE3.ad(axis) for axis in axes.T], P
    while True:
        larger = K
        for bracket in brackets:
            larger = _sum_of(larger, bracket @ K)
        if larger.shape == K.shape:
            return K
        K = larger


def _sum_of(A: Array, B: Array) -> Array:
    """Return an orthonormal basis of the sum of two column spaces; A is orthonormal."""
    new = _orthonormal(B - A @ (A.T @ B))
    # Normalisation of small columns amplifies their round-off along A, so project it out again.
    return np.hstack([A, _orthonormal(new - A @ (A.T @ new))])


def _orthonormal(A: Array) -> Array:
    """Return an orthonormal basis of the column space of (6, k) columns of length about one."""
    U, sizes, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, sizes > EXACT])


# Scaled inertias below these limits count as zero: _LOST_EXACT allows for round-off, LOST for the
# decimals of numbers in a file.
_LOST_EXACT = 1e-13


@dataclass(frozen=True)
class SingularShapes:
    """Shapes at which a mass matrix is singular.

    Attributes:
        everywhere: Names of joints that move no mass at any shape.  If these joints are locked,
            the matrix is regular at most shapes.
        nearly: Joints that move no mass at any shape if the decimals of a file are not exact.
        isolated: Examples of isolated singular shapes.
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
    shapes = [_random_displacements(tree, rng) for _ in range(SHAPES)]
    everywhere = _massless_joints(tree, shapes, EXACT)
    nearly = [] if everywhere else _massless_joints(tree, shapes, NEARLY)
    usual = massless_twists(tree, shapes[0], NEARLY)
    isolated: list[SingularShape] = []
    for i in () if everywhere else suspects:
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
    if coupled is None or singular == SingularShapes():
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
    if any(tree.axes[c].shape[1] > 1 for c in children):
        return None  # the attitudes of a ball at which it cancels the twist are no discrete values
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


def _free_inertia(model: pin.Model, joint: int) -> ScaledInertia:
    """Return the inertia of a joint when its descendant joints are free to move."""
    subtree = [joint, *(int(k) for k in model.subtrees[joint] if k != joint)]
    columns = [v for k in subtree for v in range(model.idx_vs[k], model.idx_vs[k] + model.nvs[k])]
    P = np.eye(model.nv)[:, columns]
    return ScaledInertia(model, subtree, P, np.zeros(model.nv), model.joints[joint].nv)


def _coupled_singular_shapes(model: pin.Model, coupled: Coupled) -> SingularShapes:
    """Return the shapes at which the mass matrix GᵀHG of coupled joints is singular."""
    r = int(model.joints[1].nv)
    n = r + len(coupled.leads)
    space, offset = tree_space(model), np.zeros(model.nv)
    offset[r + space.scalar_v] = coupled.offset[space.scalar_x]
    leading = [joint for joint in list(model.joints)[2:] if joint.idx_v - r in coupled.leads]
    joints = [1, *(int(joint.id) for joint in leading)]
    inertia = ScaledInertia(model, joints, coupled.rates(np.eye(n), r).T, offset, n)
    if everywhere := inertia.massless_joints(_LOST_EXACT):
        return SingularShapes(everywhere=everywhere)
    if nearly := inertia.massless_joints(LOST):
        return SingularShapes(nearly=nearly)
    return SingularShapes(isolated=tuple(inertia.search()))


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
        first, *following = joints
        self._lead = int(model.joints[first].nv)
        widths = [int(model.joints[k].nv) for k in following]
        names = [str(model.names[k]) for k in following]
        self._names = [
            name if width == 1 else f"{name}.{axis}"
            for name, width in zip(names, widths, strict=True)
            for axis in "xyz"[:width]
        ]
        self._entry_names = [str(model.names[first])] * self._lead + self._names
        self._slides = np.repeat([is_prismatic(model.joints[k]) for k in following], widths) > 0
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
        slope_along = u @ slope
        for ball in self._balls:  # derivatives along the axes of a ball, by its rotation vector
            at = slice(ball.idx_v, ball.idx_v + 3)
            slope_along[at] = slope_along[at] @ left_jacobian(-self._values(y)[at])
        return value, np.asarray(slope_along @ self._P[:, self._lead :])

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

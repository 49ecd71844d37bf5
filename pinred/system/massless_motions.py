"""Motions that move no mass, and so make the mass matrix of a tree singular.

Let the bodies have positive semidefinite inertias Y.  A twist of body i moves no mass if motions
of the joints behind it can cancel the twist in all bodies of its subtree.  These massless twists
are

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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.groups import SE3
from .joints import axes_of

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


def largest_step(model: pin.Model) -> float:
    """Return the largest distance from a joint to the next joint or its mass [m]; 1 if zero."""
    count = range(1, model.njoints)
    steps = [model.jointPlacements[i].translation for i in count if i > 1]
    levers = [model.inertias[i].lever for i in count if model.inertias[i].mass > 0.0]
    return max((float(np.linalg.norm(p)) for p in (*steps, *levers)), default=0.0) or 1.0


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

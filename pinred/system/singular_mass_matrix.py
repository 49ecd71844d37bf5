"""Detect shapes at which a mass matrix is singular: every shape, isolated examples, or none.

Random shapes show whether a joint moves no mass at every shape.  Subspaces that contain the
massless motions at every shape prove that the matrix is regular (`bound_massless_twists`).  If
singularity depends on child joints only, closed forms provide the joint values.  In all other
cases, local minimisation from quarter turns and from random shapes searches for examples.  Its
unknowns are the values of hinges and slides, and the rotation vectors of balls.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from .coupling import Coupled
from .joints import is_prismatic, tree_space
from .massless_motions import (
    EXACT,
    NEARLY,
    Tree,
    bound_massless_twists,
    intersect,
    massless_twists,
    moves_no_mass,
    tree_of,
    undoing_twists,
)
from .scaled_inertia import LOST, SHAPES, ScaledInertia, SingularShape

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

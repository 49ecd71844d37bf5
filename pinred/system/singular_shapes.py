"""At which shapes a model's mass matrix is singular: at all, at some that are named, or at none.

Four random shapes tell what holds at every shape.  That the matrix is regular is proved by
subspaces that need no shape (`hulls`).  Where the next joints alone decide, their values come
from closed forms; what is left is searched for (`singular_search`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from .joints import is_prismatic
from .massless_motions import (
    EXACT,
    NEARLY,
    Tree,
    free_to_move,
    hulls,
    lost,
    meet,
    tree_of,
    undone,
)

_SHAPES = 4  # random ones; a joint that moves no mass at all of them moves none at any
_EXAMPLES = 4  # singular shapes that are named


@dataclass(frozen=True)
class SingularShape:
    """A shape at which a joint moves no mass.

    joint: its name.  at: values there of the joints that decide it [rad | m].
    """

    joint: str
    at: Mapping[str, float]


@dataclass(frozen=True)
class SingularShapes:
    """Shapes at which a mass matrix is singular.

    everywhere: names of joints that move no mass at any shape; locking them leaves a matrix
    that is regular at most shapes.  nearly: the same, but for the decimals of a file.
    isolated: examples of single shapes.
    """

    everywhere: tuple[str, ...] = ()
    nearly: tuple[str, ...] = ()
    isolated: tuple[SingularShape, ...] = ()


def singular_shapes(model: pin.Model) -> SingularShapes:
    """Return where the mass matrix of a model is singular; joint 1 is the root.

    Inertias and axes are finite, masses and moments not negative.
    """
    tree = tree_of(model)
    if not tree.suspects:
        return SingularShapes()
    hull = hulls(tree, NEARLY)
    suspects = [i for i, N in enumerate(hull) if lost(tree, i, N, NEARLY)]
    if not suspects:
        return SingularShapes()
    rng = np.random.default_rng(0)
    shapes = rng.uniform(-np.pi, np.pi, (_SHAPES, len(tree.names))).tolist()
    everywhere = _at_every_shape(tree, shapes, EXACT)
    if everywhere:
        return SingularShapes(everywhere=tuple(tree.names[i] for i in everywhere))
    nearly = _at_every_shape(tree, shapes, NEARLY)
    usual = undone(tree, shapes[0], NEARLY)
    isolated: list[SingularShape] = []
    for i in suspects:
        if i in nearly:
            continue
        found = _by_children(model, tree, i, hull, usual)
        if found is None:
            from .singular_search import search

            found = search(model, i, _EXAMPLES)
        isolated += [SingularShape(tree.names[i], at) for at in found]
    return SingularShapes((), tuple(tree.names[i] for i in nearly), tuple(isolated))


def _at_every_shape(tree: Tree, shapes: list[list[float]], tolerance: float) -> list[int]:
    """Return the joints to lock so that none moves no mass at every shape, deepest first."""
    found: list[int] = []
    while True:
        bodies = [undone(tree, x, tolerance) for x in shapes]
        for i in reversed(range(len(tree.names))):
            if all(lost(tree, i, N[i], tolerance) for N in bodies):
                found.append(i)
                # Locked, it cannot help the joints before it.
                stiff = tuple(s or k == i for k, s in enumerate(tree.stiff))
                tree = replace(tree, stiff=stiff)
                break
        else:
            return found


def _by_children(
    model: pin.Model, tree: Tree, i: int, hull: list[Array], usual: list[Array]
) -> list[dict[str, float]] | None:
    """Return the values of child joints at which joint i moves no mass; None if more decides.

    Every child has to carry the joint's axis (of a root's, the one in question) among what it can
    undo, at most its hull.  Where that is what it can undo at the usual shape, it is so at nearly
    all, and a mass matrix that is singular at nearly all shapes with some joint at a value is
    singular at all of them.
    """
    axes = meet(hull[i], tree.axes[i], NEARLY)
    if axes.shape[1] > 1:
        return None
    choices: list[list[tuple[str, float]]] = []
    children = [c for c, parent in enumerate(tree.parents) if parent == i]
    for c in children:
        prismatic = is_prismatic(model.joints[c + 1])
        P = free_to_move(tree, c, hull[c])
        values = _solutions(tree, c, P, axes[:, 0], prismatic=prismatic)
        if values is not None:
            scale = tree.unit if prismatic else 1.0
            choices.append([(tree.names[c], scale * value) for value in sorted(values)])
    if not all(choices):
        return []
    if any(hull[c].shape != usual[c].shape for c in children):
        return None
    return [dict(chosen) for chosen in itertools.product(*choices)]


def _solutions(tree: Tree, c: int, P: Array, S: Array, *, prismatic: bool) -> list[float] | None:
    """Return the values of joint c at which P of its body, moved, contains S; None for all.

    They solve a + b cos x + c sin x = 0, or a + b x = 0, for several rows (a, b, c) at once.
    """
    off = np.eye(6) - P @ P.T
    at = [0.0, 1.0] if prismatic else [0.0, np.pi / 2, np.pi]
    found = [off @ np.linalg.solve(tree.moved(c, x), S) for x in at]
    if prismatic:
        a, b = found[0], found[1] - found[0]
        if np.linalg.norm(b) <= NEARLY:
            return None if np.linalg.norm(a) <= NEARLY else []
        candidates = [float(-(a @ b) / (b @ b))]
        rows = np.array([[1.0, x] for x in candidates]) @ np.array([a, b])
    else:
        a = 0.5 * (found[0] + found[2])
        b, c_ = found[0] - a, found[1] - a
        if max(np.linalg.norm(b), np.linalg.norm(c_)) <= NEARLY:
            return None if np.linalg.norm(a) <= NEARLY else []
        candidates = _flattest(a, b, c_)
        rows = np.array([[1.0, np.cos(x), np.sin(x)] for x in candidates]) @ np.array([a, b, c_])
    return [x for x, row in zip(candidates, rows, strict=True) if np.linalg.norm(row) <= NEARLY]


def _flattest(a: Array, b: Array, c: Array) -> list[float]:
    """Return the angles in (−π, π] at which |a + b cos x + c sin x| is stationary.

    With z = exp(ix), the derivative of its square is a polynomial of degree 4 in z over z².
    """
    # f = a² + 2ab cos + 2ac sin + b² cos² + c² sin² + 2bc cos sin
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

"""Bodies whose mass, centre and moments are symbols, in the frames of the sweep.

In these frames they are linear in those in the joint's own frame, so that a kernel takes them as
they come and no division or sine of them is in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...common.arrays import Array
from ...system.system import System
from .body_frames import Body, bodies_of
from .scalars import Scalar, add

NUMBERS = 10  # of a body: mass, moment (3,), inertia about the origin (6,)
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def with_free(bodies: Sequence[Body], free: Sequence[int], numbers: Sequence[Scalar]) -> list[Body]:
    """Return the bodies, those with indices `free` with these numbers, NUMBERS each."""
    out = list(bodies)
    for k, i in enumerate(free):
        mass, *rest = numbers[NUMBERS * k : NUMBERS * (k + 1)]
        out[i] = replace(out[i], mass=mass, moment=list(rest[:3]), inertia=list(rest[3:]))
    return out


def total_mass(bodies: Sequence[Body]) -> Scalar:
    """Return the mass of all bodies."""
    total: Scalar = 0.0
    for body in bodies:
        total = add(total, body.mass)
    return total


def frame_map(body: Body) -> Array:
    """Return the map, (10, 10), from a body's moments in its joint's frame to those in its own.

    Both are m, m c, and the inertia about the frame's origin, xx, xy, xz, yy, yz, zz.
    """
    R, p = np.asarray(body.frame.rotation), np.asarray(body.frame.translation)
    out = np.zeros((NUMBERS, NUMBERS))
    for k, unit in enumerate(np.eye(NUMBERS)):
        m, h = unit[0], unit[1:4]
        I = np.zeros((3, 3))
        for value, (i, j) in zip(unit[4:], _PAIRS, strict=True):
            I[i, j] = I[j, i] = value
        moved = I - 2.0 * (h @ p) * np.eye(3) + np.outer(h, p) + np.outer(p, h)
        moved += m * (p @ p * np.eye(3) - np.outer(p, p))
        turned = R.T @ moved @ R
        out[0, k], out[1:4, k] = m, R.T @ (h - m * p)
        out[4:, k] = [turned[i, j] for i, j in _PAIRS]
    return out


def numbers_of(body: Body) -> Array:
    """Return the numbers (10,) that a body has."""
    return np.array([body.mass, *body.moment, *body.inertia])


def free_numbers(system: System, free: Sequence[int]) -> Array:
    """Return the numbers of bodies, as a kernel takes them."""
    if not free:
        return np.empty(0)
    bodies = bodies_of(system)
    return np.concatenate([numbers_of(bodies[i]) for i in free])

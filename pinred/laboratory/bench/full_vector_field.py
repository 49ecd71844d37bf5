"""Pinocchio's ABA on the full state, as a fast vector field for SciPy's integrators.

The state is (root, x, v) as in judge/reference_solution.py. The judge's vector field takes ten
times as long as `pin.aba` and would make SciPy's methods look slow. The field here allocates no
array except its result and computes the kinematics of the root with Python floats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, sin

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...lie.group import Group
from ...system.system import System

Floats = Sequence[float]


def full_vector_field(system: System) -> Callable[[float, Array], Array]:
    """Return the vector field (t, y) → dy/dt of a system under gravity alone."""
    model, data = system.model, system.model.createData()
    size, r, first_v = system.group.size, system.r, system.group.size + system.m
    root_rate, tau = _root_rate(system.group), np.zeros(system.n)
    circles = _circles(system)
    has_circles = any(circles)
    aba, empty = pin.aba, np.empty
    buffer = np.empty(model.nq)

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        ydot = empty(y.shape)
        v = y[first_v:]
        if has_circles:
            q = buffer
            values: list[float] = []
            for value, circle in zip(y[:first_v].tolist(), circles, strict=True):
                values += (cos(value), sin(value)) if circle else (value,)
            q[:] = values
        else:
            q = y[:first_v]
        ydot[:size] = root_rate(y[:size].tolist(), v[:r].tolist())
        ydot[size:first_v] = v[r:]
        ydot[first_v:] = aba(model, data, q, v, tau)
        return ydot

    return rate


def _circles(system: System) -> list[bool]:
    """Return whether Pinocchio stores each coordinate of (root, x) as cosine and sine."""
    joints = system.model.joints
    root = [False] * system.group.size
    root[-1] = joints[1].nq > system.group.size
    return root + [joints[i].nq == 2 for i in range(2, system.model.njoints)]


def _translating(_: Floats, v: Floats) -> Floats:
    return v


def _planar(root: Floats, v: Floats) -> Floats:
    c, s = cos(root[-1]), sin(root[-1])
    *across, x, y, w = v
    return *across, c * x - s * y, s * x + c * y, w


def _attitude(q: Floats, w: Floats) -> Floats:
    x, y, z, s = q
    a, b, c = w
    return (
        0.5 * (s * a + y * c - z * b),
        0.5 * (s * b + z * a - x * c),
        0.5 * (s * c + x * b - y * a),
        -0.5 * (x * a + y * b + z * c),
    )


def _free(root: Floats, v: Floats) -> Floats:
    x, y, z, s = root[3:]
    a, b, c = v[:3]
    t0, t1, t2 = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        a + s * t0 + y * t2 - z * t1,
        b + s * t1 + z * t0 - x * t2,
        c + s * t2 + x * t1 - y * t0,
        *_attitude(root[3:], v[3:]),
    )


def _root_rate(group: Group) -> Callable[[Floats, Floats], Floats]:
    """Return the map (root coordinates, body twist) → rate of the root coordinates."""
    if group.turns == 3:
        return _free if group.linear else _attitude
    return _planar if group.plane else _translating

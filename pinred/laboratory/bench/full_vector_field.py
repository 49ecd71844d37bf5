"""Pinocchio's ABA on the full state as a vector field for SciPy, with little around it.

The state is that of full_state.py, (root, x, v).  The judge's own vector field takes ten
times as long as `pin.aba` and would handicap what it is measured for here; this one makes
no array but its result, and does the kinematics of the root in plain floats.
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
    """Return (t, y) → dy/dt of a system without forces but its gravity."""
    model, data = system.model, system.model.createData()
    size, r, at = system.group.size, system.r, system.group.size + system.m
    root_rate, tau = _root_rate(system.group), np.zeros(system.n)
    circles = _circles(system)
    plain = not any(circles)
    aba, empty = pin.aba, np.empty
    space = np.empty(model.nq)

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        out = empty(y.shape)
        v = y[at:]
        if plain:
            q = y[:at]
        else:
            q = space
            values: list[float] = []
            for value, circle in zip(y[:at].tolist(), circles, strict=True):
                values += (cos(value), sin(value)) if circle else (value,)
            q[:] = values
        out[:size] = root_rate(y[:size].tolist(), v[:r].tolist())
        out[size:at] = v[r:]
        out[at:] = aba(model, data, q, v, tau)
        return out

    return rate


def _circles(system: System) -> list[bool]:
    """Return which of the coordinates (root, x) Pinocchio keeps as cosine and sine."""
    joints = system.model.joints
    root = [False] * system.group.size
    root[-1] = joints[1].nq > system.group.size
    return root + [joints[i].nq == 2 for i in range(2, system.model.njoints)]


def _same(_: Floats, v: Floats) -> Floats:
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
    """Return (root, body twist) → the rate of the root's coordinates."""
    if group.turns == 3:
        return _free if group.linear else _attitude
    return _planar if group.plane else _same

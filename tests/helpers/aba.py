"""A full simulation of a few lines, Pinocchio's ABA under SciPy: the other side of many tests."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from pinred.common.arrays import Array

Torques = Callable[[float, Array, Array], Array]


def free(_t: float, _q: Array, v: Array) -> Array:
    """Nothing acts."""
    return np.zeros(len(v))


def kinematics(model: pin.Model) -> Callable[[Array, Array], Array]:
    """A function from q and v to dq/dt, joint by joint."""
    joints = [
        (j.shortname(), slice(j.idx_q, j.idx_q + j.nq), slice(j.idx_v, j.idx_v + j.nv))
        for j in list(model.joints)[1:]
    ]

    def of(kind: str, p: Array, w: Array) -> Array:
        if kind == "JointModelComposite":  # a slide before a plane
            return np.append(w[0], of("JointModelPlanar", p[1:], w[1:]))
        if len(p) == len(w):
            return np.asarray(w)
        if len(p) == 2:
            return np.array([-p[1] * w[0], p[0] * w[0]])
        if kind == "JointModelPlanar":
            c, s = p[2:]
            return np.array([c * w[0] - s * w[1], s * w[0] + c * w[1], -s * w[2], c * w[2]])
        turned = (pin.Quaternion(p[-4:]) * pin.Quaternion(np.append(0.5 * w[-3:], 0.0))).coeffs()
        if len(p) == 4:
            return np.asarray(turned)
        return np.append(pin.Quaternion(p[-4:]).normalized().matrix() @ w[:3], turned)

    return lambda q, v: np.concatenate([of(kind, q[a], v[b]) for kind, a, b in joints])


def integrate(
    model: pin.Model,
    q0: Array,
    v0: Array,
    times: Array,
    tau: Torques = free,
    *,
    rtol: float = 1e-12,
    stops: tuple[float, ...] = (),
) -> tuple[Array, Array]:
    """Return q (T, nq) and v (T, nv) at times (T,), by ABA with torques tau(t, q, v).

    stops: times at which the torques jump; they are called with times between two stops only,
    so that no step sees the other side.
    """
    data, nq, q_rate = model.createData(), model.nq, kinematics(model)

    def rate(t: float, y: Array) -> Array:
        q, v = pin.normalize(model, y[:nq]), y[nq:]
        return np.concatenate([q_rate(y[:nq], v), pin.aba(model, data, q, v, tau(t, q, v))])

    ends = [0.0, *(s for s in stops if 0.0 < s < times[-1]), float(times[-1])]
    y, rows = np.concatenate([q0, v0]), np.empty((len(times), nq + model.nv))
    for a, b in pairwise(ends):
        inside = (times >= a) & (times <= b)
        middle = 1e-9 * (b - a)

        def piece(t: float, y: Array, a: float = a, b: float = b, e: float = middle) -> Array:
            return rate(min(max(t, a + e), b - e), y) if len(stops) else rate(t, y)

        found = solve_ivp(
            piece, (a, b), y, method="DOP853", rtol=rtol, atol=0.1 * rtol,
            t_eval=np.append(times[inside], b) if not inside.any() or times[inside][-1] < b
            else times[inside],
        )  # fmt: skip
        rows[inside] = found.y.T[: inside.sum()]
        y = found.y[:, -1]
    q = np.array([pin.normalize(model, row) for row in rows[:, :nq]])
    return q, rows[:, nq:]


def apart(model: pin.Model, q: Array, other: Array) -> float:
    """Largest entry of the difference between configurations (T, nq) [rad | m]."""
    pairs = zip(q, other, strict=True)
    return float(max(np.abs(pin.difference(model, a, b)).max(initial=0.0) for a, b in pairs))


def body_momentum(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
    """Momentum (6,) in the frame of the first body, without its linear part, about the CoM."""
    pin.ccrba(model, data, q, v)
    return np.append(np.zeros(3), data.oMi[1].rotation.T @ data.hg.angular)


def momentum_about_com(model: pin.Model, q: Array, v: Array) -> Array:
    """Angular momentum (T, 3) about the centre of mass, in the world's axes."""
    data, out = model.createData(), []
    for row, rate in zip(q, v, strict=True):
        pin.ccrba(model, data, row, rate)
        out.append(data.hg.angular.copy())
    return np.array(out)

"""Full simulation by Pinocchio's ABA under SciPy: an independent reference for many tests."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from pinred.common.arrays import Array

Torques = Callable[[float, Array, Array], Array]


def free(_t: float, _q: Array, v: Array) -> Array:
    """Return zero torques."""
    return np.zeros(len(v))


def kinematics(model: pin.Model) -> Callable[[Array, Array], Array]:
    """Return the function (q, v) → dq/dt, assembled from the joint types of a model."""
    joints = [
        (j.shortname(), slice(j.idx_q, j.idx_q + j.nq), slice(j.idx_v, j.idx_v + j.nv))
        for j in list(model.joints)[1:]
    ]

    def joint_rate(joint_type: str, p: Array, w: Array) -> Array:
        if joint_type == "JointModelComposite":  # a prismatic joint followed by a planar joint
            return np.append(w[0], joint_rate("JointModelPlanar", p[1:], w[1:]))
        if len(p) == len(w):
            return np.asarray(w)
        if len(p) == 2:
            return np.array([-p[1] * w[0], p[0] * w[0]])
        if joint_type == "JointModelPlanar":
            c, s = p[2:]
            return np.array([c * w[0] - s * w[1], s * w[0] + c * w[1], -s * w[2], c * w[2]])
        quaternion_rate = (
            pin.Quaternion(p[-4:]) * pin.Quaternion(np.append(0.5 * w[-3:], 0.0))
        ).coeffs()
        if len(p) == 4:
            return np.asarray(quaternion_rate)
        return np.append(pin.Quaternion(p[-4:]).normalized().matrix() @ w[:3], quaternion_rate)

    return lambda q, v: np.concatenate(
        [joint_rate(joint_type, q[a], v[b]) for joint_type, a, b in joints]
    )


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
    """Integrate the full equations of motion by ABA.

    Args:
        model: Pinocchio model.
        q0: Initial configuration, (nq,).
        v0: Initial velocity, (nv,).
        times: Report times, (T,), starting at 0 [s].
        tau: Joint torques as a function of t, q and v.
        rtol: Relative tolerance of DOP853.
        stops: Times at which the torques jump [s]. The torques are only evaluated strictly between
            two stops, so that no step evaluates them beyond a jump.
    Returns:
        Configurations q (T, nq) and velocities v (T, nv) at the report times.
    """
    data, nq, q_rate = model.createData(), model.nq, kinematics(model)

    def rate(t: float, y: Array) -> Array:
        q, v = pin.normalize(model, y[:nq]), y[nq:]
        return np.concatenate([q_rate(y[:nq], v), pin.aba(model, data, q, v, tau(t, q, v))])

    breaks = [0.0, *(s for s in stops if 0.0 < s < times[-1]), float(times[-1])]
    y, states = np.concatenate([q0, v0]), np.empty((len(times), nq + model.nv))
    for a, b in pairwise(breaks):
        inside = (times >= a) & (times <= b)
        margin = 1e-9 * (b - a)

        def segment_rate(
            t: float, y: Array, a: float = a, b: float = b, e: float = margin
        ) -> Array:
            return rate(min(max(t, a + e), b - e), y) if len(stops) else rate(t, y)

        solution = solve_ivp(
            segment_rate, (a, b), y, method="DOP853", rtol=rtol, atol=0.1 * rtol,
            t_eval=np.append(times[inside], b) if not inside.any() or times[inside][-1] < b
            else times[inside],
        )  # fmt: skip
        states[inside] = solution.y.T[: inside.sum()]
        y = solution.y[:, -1]
    q = np.array([pin.normalize(model, row) for row in states[:, :nq]])
    return q, states[:, nq:]


def max_difference(model: pin.Model, q: Array, other: Array) -> float:
    """Return the largest difference between configurations (T, nq) [rad | m]."""
    pairs = zip(q, other, strict=True)
    return float(max(np.abs(pin.difference(model, a, b)).max(initial=0.0) for a, b in pairs))


def body_momentum(model: pin.Model, data: pin.Data, q: Array, v: Array) -> Array:
    """Return the momentum about the centre of mass in the frame of the first body, (6,).

    The linear part is set to zero.
    """
    pin.ccrba(model, data, q, v)
    return np.append(np.zeros(3), data.oMi[1].rotation.T @ data.hg.angular)


def momentum_about_com(model: pin.Model, q: Array, v: Array) -> Array:
    """Return the angular momentum about the centre of mass in world axes, (T, 3)."""
    data, momenta = model.createData(), []
    for q_t, v_t in zip(q, v, strict=True):
        pin.ccrba(model, data, q_t, v_t)
        momenta.append(data.hg.angular.copy())
    return np.array(momenta)

"""The full dynamics as a CasADi graph, from the textbook: what one has without a reduction.

Featherstone's articulated-body algorithm (Rigid Body Dynamics Algorithms, 2008, table 7.1) in
body coordinates, on the state (root, x, v) of full_vector_field.py. It shares nothing with pinred's
engine; zeros of constant placements and inertias are left out by CasADi's sparsity.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin

from ....common.arrays import Array
from ....lie.group import Group
from ....system.system import System


def full_graph(system: System) -> ca.Function:
    """Return the Function y → dy/dt of a system without forces but its gravity."""
    size, r, m = system.group.size, system.r, system.m
    y = ca.SX.sym("y", size + m + system.n)
    root, x, v = y[:size], y[size : size + m], y[size + m :]
    turn = _root_rotation(system.group, root)
    pull = ca.sparsify(ca.SX(-system.model.jointPlacements[1].rotation.T @ system.gravity))
    acceleration = _articulated(system, x, v, ca.mtimes(turn.T, pull))
    rate = ca.vertcat(_root_rate(system.group, root, v[:r], turn), v[r:], acceleration)
    return ca.Function("full", [y], [ca.densify(rate)], {"cse": True})


def _articulated(system: System, x: ca.SX, v: ca.SX, pull: ca.SX) -> ca.SX:
    """Return dv/dt.  pull: (3,) minus gravity, in the axes of the root's body."""
    model, r = system.model, system.r
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes = [np.array(data.joints[i].S).reshape(6, -1) for i in range(1, model.njoints)]
    inertia = [_constant(model.inertias[i].matrix()) for i in range(1, model.njoints)]
    steps, twists = [ca.SX(6, 6)], [ca.mtimes(_constant(axes[0]), v[:r])]
    bias = [ca.SX(6, 1)]
    for k in range(1, len(axes)):
        S = _constant(axes[k])
        X = _step(model.jointPlacements[k + 1], axes[k][:, 0], x[k - 1])
        own = S * v[r + k - 1]
        twist = ca.mtimes(X, twists[model.parents[k + 1] - 1]) + own
        steps.append(X)
        twists.append(twist)
        bias.append(ca.mtimes(_cross(twist), own))
    force = [
        ca.mtimes(-_cross(twist).T, ca.mtimes(I, twist))
        for twist, I in zip(twists, inertia, strict=True)
    ]
    left: dict[int, tuple[ca.SX, ca.SX, ca.SX]] = {}
    for k in range(len(axes) - 1, 0, -1):
        S, parent = _constant(axes[k]), model.parents[k + 1] - 1
        U = ca.mtimes(inertia[k], S)
        D = ca.mtimes(S.T, U) + float(model.armature[r + k - 1])
        u = -ca.mtimes(S.T, force[k])
        left[k] = (U, D, u)
        I = inertia[k] - ca.mtimes(U, U.T) / D
        p = force[k] + ca.mtimes(I, bias[k]) + U * (u / D)
        inertia[parent] += ca.mtimes(steps[k].T, ca.mtimes(I, steps[k]))
        force[parent] += ca.mtimes(steps[k].T, p)
    S = _constant(axes[0])
    lift = ca.vertcat(pull, ca.SX(3, 1))
    H = ca.mtimes(S.T, ca.mtimes(inertia[0], S)) + ca.SX(ca.diag(ca.DM(model.armature[:r])))
    load = -ca.mtimes(S.T, force[0] + ca.mtimes(inertia[0], lift))
    root = _solved(ca.densify(H), load)
    out, accelerations = [root], [lift + ca.mtimes(S, root)]
    for k in range(1, len(axes)):
        U, D, u = left[k]
        a = ca.mtimes(steps[k], accelerations[model.parents[k + 1] - 1]) + bias[k]
        rate = (u - ca.mtimes(U.T, a)) / D
        out.append(rate)
        accelerations.append(a + _constant(axes[k]) * rate)
    return ca.vertcat(*out)


def _constant(matrix: Array) -> ca.SX:
    return ca.sparsify(ca.SX(matrix))


def _skew(p: ca.SX) -> ca.SX:
    return ca.sparsify(ca.skew(p))


def _step(place: pin.SE3, axis: Array, x: ca.SX) -> ca.SX:
    """Return the matrix that takes a twist [linear; angular] from the parent to the child."""
    R, p = _constant(place.rotation), ca.SX(place.translation)
    if axis[:3].any():
        p = p + ca.mtimes(R, ca.SX(axis[:3])) * x
    else:
        K = _constant(np.asarray(pin.skew(axis[3:])))
        R = ca.mtimes(R, ca.SX.eye(3) + ca.sin(x) * K + (1.0 - ca.cos(x)) * ca.mtimes(K, K))
    E = ca.sparsify(R).T
    return ca.blockcat([[E, -ca.mtimes(E, _skew(p))], [ca.SX(3, 3), E]])


def _cross(twist: ca.SX) -> ca.SX:
    """Return the matrix of the bracket with a twist."""
    v, w = _skew(twist[:3]), _skew(twist[3:])
    return ca.blockcat([[w, v], [ca.SX(3, 3), w]])


def _solved(H: ca.SX, b: ca.SX) -> ca.SX:
    """Return H⁻¹ b of a positive definite matrix, by Cholesky without square roots."""
    n = H.size1()
    L, D, z = ca.SX.eye(n), [ca.SX(0)] * n, [ca.SX(0)] * n
    for j in range(n):
        D[j] = H[j, j] - sum((L[j, k] ** 2 * D[k] for k in range(j)), ca.SX(0))
        for i in range(j + 1, n):
            taken = sum((L[i, k] * L[j, k] * D[k] for k in range(j)), ca.SX(0))
            L[i, j] = (H[i, j] - taken) / D[j]
        z[j] = b[j] - sum((L[j, k] * z[k] for k in range(j)), ca.SX(0))
    out = [ca.SX(0)] * n
    for j in reversed(range(n)):
        out[j] = z[j] / D[j] - sum((L[i, j] * out[i] for i in range(j + 1, n)), ca.SX(0))
    return ca.vertcat(*out)


def _root_rotation(group: Group, root: ca.SX) -> ca.SX:
    """Return the rotation matrix of the root's body against the joint's fixed frame."""
    if group.turns == 3:
        x, y, z, w = (root[root.numel() - 4 + k] for k in range(4))
        K = ca.skew(ca.vertcat(x, y, z))
        return ca.SX.eye(3) + 2.0 * w * K + 2.0 * ca.mtimes(K, K)
    if group.plane:
        c, s = ca.cos(root[group.linear]), ca.sin(root[group.linear])
        return ca.sparsify(ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
    # A mere axis is along gravity, or feels none: nothing depends on its angle.
    return ca.SX.eye(3)


def _root_rate(group: Group, root: ca.SX, v: ca.SX, turn: ca.SX) -> ca.SX:
    if not group.plane and group.turns < 3:
        return v
    k, axes = group.linear, list(group.axes[: group.linear])
    spin = v[k:]
    if group.plane:
        return ca.vertcat(ca.mtimes(turn[axes, axes], v[:k]), spin)
    x, w = root[k : k + 3], root[k + 3]
    attitude = 0.5 * ca.vertcat(w * spin + ca.cross(x, spin), -ca.dot(x, spin))
    return ca.vertcat(ca.mtimes(turn, v[:3]), attitude) if k else attitude

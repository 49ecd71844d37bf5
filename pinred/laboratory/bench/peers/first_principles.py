"""The full (unreduced) dynamics as a CasADi graph, following a textbook.

Featherstone's articulated-body algorithm (Rigid Body Dynamics Algorithms, 2008, table 7.1) in
body coordinates, on the state (root, x, v) of full_vector_field.py. It shares no code with pinred's
engine. CasADi's sparsity removes operations with zeros of constant placements and inertias.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin

from ....common.arrays import Array
from ....lie.group import Group
from ....system.system import System


def full_graph(system: System) -> ca.Function:
    """Build the Function y → dy/dt of a system under gravity alone."""
    size, r, m = system.group.size, system.r, system.m
    y = ca.SX.sym("y", size + m + system.n)
    root, x, v = y[:size], y[size : size + m], y[size + m :]
    rotation = _root_rotation(system.group, root)
    lift = ca.sparsify(ca.SX(-system.model.jointPlacements[1].rotation.T @ system.gravity))
    acceleration = _articulated(system, x, v, ca.mtimes(rotation.T, lift))
    rate = ca.vertcat(_root_rate(system.group, root, v[:r], rotation), v[r:], acceleration)
    return ca.Function("full", [y], [ca.densify(rate)], {"cse": True})


def _articulated(system: System, x: ca.SX, v: ca.SX, lift: ca.SX) -> ca.SX:
    """Compute dv/dt.  lift: (3,) negative gravity in the axes of the root body."""
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
        joint_twist = S * v[r + k - 1]
        twist = ca.mtimes(X, twists[model.parents[k + 1] - 1]) + joint_twist
        steps.append(X)
        twists.append(twist)
        bias.append(ca.mtimes(_cross(twist), joint_twist))
    force = [
        ca.mtimes(-_cross(twist).T, ca.mtimes(I, twist))
        for twist, I in zip(twists, inertia, strict=True)
    ]
    saved: dict[int, tuple[ca.SX, ca.SX, ca.SX]] = {}
    for k in range(len(axes) - 1, 0, -1):
        S, parent = _constant(axes[k]), model.parents[k + 1] - 1
        U = ca.mtimes(inertia[k], S)
        D = ca.mtimes(S.T, U) + float(model.armature[r + k - 1])
        u = -ca.mtimes(S.T, force[k])
        saved[k] = (U, D, u)
        I = inertia[k] - ca.mtimes(U, U.T) / D
        p = force[k] + ca.mtimes(I, bias[k]) + U * (u / D)
        inertia[parent] += ca.mtimes(steps[k].T, ca.mtimes(I, steps[k]))
        force[parent] += ca.mtimes(steps[k].T, p)
    S = _constant(axes[0])
    base = ca.vertcat(lift, ca.SX(3, 1))  # gravity as an acceleration of the frame
    H = ca.mtimes(S.T, ca.mtimes(inertia[0], S)) + ca.SX(ca.diag(ca.DM(model.armature[:r])))
    load = -ca.mtimes(S.T, force[0] + ca.mtimes(inertia[0], base))
    root = _solve_by_cholesky(ca.densify(H), load)
    rates, accelerations = [root], [base + ca.mtimes(S, root)]
    for k in range(1, len(axes)):
        U, D, u = saved[k]
        a = ca.mtimes(steps[k], accelerations[model.parents[k + 1] - 1]) + bias[k]
        rate = (u - ca.mtimes(U.T, a)) / D
        rates.append(rate)
        accelerations.append(a + _constant(axes[k]) * rate)
    return ca.vertcat(*rates)


def _constant(matrix: Array) -> ca.SX:
    return ca.sparsify(ca.SX(matrix))


def _skew(p: ca.SX) -> ca.SX:
    return ca.sparsify(ca.skew(p))


def _step(place: pin.SE3, axis: Array, x: ca.SX) -> ca.SX:
    """Return the matrix that transforms a twist [linear; angular] from parent to child."""
    R, p = _constant(place.rotation), ca.SX(place.translation)
    if axis[:3].any():
        p = p + ca.mtimes(R, ca.SX(axis[:3])) * x
    else:
        K = _constant(np.asarray(pin.skew(axis[3:])))
        R = ca.mtimes(R, ca.SX.eye(3) + ca.sin(x) * K + (1.0 - ca.cos(x)) * ca.mtimes(K, K))
    E = ca.sparsify(R).T
    return ca.blockcat([[E, -ca.mtimes(E, _skew(p))], [ca.SX(3, 3), E]])


def _cross(twist: ca.SX) -> ca.SX:
    """Return the matrix ad of the Lie bracket with a twist."""
    v, w = _skew(twist[:3]), _skew(twist[3:])
    return ca.blockcat([[w, v], [ca.SX(3, 3), w]])


def _solve_by_cholesky(H: ca.SX, b: ca.SX) -> ca.SX:
    """Return H⁻¹ b for a positive definite H, by LDLᵀ decomposition."""
    n = H.size1()
    L, D, z = ca.SX.eye(n), [ca.SX(0)] * n, [ca.SX(0)] * n
    for j in range(n):
        D[j] = H[j, j] - sum((L[j, k] ** 2 * D[k] for k in range(j)), ca.SX(0))
        for i in range(j + 1, n):
            product = sum((L[i, k] * L[j, k] * D[k] for k in range(j)), ca.SX(0))
            L[i, j] = (H[i, j] - product) / D[j]
        z[j] = b[j] - sum((L[j, k] * z[k] for k in range(j)), ca.SX(0))
    solution = [ca.SX(0)] * n
    for j in reversed(range(n)):
        solution[j] = z[j] / D[j] - sum((L[i, j] * solution[i] for i in range(j + 1, n)), ca.SX(0))
    return ca.vertcat(*solution)


def _root_rotation(group: Group, root: ca.SX) -> ca.SX:
    """Return the rotation matrix of the root body relative to the joint's fixed frame."""
    if group.turns == 3:
        x, y, z, w = (root[root.numel() - 4 + k] for k in range(4))
        K = ca.skew(ca.vertcat(x, y, z))
        return ca.SX.eye(3) + 2.0 * w * K + 2.0 * ca.mtimes(K, K)
    if group.plane:
        c, s = ca.cos(root[group.linear]), ca.sin(root[group.linear])
        return ca.sparsify(ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
    # A single rotation axis is parallel to gravity (if any), so its angle has no effect.
    return ca.SX.eye(3)


def _root_rate(group: Group, root: ca.SX, v: ca.SX, rotation: ca.SX) -> ca.SX:
    if not group.plane and group.turns < 3:
        return v
    k, axes = group.linear, list(group.axes[: group.linear])
    spin = v[k:]
    if group.plane:
        return ca.vertcat(ca.mtimes(rotation[axes, axes], v[:k]), spin)
    x, w = root[k : k + 3], root[k + 3]
    attitude = 0.5 * ca.vertcat(w * spin + ca.cross(x, spin), -ca.dot(x, spin))
    return ca.vertcat(ca.mtimes(rotation, v[:3]), attitude) if k else attitude

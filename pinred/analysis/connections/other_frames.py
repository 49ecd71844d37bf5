"""A connection in another frame: another link as the base, or another section of the bundle.

A frame with the pose h(x) ∈ G relative to the base moves with g′ = g h, so that

    ξ′ = Ad_{h⁻¹} ξ + h⁻¹ḣ,   A′ = Ad_{h⁻¹} A − h⁻¹∂h,   B′ = Ad_{h⁻¹} B,

and a cycle from x₀ has the phase h(x₀)⁻¹ g h(x₀).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from ...common.argument_kinds import call_function
from ...common.arrays import Array
from ...common.differences import central_differences
from ...common.errors import InputError
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...lie.group import Group
from ...reduction.tree.momenta import in_space, root_twist
from ...system.system import System
from .links import link_jacobian, link_named

Twist = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
_STEP = 5e-3  # step of the finite differences of order 6 [rad | m]
_OUTSIDE = 1e-9  # largest motion outside the group that counts as zero, relative to the Jacobian
_SAMPLES = 5  # number of random shapes at which motions are checked


def from_link(form: ConnectionForm, system: System, name: str) -> ConnectionForm:
    """Express a form in terms of the twist of a link instead of the twist of the root.

    Args:
        form: The form.
        system: The system.
        name: Name of the link.
    Returns:
        The new form.
    Raises:
        InputError: The link is unknown, or its motions are not in the group.
    """
    link, group = link_named(system, name, "the base"), system.group
    axes = list(group.axes)

    def entries(x: Array) -> Array:
        """Return the matrix that maps (ξ, ẋ) to ξ′, (r, n)."""
        J = link_jacobian(system, link, x)
        outside = [k for k in range(6) if k not in axes]
        if np.abs(J[outside]).max(initial=0.0) > _OUTSIDE * np.abs(J).max():
            raise InputError(
                f"'{name}' cannot be the base of '{system.name}': it has motions that are not in "
                f"{group.name}"
            )
        return J[axes]

    rng = np.random.default_rng(0)
    for _ in range(_SAMPLES):
        entries(system.space.random(rng, np.pi))

    def old(x: ca.SX, xi: ca.SX, xdot: ca.SX) -> ca.SX:
        return root_twist(system, x, link.joint - 1, link.placement, xi, xdot)

    return _transformed(form, old, entries, f"{form.what}, seen from '{name}'")


def in_section(form: ConnectionForm, pose: Callable[[ca.SX], ca.SX]) -> ConnectionForm:
    """Express a form in terms of the twist of a frame h(x) instead of the twist of the root.

    Args:
        form: The form.
        pose: Returns the pose coordinates of h, (size,), as CasADi expressions of x (m,).
    Returns:
        The transformed form.
    Raises:
        InputError: `pose` fails, or returns a wrong number of coordinates.
    """
    group, m = form.group, form.m
    y = ca.SX.sym("x", m)
    value = call_function(lambda y: ca.densify(ca.SX(pose(y))), "the section of a Connection", y)
    h = ca.Function("h", [y], [value])
    if h.numel_out(0) != group.size:
        raise InputError(
            f"a section of {group.name} gives {group.size} pose coordinates "
            f"({', '.join(group.pose_names)}), got {h.numel_out(0)}"
        )

    def at(x: Array) -> Array:
        return np.asarray(h(x)).ravel()

    def entries(x: Array) -> Array:
        inverse = group.inverse(at(x))

        def log_from(y: Array) -> Array:
            return group.log(group.compose(inverse, at(y)))

        return np.hstack([group.Ad(inverse), central_differences(log_from, x, _STEP)])

    def old(x: ca.SX, xi: ca.SX, xdot: ca.SX) -> ca.SX:
        value = h(x)
        R, p = _rotation(group, value), _translation(group, value)
        skew = R.T @ ca.reshape(ca.jtimes(ca.vec(R), x, xdot), 3, 3)
        linear, angular = in_space(group, xi)
        w = ca.vertcat(*angular) - ca.vertcat(skew[2, 1], skew[0, 2], skew[1, 0])
        v = ca.vertcat(*linear) - R.T @ ca.jtimes(p, x, xdot)
        twist = ca.vertcat(R @ v + ca.cross(p, R @ w), R @ w)
        return twist[list(group.axes)]

    return _transformed(form, old, entries, f"{form.what}, in another section")


def _transformed(
    form: ConnectionForm, old: Twist, entries: Callable[[Array], Array], what: str
) -> ConnectionForm:
    """Express a form in terms of the velocities (ξ′, ẋ) of the new frame.

    Args:
        form: The form in terms of (ξ, ẋ).
        old: Returns ξ from x, ξ′ and ẋ, as CasADi expressions.
        entries: Returns the matrix that maps (ξ, ẋ) to ξ′, (r, n), at a shape.
        what: Short description for messages.
    Returns:
        The new form.
    """
    r = form.r

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        old_velocity = ca.vertcat(old(x, v[:r], v[r:]), v[r:])
        F = form.values(x, old_velocity)
        return ca.jtimes(old_velocity, v, F, True) if form.symmetric else F

    def reference(x: Array) -> Array:
        n = form.r + form.m
        change = np.eye(n)
        change[:r] = entries(x)
        T = np.linalg.inv(change)
        G = form.reference(x) @ T
        return np.asarray(T.T @ G if form.symmetric else G)

    def locked(x: ca.SX) -> ca.SX:
        xi = ca.SX.sym("xi", r)
        T = ca.densify(ca.jacobian(old(x, xi, ca.SX.zeros(form.m, 1)), xi))
        P = ca.reshape(form.locked(x), r, r) @ T
        return T.T @ P if form.symmetric else P

    return form_of(
        form.group, form.joints, form.units, what, values, reference,
        symmetric=form.symmetric, momentum=form.momentum, locked=locked, space=form.space,
    )  # fmt: skip


def _rotation(group: Group, pose: ca.SX) -> ca.SX:
    """Return the rotation matrix of a pose, (3, 3)."""
    if group.turns == 0:
        return ca.SX.eye(3)
    if group.turns == 1:
        c, s = ca.cos(pose[-1]), ca.sin(pose[-1])
        return ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    x, y, z, w = (pose[group.size - 4 + k] for k in range(4))
    return ca.blockcat(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _translation(group: Group, pose: ca.SX) -> ca.SX:
    """Return the translation of a pose, (3,)."""
    entries = [ca.SX(0)] * 3
    for k, axis in enumerate(group.axes[: group.linear]):
        entries[axis] = pose[k]
    column: ca.SX = ca.vertcat(*entries)
    return column

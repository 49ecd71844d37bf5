"""Symbols of which forces are functions, and columns of what they give."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

from ..reduction.tree.all_joints import joint_rates, joint_values
from ..system.coupling import following
from ..system.force_interface import Load, SeenState
from ..system.system import System
from .force import Symbols, Terms
from .named_arrays import Column


def symbols_of(system: System, within: ca.SX | None) -> tuple[Symbols, tuple[ca.SX, ...]]:
    """Return the variables of forces, and those of the base in space among them.

    These are pose, body twist, body momentum and spatial momentum.  What forces see of the base
    is made of them only where it is not known from the frame of the centre of mass already.
    """
    r, group = system.r, system.group
    t, xi, mu = ca.SX.sym("t"), ca.SX.sym("xi", r), ca.SX.sym("mu", r)
    x, xdot = _column(system, "x", joint_values), _column(system, "xdot", joint_rates)
    pose, twist = ca.SX.sym("pose", group.size), ca.SX.sym("twist", r)
    momentum, J = ca.SX.sym("momentum", r), ca.SX.sym("J", r)
    k = group.linear
    seen = SeenState(
        t=t,
        x=x,
        xdot=xdot,
        pose=pose,
        xi=ca.vertcat(*ca.vertsplit(twist)[:k], *ca.vertsplit(xi)[k:]),
        mu=momentum if k else mu,
        J=J if k or group.turns == 3 else mu,
    )
    followers = {name: following(name, system.couplings) for name in system.followers}
    symbols = Symbols(
        names=system.shape_names, followers=followers, t=t, x=x, xdot=xdot, xi=xi, mu=mu,
        seen=seen, within=within,
    )  # fmt: skip
    return symbols, (pose, twist, momentum, J)


def seen_of_base(system: System, everything: ca.SX, base: tuple[ca.SX, ...]) -> tuple[bool, bool]:
    """Return whether expressions depend on the attitude, and on place or speed of the base.

    base: its symbols, as `symbols_of` gives them.
    """
    k, (pose, *others) = system.group.linear, base
    coordinates = ca.vertsplit(pose)
    place, turned = [*coordinates[:k], *others], coordinates[k:]
    if not k:
        place, turned = [], [*turned, *others]
    attitude, where = (ca.vertcat(ca.SX(0, 1), *each) for each in (turned, place))
    return ca.depends_on(everything, attitude), ca.depends_on(everything, where)


def _column(system: System, what: str, on_joints: Callable[..., list[Any]]) -> Column:
    """Return the symbols of the shape or its rate, with the expressions of what follows it."""
    symbols = ca.SX.sym(what, system.m)
    if system.coupled is None:
        return Column(symbols, system.shape_names, what)
    every = on_joints(system, ca.vertsplit(symbols))
    followers = [ca.SX(every[system.joint_number(name)]) for name in system.followers]
    return Column(symbols, (*system.shape_names, *system.followers), what, followers)


def torque_column(terms: Terms, system: System) -> ca.SX:
    """Return the torques (m,) on the shape."""
    column = ca.SX(system.m, 1)
    for k, value in sorted(terms.torque.items()):
        i, ratio = through(system, k)
        column[i] += ratio * value
    return column


def through(system: System, k: int) -> tuple[int, float]:
    """Return the shape coordinate on which what acts on a joint acts, and by what factor."""
    if k < system.m or system.coupled is None:
        return k, 1.0
    j = system.joint_number(system.followers[k - system.m])
    return int(system.coupled.of[j]), float(system.coupled.ratio[j])


def wrench_column(terms: Terms, r: int) -> ca.SX:
    """Return the wrench (r,) on the base."""
    entries: list[Any] = terms.wrench if terms.wrench is not None else [0.0] * r
    column: ca.SX = ca.vertcat(*entries)
    return column


def load_column(load: Load) -> ca.SX:
    """Return what a load is, (9,): its entries, with zeros to six, and its point."""
    padding = [0.0] * (6 - len(load.entries))
    column: ca.SX = ca.vertcat(*load.entries, *padding, *load.at)
    return column

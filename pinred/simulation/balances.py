"""Balances: what forces have done, integrated along a motion after the fact.

Energy changes by the work of the forces without a potential, and of the drives of the
prescribed joints; momentum by the impulse of wrenches and of gravity.  Power and wrench are
integrated over every step of the motion through Gauss's 8 points, so that a simulation pays
nothing for them until somebody asks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.polynomial import legendre

from ..common.arrays import Array, freeze
from ..forces.acting import ForceInputs
from ..system.joints import axes_of
from ..system.state_fields import State, with_base
from .driving_torques import driving_torques
from .pieces import Motion
from .plan import Plan

_POINTS = 8
_DRIVES = "prescribed joints"


@dataclass(frozen=True)
class EnergyBalance:
    """The balance of energy and work; arrays are read-only.

    t: (T,) [s].  energy: (T,) [J].  work: (T, K) done since the start by each of `labels`.
    """

    t: Array
    energy: Array
    labels: tuple[str, ...]
    work: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def residual(self) -> Array:
        """E(t) − E(0) − work, (T,) [J]: zero but for the error of the integration."""
        return np.asarray(self.energy - self.energy[0] - self.work.sum(axis=1) + self.work[0].sum())

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        rows = [
            ("energy at the start", float(self.energy[0])),
            *((f"work of {k}", float(w)) for k, w in zip(self.labels, self.work[-1], strict=True)),
            ("energy at the end", float(self.energy[-1])),
            ("largest residual", float(np.abs(self.residual).max())),
        ]
        return card("Energy", f"balance to {self.t[-1]:g} s", table("", ["", "J"], rows))


@dataclass(frozen=True)
class MomentumBalance:
    """The balance of momentum and impulse; arrays are read-only.

    t: (T,) [s].  momentum, impulse: (T, r) J and what wrenches and gravity have given since
    the start, in the root joint's fixed frame about its origin.
    """

    t: Array
    momentum: Array
    impulse: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def residual(self) -> Array:
        """J(t) − J(0) − impulse, (T, r): zero but for the error of the integration."""
        return np.asarray(self.momentum - self.momentum[0] - self.impulse + self.impulse[0])

    def _repr_html_(self) -> str:
        from ..common.html import card, table

        J, worst = self.momentum, np.abs(self.residual).max(axis=0)
        columns = np.column_stack([J[0], self.impulse[-1], J[-1], worst])
        rows = [[str(k), *row.tolist()] for k, row in enumerate(columns)]
        head = ["component", "start", "impulse", "end", "largest residual"]
        return card("Spatial momentum", f"balance to {self.t[-1]:g} s", table("", head, rows))


def energy_balance(plan: Plan, motion: Motion, states: State) -> EnergyBalance:
    """Return the energy balance of a motion at the times of some states."""
    forces = plan.forces
    if forces is None or not (forces.labels or forces.joints):
        none = np.zeros((len(states.t), 0))
        return EnergyBalance(states.t, states.energy, (), none)
    labels = (*forces.labels, *([_DRIVES] if forces.joints else []))

    def powers(t: Array) -> Array:
        seen, full = motion.samples(t), with_base(motion.states(t), plan.system.name)
        out = np.empty((len(t), len(labels)))
        for k, (s, numbers) in enumerate(seen):
            out[k, : len(forces.labels)] = forces.powers(
                ForceInputs(float(t[k]), s.x, s.xdot, s.xi, s.mu, numbers, s.base), full.xi[k]
            )
        if forces.joints:
            drive = driving_torques(plan, t, seen)
            out[:, -1] = np.sum(drive * full.xdot[:, list(forces.joints)], axis=1)
        return out

    return EnergyBalance(states.t, states.energy, labels, _integral(motion, states.t, powers))


def momentum_balance(plan: Plan, motion: Motion, states: State) -> MomentumBalance:
    """Return the momentum balance of a motion at the times of some states."""
    system, forces = plan.system, plan.forces
    axes, weight = axes_of(system.model.joints[1]), system.mass * system.gravity
    # About the root's place, from which arms are counted, not the world's origin: a robot that is
    # balanced there has none, and no round-off of one.
    model, data = system.model.copy(), system.data
    rotation = model.jointPlacements[1].rotation.copy()
    model.jointPlacements[1].translation = np.zeros(3)

    def impulses(t: Array) -> Array:
        full = with_base(motion.states(t), system.name)
        out = np.empty((len(t), system.r))
        for k, q in enumerate(full.q):
            parts = np.append(weight, np.cross(pin.centerOfMass(model, data, q), weight))
            out[k] = axes.T @ (parts.reshape(2, 3) @ rotation).ravel()
        if forces is not None and plan.acting.wrench:
            body = [
                forces.acting(
                    ForceInputs(float(time), s.x, s.xdot, s.xi, s.mu, numbers, s.base)
                ).wrench
                for time, (s, numbers) in zip(t, motion.samples(t), strict=True)
            ]
            out += system.group.spatial_momentum(full.pose, np.array(body))
        return out

    impulse = np.zeros((len(states.t), system.r))
    if plan.acting.wrench or weight.any():
        impulse = _integral(motion, states.t, impulses)
    return MomentumBalance(states.t, states.spatial_momentum, impulse)


def _integral(motion: Motion, t: Array, integrand: Callable[[Array], Array]) -> Array:
    """Return the integrals from 0 to times t (T,) of an integrand (T,) → (T, K).

    In every step, by the integral of its Legendre series through Gauss's points.
    """
    ends = motion.knots[: np.searchsorted(motion.knots, t[-1]) + 1]
    if len(ends) < 2:
        ends = motion.knots[:2]
    points, weights = legendre.leggauss(_POINTS)
    half = 0.5 * np.diff(ends)
    middle = ends[:-1] + half
    nodes = middle[:, None] + half[:, None] * points
    values = integrand(nodes.ravel()).reshape(*nodes.shape, -1)
    degree = np.arange(_POINTS)
    basis = legendre.legvander(points, _POINTS - 1) * weights[:, None] * (degree + 0.5)
    series = np.einsum("spk,pn,s->snk", values, basis, half)
    whole = np.concatenate([np.zeros_like(series[:1, 0]), np.cumsum(2.0 * series[:, 0], axis=0)])
    step = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(half) - 1)
    P = legendre.legvander((t - middle[step]) / half[step], _POINTS)
    # ∫ P_n from −1 is (P_{n+1} − P_{n−1})/(2n + 1), with P_{−1} = −1.
    before = np.concatenate([-np.ones((len(t), 1)), P[:, : _POINTS - 1]], axis=1)
    inside = (P[:, 1:] - before) / (2 * degree + 1)
    return np.asarray(whole[step] + np.einsum("tn,tnk->tk", inside, series[step]))

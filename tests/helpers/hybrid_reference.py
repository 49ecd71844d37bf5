"""Motions with joint stops by full-state dynamics: an independent route to impacts and rests.

The state is (q, v) of Pinocchio with the unwrapped position s of each rate. Between impacts,
`pin.aba` and SciPy's DOP853 integrate it. At an impact, H Δv = Σ λ_i e_i with the mass matrix of
RNEA. Joints at rest and followers have multipliers of the full equations of motion. Nothing of the
reduction is used.

A stop of a ball is an inequality tr(W R) ≥ c of its rotation matrix R. With body rates ω,
d/dt tr(W R) = tr(W R ω̂), and tr(W R ω̂ ω̂) remains at constant rates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, combinations
from typing import cast

import numpy as np
import pinocchio as pin
from scipy.integrate import DOP853
from scipy.optimize import brentq

import pinred
from pinred.common.arrays import Array

Torque = Callable[[float, Array, Array], Array]  # (t, q, v) → generalised force (nv,)


@dataclass(frozen=True)
class Hit:
    """An impact: its time, the joints and their impulses, and the energy that it removes."""

    t: float
    joints: tuple[str, ...]
    impulses: Array
    lost: float


@dataclass
class HybridMotion:
    """A motion: impacts, mode changes (time, resting joints), and states at requested times."""

    hits: list[Hit] = field(default_factory=list)
    modes: list[tuple[float, tuple[str, ...]]] = field(default_factory=list)
    q: list[Array] = field(default_factory=list)
    v: list[Array] = field(default_factory=list)


AnyStop = pinred.Stop | pinred.BallStop


def stops_of(traj: pinred.Trajectory) -> dict[str, AnyStop]:
    """Return the stops of a trajectory's scene, which stores them parsed."""
    return dict(cast("Mapping[str, AnyStop]", traj.scene.stops))


@dataclass(frozen=True)
class BallForm:
    """An inequality tr(W R) ≥ c of the attitude R of a ball, at coordinates `q` and rates `v`."""

    W: Array
    c: float
    q: slice
    v: slice

    def attitude(self, q: Array) -> Array:
        """Return the rotation matrix."""
        own = q[self.q] / np.linalg.norm(q[self.q])
        return np.array(pin.Quaternion(own).toRotationMatrix())

    def gap(self, q: Array) -> float:
        """Return tr(W R) − c."""
        return float(np.trace(self.W @ self.attitude(q))) - self.c

    def row(self, q: Array) -> Array:
        """Return the gradient along the rates of the ball, (3,)."""
        A = self.W @ self.attitude(q)
        return np.array([A[1, 2] - A[2, 1], A[2, 0] - A[0, 2], A[0, 1] - A[1, 0]])

    def bias(self, q: Array, v: Array) -> float:
        """Return the second derivative at constant rates."""
        turn = pin.skew(v[self.v])
        return float(np.trace(self.W @ self.attitude(q) @ turn @ turn))


def ball_forms(stop: pinred.BallStop, joint: pin.JointModel) -> list[BallForm]:
    """Return the inequalities of a ball: of its angle, its swing and its twist."""
    places = slice(joint.idx_q, joint.idx_q + 4), slice(joint.idx_v, joint.idx_v + 3)
    n, forms = np.array(stop.axis), []
    if np.isfinite(stop.angle):
        forms.append(BallForm(np.eye(3), 1.0 + 2.0 * np.cos(stop.angle), *places))
    if np.isfinite(stop.swing):
        forms.append(BallForm(np.outer(n, n), np.cos(stop.swing), *places))
    for sign, twist in zip((1.0, -1.0), stop.twist, strict=True):
        if np.isfinite(twist):  # sin(τ − twist), times a positive factor
            W = -np.cos(twist) * pin.skew(n) - np.sin(twist) * (np.eye(3) - np.outer(n, n))
            forms.append(BallForm(sign * W, 0.0, *places))
    return forms


def configuration_rate(model: pin.Model, q: Array, v: Array) -> Array:
    """Return q̇ of a configuration from the velocity."""
    rate = np.empty(model.nq)
    for joint in model.joints[1:]:
        at = slice(joint.idx_q, joint.idx_q + joint.nq)
        to = slice(joint.idx_v, joint.idx_v + joint.nv)
        c, w, name = q[at], v[to], joint.shortname()
        if joint.nq == joint.nv:
            rate[at] = w
        elif name == "JointModelFreeFlyer":
            rotation = pin.Quaternion(c[3:] / np.linalg.norm(c[3:])).toRotationMatrix()
            rate[at] = np.concatenate([rotation @ w[:3], _quaternion_rate(c[3:], w[3:])])
        elif name == "JointModelSpherical":
            rate[at] = _quaternion_rate(c, w)
        elif name == "JointModelPlanar":
            cos, sin = c[2:]
            rate[at] = [cos * w[0] - sin * w[1], sin * w[0] + cos * w[1], -sin * w[2], cos * w[2]]
        else:  # a continuous joint, (cos, sin)
            rate[at] = [-c[1] * w[0], c[0] * w[0]]
    return rate


def _quaternion_rate(c: Array, w: Array) -> Array:
    x, y, z, s = c
    a, b, d = w
    return 0.5 * np.array(
        [
            s * a + y * d - z * b,
            s * b + z * a - x * d,
            s * d + x * b - y * a,
            -x * a - y * b - z * d,
        ]
    )


class HybridReference:
    """The full-state simulation of a system with stops."""

    def __init__(
        self,
        system: pinred.System,
        stops: Mapping[str, AnyStop],
        torque: Torque | None = None,
        tolerance: float = 1e-12,
    ) -> None:
        """Prepare the equations; `torque` returns generalised forces."""
        self.model, self.data = system.model.copy(), system.model.createData()
        self.torque, self.tolerance = torque, tolerance
        self.rows: list[tuple[str, int, float, float, AnyStop]] = []
        self.forms: dict[int, BallForm] = {}
        for name, stop in stops.items():
            if isinstance(stop, pinred.BallStop):
                continue
            at = self.model.joints[self.model.getJointId(name)].idx_v
            for sign, position in ((1.0, stop.lower), (-1.0, stop.upper)):
                if np.isfinite(position):
                    self.rows.append((name, at, sign, position, stop))
        for name, stop in stops.items():
            if isinstance(stop, pinred.BallStop):
                for form in ball_forms(stop, self.model.joints[self.model.getJointId(name)]):
                    self.forms[len(self.rows)] = form
                    self.rows.append((name, form.v.start, 1.0, 0.0, stop))
        self.J = np.zeros((len(system.couplings), self.model.nv))
        for row, coupling in zip(self.J, system.couplings, strict=True):
            row[self.rate_of(coupling.follower)] = 1.0
            for leader, ratio in coupling.ratios.items():
                row[self.rate_of(leader)] -= ratio

    def rate_of(self, name: str) -> int:
        """Return the index of a joint's rate."""
        return int(self.model.joints[self.model.getJointId(name)].idx_v)

    def tau(self, t: float, q: Array, v: Array) -> Array:
        """Return the generalised forces."""
        return np.zeros(self.model.nv) if self.torque is None else self.torque(t, q, v)

    def accelerations(
        self, t: float, q: Array, v: Array, rest: tuple[int, ...]
    ) -> tuple[Array, Array]:
        """Return v̇ and the reactions at resting rows, away from the stops."""
        a = np.array(pin.aba(self.model, self.data, q, v, self.tau(t, q, v)))
        if not (rest or len(self.J)):
            return a, np.empty(0)
        if len(self.J):
            Hinv = np.linalg.inv(self.mass(q))
            a = a - Hinv @ self.J.T @ np.linalg.solve(self.J @ Hinv @ self.J.T, self.J @ a)
        if not rest:
            return a, np.empty(0)
        E, response = self.normals(rest, q), self.response(q)
        bias = np.array([self.forms[k].bias(q, v) if k in self.forms else 0.0 for k in rest])
        reaction = np.linalg.solve(E @ response @ E.T, -E @ a - bias)
        return a + response @ E.T @ reaction, reaction

    def response(self, q: Array) -> Array:
        """Return the matrix from impulses to changes of v that keep followers coupled."""
        inverse, J = np.asarray(np.linalg.inv(self.mass(q)), dtype=float), self.J
        if not len(J):
            return inverse
        free: Array = inverse - inverse @ J.T @ np.linalg.solve(J @ inverse @ J.T, J @ inverse)
        return free

    def mass(self, q: Array) -> Array:
        """Return the mass matrix, by RNEA, because CRBA needs joints in depth-first order."""
        rest = np.zeros(self.model.nv)
        units = [rest, *np.eye(self.model.nv)]
        weight, *columns = [pin.rnea(self.model, self.data, q, rest, a).copy() for a in units]
        H: Array = np.array(columns) - weight
        return H

    def normals(self, rows: tuple[int, ...], q: Array) -> Array:
        """Return the directions away from stops, as rows."""
        E = np.zeros((len(rows), self.model.nv))
        for k, row in enumerate(rows):
            if row in self.forms:
                E[k, self.forms[row].v] = self.forms[row].row(q)
            else:
                E[k, self.rows[row][1]] = self.rows[row][2]
        return E

    def run(
        self, q: Array, v: Array, positions: Mapping[str, float], times: Array, most: int = 1000
    ) -> HybridMotion:
        """Integrate from 0.

        Args:
            q: Initial configuration, (nq,).
            v: Initial velocity, (nv,).
            positions: Initial positions of the joints with stops.
            times: Times of the states; the last one ends the motion.
            most: Largest number of impacts.
        """
        motion, t, rest = HybridMotion(), 0.0, tuple[int, ...]()
        end, n, nv, pending = float(times[-1]), self.model.nq, self.model.nv, list(times)
        s = np.zeros(nv)
        for name, position in positions.items():
            s[self.rate_of(name)] = position
        motion.modes.append((0.0, ()))
        while t < end:
            assert len(motion.hits) <= most, "too many impacts"
            t, y, kinds = self._piece(t, np.concatenate([q, v, s]), rest, end, pending, motion)
            q, v, s = np.split(y, [n, n + nv])
            if kinds is None:
                break
            for k in {*rest, *(k for k in kinds if k < len(self.rows))} - {*self.forms}:
                s[self.rows[k][1]] = self.rows[k][3]
            v, rest = self._impact(t, q, v, rest, kinds, motion)
        return motion

    def _gaps(self, y: Array, rest: tuple[int, ...], t: float) -> Array:
        q, v, s = np.split(y, [self.model.nq, self.model.nq + self.model.nv])
        gaps = np.array([sign * (s[at] - p) for _, at, sign, p, _ in self.rows])
        for k, form in self.forms.items():
            gaps[k] = form.gap(q)
        values = np.where(np.isin(np.arange(len(gaps)), rest), 1.0, gaps)
        return np.concatenate([values, self.accelerations(t, q, v, rest)[1]])

    def _gap(
        self, k: int, dense: Callable[[float], Array], rest: tuple[int, ...], t: float
    ) -> float:
        return float(self._gaps(dense(t), rest, t)[k])

    def _piece(
        self,
        t: float,
        y: Array,
        rest: tuple[int, ...],
        end: float,
        pending: list[float],
        motion: HybridMotion,
    ) -> tuple[float, Array, list[int] | None]:
        n, nv, model = self.model.nq, self.model.nv, self.model

        def rate(r: float, z: Array) -> Array:
            q, v = z[:n], z[n : n + nv]
            acceleration = self.accelerations(r, q, v, rest)[0]
            return np.concatenate([configuration_rate(model, q, v), acceleration, v])

        solver = DOP853(rate, t, y, end, rtol=max(self.tolerance, 3e-14), atol=self.tolerance)
        # Functions that begin at zero leave it: only later changes of sign count.
        before = self._gaps(y, rest, t)
        before = np.where(np.abs(before) < 1e-9, 1.0, before)
        while True:
            solver.step()
            assert solver.status != "failed"
            dense, t_old = solver.dense_output(), solver.t_old
            found = []
            grid = np.linspace(t_old, solver.t, 9)[1:]
            earlier = t_old
            for s in grid:
                values = self._gaps(dense(s), rest, s)
                for k in np.flatnonzero((values < 0.0) & (before > 0.0)):
                    at = partial(self._gap, int(k), dense, rest)
                    # A gap that begins at zero may be positive for a short time only.
                    inside = earlier + (s - earlier) * 0.5 ** np.arange(1, 41)
                    low = next((r for r in (earlier, *inside) if at(r) > 0.0), s)
                    root = brentq(at, low, s, xtol=1e-15, rtol=1e-14) if low < s else earlier
                    found.append((root, int(k)))
                if found:
                    break
                before, earlier = np.where(values < 0.0, before, np.maximum(values, 1e-300)), s
            stop = min(found)[0] if found else solver.t
            while pending and pending[0] <= stop:
                s = pending.pop(0)
                motion.q.append(dense(s)[:n])
                motion.v.append(dense(s)[n : n + nv])
            if found:
                kinds = [k for s, k in found if s <= stop + 1e-12]
                return stop, dense(stop), kinds
            if solver.status == "finished":
                return solver.t, solver.y, None

    def _impact(
        self,
        t: float,
        q: Array,
        v: Array,
        rest: tuple[int, ...],
        kinds: list[int],
        motion: HybridMotion,
    ) -> tuple[Array, tuple[int, ...]]:
        count = len(self.rows)
        released = {rest[k - count] for k in kinds if k >= count}
        S = tuple(sorted({*rest, *(k for k in kinds if k < count)}))
        E, H, response = self.normals(S, q), self.mass(q), self.response(q)
        u = E @ v
        u[np.isin(S, rest)] = 0.0
        e = np.array([self.rows[k][4].restitution for k in S])
        slow = np.array([self.rows[k][4].rest_rate for k in S])
        G = E @ response @ E.T
        usual = complementarity(G, (1.0 + e) * u)
        rebound = np.where(usual > 0.0, -e * u, u + G @ usual)
        chosen = [k for k in range(len(S)) if rebound[k] < slow[k] and S[k] not in released]
        while True:
            # Slow rebounds become rest if the joints stay.
            impulse, block = usual.copy(), G[np.ix_(chosen, chosen)]
            impulse[chosen] -= np.linalg.solve(block, rebound[chosen])
            new = v + response @ E.T @ impulse
            may = tuple(S[k] for k in chosen)
            for row in (row for row in may if row not in self.forms):
                new[self.rows[row][1]] = 0.0
            a, _ = self.accelerations(t, q, new, ())
            bias = [self.forms[k].bias(q, new) if k in self.forms else 0.0 for k in may]
            reaction = complementarity(block, self.normals(may, q) @ a + bias)
            leaves = [k for k, r in zip(chosen, reaction, strict=True) if not r > 0.0]
            if not any(rebound[k] > 1e-13 for k in leaves):
                break
            chosen = [k for k in chosen if k not in leaves]
        stay = tuple(k for k, r in zip(may, reaction, strict=True) if r > 0.0)
        lost = float(0.5 * (v @ H @ v - new @ H @ new))
        hit = np.flatnonzero(np.abs(impulse) > 1e-13 * np.abs(impulse).max(initial=1e-9))
        if hit.size:
            names = tuple(self.rows[S[k]][0] for k in hit)
            signed = np.array([self.rows[S[k]][2] for k in hit]) * impulse[hit]
            motion.hits.append(Hit(t, names, signed, lost))
        if stay != rest:
            motion.modes.append((t, tuple(self.rows[k][0] for k in stay)))
        return new, stay


def complementarity(G: Array, q: Array) -> Array:
    """Solve w = G z + q ≥ 0, z ≥ 0, z · w = 0 by trying all sets of positive entries."""
    if not (K := len(q)):
        return np.zeros(0)
    sets = chain.from_iterable(combinations(range(K), k) for k in range(K + 1))
    best, least = np.zeros(K), np.inf
    for chosen in map(list, sets):
        z = np.zeros(K)
        if chosen:
            z[chosen] = np.linalg.solve(G[np.ix_(chosen, chosen)], -q[chosen])
        violated = max(-min(z.min(), 0.0), -min((G @ z + q).min(), 0.0))
        if violated < least:
            best, least = z, violated
    return best

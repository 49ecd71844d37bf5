"""Motions with joint stops by full-state dynamics: an independent route to impacts and rests.

The state is (q, v) of Pinocchio. Between impacts, `pin.aba` and SciPy's DOP853 integrate it. At an
impact, H Δv = Σ λ_i e_i with the mass matrix of CRBA. Joints at rest have multipliers of the full
equations of motion. Nothing of the reduction is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import chain, combinations

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


def configuration_rate(model: pin.Model, q: Array, v: Array) -> Array:
    """Return q̇ of a configuration from the velocity."""
    rate = np.empty(model.nq)
    for joint in model.joints[1:]:
        at, to = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
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
        [s * a + y * d - z * b, s * b + z * a - x * d, s * d + x * b - y * a, -x * a - y * b - z * d]
    )


class HybridReference:
    """The full-state simulation of a system with stops on hinges and slides (nq = nv = 1)."""

    def __init__(
        self,
        system: pinred.System,
        stops: Mapping[str, pinred.Stop],
        torque: Torque | None = None,
        tolerance: float = 1e-12,
    ) -> None:
        self.model, self.data = system.model.copy(), system.model.createData()
        if not np.allclose(system.gravity, 0.0):
            pass  # gravity acts as the model states
        self.torque, self.tolerance = torque, tolerance
        self.rows = []  # (name, q index, v index, sign, position, stop)
        for name, stop in stops.items():
            joint = self.model.joints[self.model.getJointId(name)]
            assert joint.nq == 1
            for sign, position in ((1.0, stop.lower), (-1.0, stop.upper)):
                if np.isfinite(position):
                    self.rows.append((name, joint.idx_q, joint.idx_v, sign, position, stop))

    def tau(self, t: float, q: Array, v: Array) -> Array:
        return np.zeros(self.model.nv) if self.torque is None else self.torque(t, q, v)

    def accelerations(
        self, t: float, q: Array, v: Array, rest: tuple[int, ...]
    ) -> tuple[Array, Array]:
        """Return v̇ and the reactions at resting rows, away from the stops."""
        a = np.array(pin.aba(self.model, self.data, q, v, self.tau(t, q, v)))
        if not rest:
            return a, np.empty(0)
        E = self.normals(rest)
        Hinv = np.linalg.inv(self.mass(q))
        reaction = np.linalg.solve(E @ Hinv @ E.T, -E @ a)
        return a + Hinv @ E.T @ reaction, reaction

    def mass(self, q: Array) -> Array:
        upper = np.triu(pin.crba(self.model, self.data, q))
        return upper + np.triu(upper, 1).T

    def normals(self, rows: tuple[int, ...]) -> Array:
        E = np.zeros((len(rows), self.model.nv))
        for k, row in enumerate(rows):
            E[k, self.rows[row][2]] = self.rows[row][3]
        return E

    def run(self, q: Array, v: Array, times: Array, most: int = 1000) -> HybridMotion:
        """Integrate from 0 and return the motion at times, which end with the last one."""
        motion, t, rest = HybridMotion(), 0.0, tuple[int, ...]()
        end, n, pending = float(times[-1]), self.model.nq, list(times)
        motion.modes.append((0.0, ()))
        while t < end:
            if len(motion.hits) > most:
                raise AssertionError("too many impacts")
            t, y, kinds = self._piece(t, np.concatenate([q, v]), rest, end, pending, motion)
            q, v = y[:n], y[n:]
            if kinds is None:
                break
            q, v, rest = self._impact(t, q, v, rest, kinds, motion)
        return motion

    def _gaps(self, y: Array, rest: tuple[int, ...], t: float) -> Array:
        n = self.model.nq
        gaps = np.array([sign * (y[at] - p) for _, at, _, sign, p, _ in self.rows])
        values = np.where(np.isin(np.arange(len(gaps)), rest), 1.0, gaps)
        _, reaction = self.accelerations(t, y[:n], y[n:], rest)
        return np.concatenate([values, reaction])

    def _piece(
        self,
        t: float,
        y: Array,
        rest: tuple[int, ...],
        end: float,
        pending: list[float],
        motion: HybridMotion,
    ) -> tuple[float, Array, list[int] | None]:
        n, model = self.model.nq, self.model

        def rate(s: float, z: Array) -> Array:
            q, v = z[:n], z[n:]
            return np.concatenate(
                [configuration_rate(model, q, v), self.accelerations(s, q, v, rest)[0]]
            )

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
                    at = lambda r, k=k: self._gaps(dense(r), rest, r)[k]
                    low = earlier if at(earlier) > 0.0 else earlier + 1e-3 * (s - earlier)
                    found.append((brentq(at, low, s, xtol=1e-15, rtol=1e-14), int(k)))
                if found:
                    break
                before, earlier = np.where(values < 0.0, before, np.maximum(values, 1e-300)), s
            stop = min(found)[0] if found else solver.t
            while pending and pending[0] <= stop:
                s = pending.pop(0)
                motion.q.append(dense(s)[:n])
                motion.v.append(dense(s)[n:])
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
    ) -> tuple[Array, Array, tuple[int, ...]]:
        count = len(self.rows)
        released = {rest[k - count] for k in kinds if k >= count}
        S = tuple(sorted({*rest, *(k for k in kinds if k < count)}))
        E, H = self.normals(S), self.mass(q)
        Hinv = np.linalg.inv(H)
        u = E @ v
        u[np.isin(S, rest)] = 0.0
        e = np.array([self.rows[k][5].restitution for k in S])
        slow = np.array([self.rows[k][5].rest_rate for k in S])
        G = E @ Hinv @ E.T
        impulse = complementarity(G, (1.0 + e) * u)
        after = u + G @ impulse
        e = np.where((after < slow) & (impulse > 0.0), 0.0, e)
        impulse = complementarity(G, (1.0 + e) * u)
        new = v + Hinv @ E.T @ impulse
        after = E @ new
        lost = 0.5 * (v @ H @ v - new @ H @ new)
        hit = np.flatnonzero(impulse > 0.0)
        if hit.size:
            names = tuple(self.rows[S[k]][0] for k in hit)
            signed = np.array([self.rows[S[k]][3] for k in hit]) * impulse[hit]
            motion.hits.append(Hit(t, names, signed, lost))
        may = tuple(k for k, rate in zip(S, after, strict=True) if rate < 1e-9 and k not in released)
        stay = tuple[int, ...]()
        if may:
            for k in may:
                new[self.rows[k][2]] = 0.0
            a, _ = self.accelerations(t, q, new, ())
            E = self.normals(may)
            reaction = complementarity(E @ Hinv @ E.T, E @ a)
            stay = tuple(k for k, r in zip(may, reaction, strict=True) if r > 0.0)
        if stay != rest:
            motion.modes.append((t, tuple(self.rows[k][0] for k in stay)))
        return q, new, stay


def complementarity(G: Array, q: Array) -> Array:
    """Solve w = G z + q ≥ 0, z ≥ 0, z · w = 0 by trying all sets of positive entries."""
    K = len(q)
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

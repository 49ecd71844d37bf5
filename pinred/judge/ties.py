"""Accelerations of the full system, with ties between joints as constraints.

The judge's own way to couple joints: all of them move, each follower as its coupling says of its
own leader, a_f − k a_l = 0, and multipliers keep the accelerations there,

    a = a₀ − M⁻¹Jᵀ (J M⁻¹Jᵀ)⁻¹ J a₀,   a₀ and M⁻¹Jᵀ by Pinocchio's ABA.

Where the tree without its ties has a singular mass matrix, or accelerations are prescribed, the
equations of a and multipliers are solved as one system.  Without ties it is ABA alone.
Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.singular_mass_matrix import SingularShapes, singular_shapes
from ..system.system import System


class Ties:
    """The couplings of one system, each between a follower and the leader that the file names.

    J: (c, nv), with J v = 0.  leads: (m,) where the joints of the shape stand among all M.
    """

    def __init__(self, system: System) -> None:
        """Find the joints by name."""
        model, r = system.model, system.r
        at = {str(model.names[i]): i - 2 for i in range(2, model.njoints)}
        waiting, placed = list(system.couplings), {*system.shape_names}
        self._rows: list[tuple[int, int, float, float]] = []
        while waiting:  # leaders before their followers
            each = next(tie for tie in waiting if tie.leader in placed)
            waiting.remove(each)
            placed.add(each.follower)
            self._rows.append((at[each.follower], at[each.leader], each.ratio, each.offset))
        self.J = np.zeros((len(self._rows), model.nv))
        for row, (follower, leader, ratio, _) in zip(self.J, self._rows, strict=True):
            row[r + follower], row[r + leader] = 1.0, -ratio
        self.leads = np.array([at[name] for name in system.shape_names], dtype=np.intp)
        self._count, self._model, self._data = len(at), model, model.createData()
        self._still = model.copy()
        self._still.gravity.setZero()
        self._alone = not self._rows or singular_shapes(model) == SingularShapes()

    def values(self, x: Array) -> Array:
        """Return the values (..., M) of all joints at shape x (..., m)."""
        out = np.zeros((*x.shape[:-1], self._count))
        out[..., self.leads] = x
        for follower, leader, ratio, offset in self._rows:
            out[..., follower] = ratio * out[..., leader] + offset
        return out

    def rates(self, xdot: Array) -> Array:
        """Return the rates (..., M) of all joints at shape rate ẋ (..., m)."""
        out = np.zeros((*xdot.shape[:-1], self._count))
        out[..., self.leads] = xdot
        for follower, leader, ratio, _ in self._rows:
            out[..., follower] = ratio * out[..., leader]
        return out

    def shape(self, joints: Array) -> Array:
        """Return those (..., m) of values of all joints (..., M) that are the shape's."""
        return joints[..., self.leads]

    def at_leaders(self, torque: Array) -> Array:
        """Return the forces (M,) on all joints that are those on the shape (m,)."""
        out = np.zeros(self._count)
        out[self.leads] = torque
        return out

    def acceleration(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: Sequence[int] = (),
        given: Array | Sequence[float] = (),
        axes: pin.Convention = pin.Convention.LOCAL,
    ) -> Array:
        """Return the acceleration (nv,) of the tied system under generalised forces (nv,).

        driven: the joints, among all M, whose accelerations are `given`.  axes: those in which
        ABA is computed, which tells what round-off leaves of it.
        """
        if len(driven):
            own = np.eye(len(v))[[len(v) - self._count + k for k in driven]]
            rows = np.vstack([self.J, own])
            return self._solved(q, v, tau, rows, np.append(np.zeros(len(self.J)), given))
        if not self._alone:
            return self._solved(q, v, tau, self.J, np.zeros(len(self.J)))
        model, data, rest = self._model, self._data, np.zeros(len(v))
        free = pin.aba(model, data, q, v, tau, axes).copy()
        if not self._rows:
            return np.asarray(free)
        pushed = np.array([pin.aba(self._still, data, q, rest, row, axes).copy() for row in self.J])
        push = np.linalg.solve(self.J @ pushed.T, self.J @ free)
        return np.asarray(free - push @ pushed)

    def _solved(self, q: Array, v: Array, tau: Array, rows: Array, given: Array) -> Array:
        """Return the acceleration (nv,) with rows · a = given (c,), in one system with multipliers.

        The mass matrix need be regular only in the directions that the rows leave free.
        """
        upper = pin.crba(self._model, self._data, q)
        H = np.triu(upper) + np.triu(upper, 1).T
        bias = pin.nonLinearEffects(self._model, self._data, q, v)
        whole = np.block([[H, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
        return np.asarray(np.linalg.solve(whole, np.append(tau - bias, given))[: len(v)])

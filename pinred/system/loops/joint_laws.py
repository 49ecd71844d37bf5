"""Polynomials between two joints as constraints φ = x_f − x_f⁰ − Σ c_k (x_l − x_l⁰)^k."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed, nearest, quoted
from ..joints import is_prismatic
from .loop import JointPolynomial


class JointLaw:
    """The constraint of a polynomial, with its row of the Jacobian.

    Attributes:
        is_length: Whether the constraint is a length [m], instead of an angle [rad].
        joints: Indices in the model of follower and leader.
    """

    def __init__(self, model: pin.Model, law: JointPolynomial) -> None:
        """Find the joints of a polynomial in the model."""
        self.joints = tuple(_joint(model, law, name) for name in (law.follower, law.leader))
        follower, leader = (model.joints[i] for i in self.joints)
        self.is_length = is_prismatic(follower)
        self._q, self._v = (follower.idx_q, leader.idx_q), (follower.idx_v, leader.idx_v)
        self._zeros, self._nv = (law.follower_zero, law.leader_zero), int(model.nv)
        self._polynomial = Polynomial(law.coefficients)
        self._slope, self._curvature = self._polynomial.deriv(), self._polynomial.deriv(2)

    def value(self, q: Array) -> Array:
        """Return φ, (1,) [rad | m], at configuration q (nq,)."""
        follower, leader = q[self._q[0]] - self._zeros[0], q[self._q[1]] - self._zeros[1]
        return np.array([follower - self._polynomial(leader)])

    def row(self, q: Array) -> Array:
        """Return the row of the Jacobian, (1, nv)."""
        row = np.zeros((1, self._nv))
        row[0, self._v[0]] = 1.0
        row[0, self._v[1]] -= self._slope(q[self._q[1]] - self._zeros[1])
        return row

    def row_rate(self, q: Array, v: Array) -> Array:
        """Return the time derivative of the row at velocity v (nv,), (1, nv)."""
        rate, leader = np.zeros((1, self._nv)), self._v[1]
        rate[0, leader] = -self._curvature(q[self._q[1]] - self._zeros[1]) * v[leader]
        return rate


def _joint(model: pin.Model, law: JointPolynomial, name: str) -> int:
    names = [str(n) for n in model.names]
    scalar = [n for i, n in enumerate(names) if i > 1 and model.joints[i].nq == 1]
    if name not in scalar:
        raise InputError(
            f"loops: {quoted(law.name)} needs a hinge or slide {quoted(name)} with one coordinate, "
            f"behind the root; {nearest(name, scalar)}these are {listed(scalar, 60)}"
        )
    return names.index(name)

"""The linear form of velocities whose zeros are the horizontal motions of a connection.

A connection on G × B is a form F(x) (ξ, ẋ) = P_b(x) ξ + P_s(x) ẋ with r rows: momenta, drag forces,
or the slip of wheels.  Where it vanishes, ξ = −A ẋ with A = P_b⁻¹ P_s.  If F is symmetric, as
momenta and drag are, its last m rows are there as well, and with them a metric on shape space,
M = G_ss − Aᵀ P_b A, where G is the whole of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from ...common.arrays import Array
from ...lie.group import Group


@dataclass(frozen=True, eq=False)
class ConnectionForm:
    """A form F of velocities on G × B, as expressions and by Pinocchio.

    group: G.  joints, units: names and units of the shape coordinates, (m,).  what: it is, in a
    few words.  values: (x, v) → F(x) v, (r,), or (n,) of a symmetric form; v = (ξ, ẋ).  locked:
    x → P_b, (r²,) by columns.  reference: x → the matrix of F, (r, n) or (n, n), by other means
    than the expressions; it judges them.  symmetric: whether there is a metric.
    momentum: whether F is one, of which the spatial one is conserved.
    """

    group: Group
    joints: tuple[str, ...]
    units: tuple[str, ...]
    what: str
    values: ca.Function
    locked: ca.Function
    reference: Callable[[Array], Array]
    symmetric: bool
    momentum: bool = False

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return self.group.dim

    @property
    def m(self) -> int:
        """Dimension of shape space."""
        return len(self.joints)

    @property
    def key(self) -> bytes:
        """What tells its machine code from that of others: the expressions themselves."""
        axes = f"{self.group.name} {self.group.axes} {self.symmetric}"
        return f"{axes} {self.values.serialize()} {self.locked.serialize()}".encode()


def form_of(
    group: Group,
    joints: tuple[str, ...],
    units: tuple[str, ...],
    what: str,
    values: Callable[[ca.SX, ca.SX], ca.SX],
    reference: Callable[[Array], Array],
    *,
    symmetric: bool,
    momentum: bool = False,
    locked: Callable[[ca.SX], ca.SX] | None = None,
) -> ConnectionForm:
    """Return the form whose values are written by a function of x and v.

    locked: writes P_b, (r, r), where that takes fewer operations than the derivative of `values`.
    """
    r, m = group.dim, len(joints)
    x, v = ca.SX.sym("x", m), ca.SX.sym("v", r + m)
    F = values(x, v)
    P = ca.jacobian(F[:r], v[:r]) if locked is None else locked(x)
    return ConnectionForm(
        group=group,
        joints=joints,
        units=units,
        what=what,
        values=ca.Function("values", [x, v], [ca.densify(F)]),
        locked=ca.Function("locked", [x], [ca.densify(ca.vec(P))]),
        reference=reference,
        symmetric=symmetric,
        momentum=momentum,
    )

"""The linear form of velocities that defines a connection: it vanishes on horizontal motions.

A connection on G × B is given by a form F(x) (ξ, ẋ) = P_b(x) ξ + P_s(x) ẋ with r rows: momenta,
drag forces, or the slip of wheels.  If it vanishes, ξ = −A ẋ with A = P_b⁻¹ P_s.  A symmetric form,
such as momenta or drag, also has m rows for the shape.  Its full matrix G defines a metric on shape
space, M = G_ss − Aᵀ P_b A.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from ...common.arrays import Array
from ...lie.group import Group


@dataclass(frozen=True, eq=False)
class ConnectionForm:
    """A form F of velocities v = (ξ, ẋ) on G × B, as CasADi expressions and by Pinocchio.

    Attributes:
        group: The group G.
        joints: Names of the shape coordinates, (m,).
        units: Units of the shape coordinates, (m,).
        what: Short description for messages.
        values: Function (x, v) → F(x) v, (r,), or (n,) if the form is symmetric.
        locked: Function x → P_b by columns, (r²,).
        reference: Returns the matrix of F at a shape, (r, n) or (n, n), independently of the
            expressions.  Machine code is validated against it.
        symmetric: Whether the form is symmetric, so that there is a metric.
        momentum: Whether F is a momentum, whose spatial form is conserved.
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
        """Key of its machine code in the cache: the serialised expressions."""
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
    """Return a form from functions of CasADi symbols; see `ConnectionForm`.

    Args:
        group: The group G.
        joints: Names of the shape coordinates, (m,).
        units: Units of the shape coordinates, (m,).
        what: Short description for messages.
        values: Returns F(x) v for symbols x and v.
        reference: Returns the matrix of F at a shape.
        symmetric: Whether the form is symmetric.
        momentum: Whether F is a momentum.
        locked: Returns P_b, (r, r), if that takes fewer operations than the derivative of `values`.
    Returns:
        The form.
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

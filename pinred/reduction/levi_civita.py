"""The Levi-Civita connections of reduction: of the reduced metric, and of a left-invariant one.

Of the reduced metric M(x) on shape space, with dM[a, b, c] = ∂_c M_ab:

    Γ_{d,ab} = ½ (∂_a M_db + ∂_b M_da − ∂_d M_ab),     Γ^c_ab = M⁻¹^{cd} Γ_{d,ab}
    R_abcd = ½ (∂_b∂_c M_ad + ∂_a∂_d M_bc − ∂_a∂_c M_bd − ∂_b∂_d M_ac)
             + Γ_{e,bc} M⁻¹^{ef} Γ_{f,ad} − Γ_{e,bd} M⁻¹^{ef} Γ_{f,ac}

so that R_abcd u^a v^b u^c v^d is positive on a sphere.  Motion at zero momentum without a
potential is a geodesic: ẍ^c = −Γ^c_ab ẋ^a ẋ^b.  By O'Neill's formula the projection Q → Q/G
curves more than what lies above it,

    R_B(u, v, u, v) = R_Q(u_h, v_h, u_h, v_h) + ¾ B(u, v)ᵀ I B(u, v).

Of the left-invariant metric I on a group, for body twists:

    ∇_ξ η = ½ [ξ, η] − ½ I⁻¹ (ad*_ξ I η + ad*_η I ξ),     geodesics: ξ̇ = −∇_ξ ξ = I⁻¹ ad*_ξ I ξ.

Source: B. O'Neill, "The fundamental equations of a submersion", 1966; V. I. Arnold, "Mathematical
methods of classical mechanics", appendix 2; Misner, Thorne, Wheeler, "Gravitation", 1973, ch. 14.
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..lie.group import Group
from .tree.second_derivatives import InertiaDerivatives


def christoffel_symbols(M: Array, dM: Array) -> Array:
    """Return Γ^c_ab, (m, m, m), c first, of a metric (m, m) with derivatives (m, m, m), ∂ last."""
    return np.asarray(np.linalg.solve(M, _lowered(dM).reshape(len(M), -1))).reshape(dM.shape)


def riemann_tensor(M: Array, dM: Array, d2M: Array) -> Array:
    """Return R_abcd, (m, m, m, m), all indices down; derivatives last."""
    low = _lowered(dM)
    twice = 0.5 * (np.einsum("adbc->abcd", d2M) + np.einsum("bcad->abcd", d2M))
    twice -= 0.5 * (np.einsum("bdac->abcd", d2M) + np.einsum("acbd->abcd", d2M))
    raised = np.linalg.solve(M, low.reshape(len(M), -1)).reshape(dM.shape)
    product = np.einsum("ebc,ead->abcd", low, raised)
    return np.asarray(twice + product - np.swapaxes(product, 2, 3))


def sectional(R: Array, M: Array, u: Array, v: Array) -> float:
    """Return the sectional curvature of the plane of u and v (m,).

    Raises InputError if they are parallel.
    """
    uu, vv, uv = u @ M @ u, v @ M @ v, u @ M @ v
    area = uu * vv - uv**2
    if not area > 1e-14 * uu * vv:
        raise InputError("u and v must span a plane, but they are parallel in the reduced metric")
    return float(np.einsum("abcd,a,b,c,d", R, u, v, u, v) / area)


def reduced_metric_derivatives(d: InertiaDerivatives, r: int) -> tuple[Array, Array, Array]:
    """Return M, ∂M and ∂∂M at the one shape of `d`, derivatives last; r: size of the base.

    M = H_ss − Aᵀ H_bs with A = I⁻¹ H_bs, differentiated twice.
    """
    H, dH, d2H = d.H[0], d.dH[0], d.d2H[0]
    I, Hbs, dI, dHbs = H[:r, :r], H[:r, r:], dH[:r, :r], dH[:r, r:]
    A = np.linalg.solve(I, Hbs)
    # W = I ∂A: what is left of ∂(IA) when ∂I A is taken away.
    W = dHbs - np.einsum("ijc,jb->ibc", dI, A)
    dA = np.linalg.solve(I, W.reshape(r, -1)).reshape(W.shape)
    dM = dH[r:, r:] - np.einsum("iac,ib->abc", dHbs, A)
    dM -= np.einsum("ia,ibc->abc", A, W)
    # ∂∂(Hᵀ I⁻¹ H) in terms of A: its second derivatives, and twice the product of W's.
    d2M = d2H[r:, r:] - _symmetric(np.einsum("iacd,ib->abcd", d2H[:r, r:], A))
    d2M += np.einsum("ia,ijcd,jb->abcd", A, d2H[:r, :r], A)
    both = np.einsum("iac,ibd->abcd", W, dA)
    d2M -= both + np.swapaxes(both, 2, 3)
    return H[r:, r:] - A.T @ Hbs, dM, np.asarray(d2M)


def left_invariant_derivative(group: Group, inertia: Array, xi: Array, eta: Array) -> Array:
    """Return ∇_ξ η, (r,), of left-invariant fields with body twists ξ, η in the metric (r, r)."""
    turned = group.coadjoint(xi, inertia @ eta) + group.coadjoint(eta, inertia @ xi)
    return np.asarray(0.5 * group.bracket(xi, eta) - 0.5 * np.linalg.solve(inertia, turned))


def _lowered(dM: Array) -> Array:
    """Return Γ_{d,ab}, d first."""
    first = np.swapaxes(dM, 1, 2)  # [d, a, b]: ∂_a M_db
    return 0.5 * (first + dM - np.moveaxis(dM, 2, 0))


def _symmetric(entries: Array) -> Array:
    return entries + np.swapaxes(entries, 0, 1)

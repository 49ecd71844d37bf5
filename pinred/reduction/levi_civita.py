"""Levi-Civita connections of the reduced metric and of a left-invariant metric.

For the reduced metric M(x) on shape space, with dM[a, b, c] = ∂_c M_ab:

    Γ_{d,ab} = ½ (∂_a M_db + ∂_b M_da − ∂_d M_ab),     Γ^c_ab = M⁻¹^{cd} Γ_{d,ab}
    R_abcd = ½ (∂_b∂_c M_ad + ∂_a∂_d M_bc − ∂_a∂_c M_bd − ∂_b∂_d M_ac)
             + Γ_{e,bc} M⁻¹^{ef} Γ_{f,ad} − Γ_{e,bd} M⁻¹^{ef} Γ_{f,ac}

so that R_abcd u^a v^b u^c v^d is positive on a sphere.  Motion at zero momentum without a
potential is a geodesic: ẍ^c = −Γ^c_ab ẋ^a ẋ^b.  By O'Neill's formula, sectional curvatures of the
base B = Q/G are at least those of horizontal planes in Q:

    R_B(u, v, u, v) = R_Q(u_h, v_h, u_h, v_h) + ¾ B(u, v)ᵀ I B(u, v).

For the left-invariant metric I on a group, in body twists:

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
    """Compute Γ^c_ab, (m, m, m), c first, from M (m, m) and ∂M (m, m, m), derivative last."""
    return np.asarray(np.linalg.solve(M, _lowered(dM).reshape(len(M), -1))).reshape(dM.shape)


def riemann_tensor(M: Array, dM: Array, d2M: Array) -> Array:
    """Compute the Riemann tensor with all indices down.

    Args:
        M: Metric, (m, m).
        dM: Its derivative, (m, m, m), derivative index last.
        d2M: Its second derivative, (m, m, m, m), derivative indices last.
    Returns:
        R_abcd, (m, m, m, m).
    """
    lowered = _lowered(dM)
    R = 0.5 * (np.einsum("adbc->abcd", d2M) + np.einsum("bcad->abcd", d2M))
    R -= 0.5 * (np.einsum("bdac->abcd", d2M) + np.einsum("acbd->abcd", d2M))
    raised = np.linalg.solve(M, lowered.reshape(len(M), -1)).reshape(dM.shape)
    product = np.einsum("ebc,ead->abcd", lowered, raised)
    return np.asarray(R + product - np.swapaxes(product, 2, 3))


def sectional(R: Array, M: Array, u: Array, v: Array) -> float:
    """Compute the sectional curvature of the plane of two vectors.

    Args:
        R: Riemann tensor with all indices down, (m, m, m, m).
        M: Metric, (m, m).
        u: First vector, (m,).
        v: Second vector, (m,).
    Returns:
        The curvature.
    Raises:
        InputError: The vectors are parallel.
    """
    uu, vv, uv = u @ M @ u, v @ M @ v, u @ M @ v
    area = uu * vv - uv**2
    if not area > 1e-14 * uu * vv:
        raise InputError("u and v must span a plane, but they are parallel in the reduced metric")
    return float(np.einsum("abcd,a,b,c,d", R, u, v, u, v) / area)


def reduced_metric_derivatives(d: InertiaDerivatives, r: int) -> tuple[Array, Array, Array]:
    """Differentiate M = H_ss − Aᵀ H_bs, A = I⁻¹ H_bs, twice.

    Args:
        d: Derivatives of the mass matrix at one shape.
        r: Dimension of the group.
    Returns:
        M, ∂M and ∂∂M, derivative indices last.
    """
    H, dH, d2H = d.H[0], d.dH[0], d.d2H[0]
    I, Hbs, dI, dHbs = H[:r, :r], H[:r, r:], dH[:r, :r], dH[:r, r:]
    A = np.linalg.solve(I, Hbs)
    # W = I ∂A = ∂(IA) − ∂I A.
    W = dHbs - np.einsum("ijc,jb->ibc", dI, A)
    dA = np.linalg.solve(I, W.reshape(r, -1)).reshape(W.shape)
    dM = dH[r:, r:] - np.einsum("iac,ib->abc", dHbs, A)
    dM -= np.einsum("ia,ibc->abc", A, W)
    # ∂∂(Hᵀ I⁻¹ H) in terms of A: its second derivatives, and twice the product of the W's.
    mixed = np.einsum("iacd,ib->abcd", d2H[:r, r:], A)
    d2M = d2H[r:, r:] - mixed - np.swapaxes(mixed, 0, 1)
    d2M += np.einsum("ia,ijcd,jb->abcd", A, d2H[:r, :r], A)
    product = np.einsum("iac,ibd->abcd", W, dA)
    d2M -= product + np.swapaxes(product, 2, 3)
    return H[r:, r:] - A.T @ Hbs, dM, np.asarray(d2M)


def left_invariant_derivative(group: Group, inertia: Array, xi: Array, eta: Array) -> Array:
    """Compute ∇_ξ η of left-invariant fields.

    Args:
        group: The group.
        inertia: Metric on body twists, (r, r).
        xi: Body twist ξ, (r,).
        eta: Body twist η, (r,).
    Returns:
        (r,).
    """
    coadjoint = group.coadjoint(xi, inertia @ eta) + group.coadjoint(eta, inertia @ xi)
    return np.asarray(0.5 * group.bracket(xi, eta) - 0.5 * np.linalg.solve(inertia, coadjoint))


def _lowered(dM: Array) -> Array:
    """Return Γ_{d,ab}, d first."""
    by_a = np.swapaxes(dM, 1, 2)  # [d, a, b]: ∂_a M_db
    return 0.5 * (by_a + dM - np.moveaxis(dM, 2, 0))

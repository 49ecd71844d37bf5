"""Levi-Civita connections of the reduced metric and of left-invariant metrics.

For the reduced metric M(x) on shape space, with dM[a, b, c] = ∂_c M_ab:

    Γ_{d,ab} = ½ (∂_a M_db + ∂_b M_da − ∂_d M_ab),     Γ^c_ab = M⁻¹^{cd} Γ_{d,ab}
    R_abcd = ½ (∂_b∂_c M_ad + ∂_a∂_d M_bc − ∂_a∂_c M_bd − ∂_b∂_d M_ac)
             + Γ_{e,bc} M⁻¹^{ef} Γ_{f,ad} − Γ_{e,bd} M⁻¹^{ef} Γ_{f,ac}

so that R_abcd u^a v^b u^c v^d is positive on a sphere.  Motion at zero momentum without a
potential is a geodesic: ẍ^c = −Γ^c_ab ẋ^a ẋ^b.  By O'Neill's formula, sectional curvatures of the
base B = Q/G are at least those of horizontal planes in Q:

    R_B(u, v, u, v) = R_Q(u_h, v_h, u_h, v_h) + ¾ B(u, v)ᵀ I B(u, v).

With balls, ∂_a is the derivative e_a along the frame of the shape, [e_a, e_b] = c^d_ab e_d.  By
Koszul's formula (Γ_{c,ab} = M_cd Γ^d_ab, ∇_a e_b = Γ^c_ab e_c),

    2 Γ_{c,ab} = e_a M_bc + e_b M_ac − e_c M_ab + c^d_ab M_dc − c^d_ac M_db − c^d_bc M_da,
    R_abcd = e_c Γ_{a,db} − e_d Γ_{a,cb} − Γ_{f,ca} Γ^f_db + Γ_{f,da} Γ^f_cb − c^e_cd Γ_{a,eb},

so that Γ^d_ab − Γ^d_ba = c^d_ab, and geodesics obey σ̇^c = −Γ^c_ab σ^a σ^b in the rates σ.

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
from ..reduction.tree.second_derivatives import InertiaDerivatives


def christoffel_symbols(M: Array, dM: Array, c: Array | None = None) -> Array:
    """Compute the Christoffel symbols of a metric.

    Args:
        M: Metric, (m, m).
        dM: Derivative of the metric, (m, m, m), derivative index last.
        c: Structure constants c^d_ab of the frame, (m, m, m), d first; None if they are zero.
    Returns:
        Γ^c_ab, (m, m, m), c first.
    """
    return _raised(M, _lowered(M, dM, c))


def riemann_tensor(M: Array, dM: Array, d2M: Array, c: Array | None = None) -> Array:
    """Compute the Riemann tensor with all indices down.

    Args:
        M: Metric, (m, m).
        dM: Derivative of the metric, (m, m, m), derivative index last.
        d2M: Second derivative of the metric, (m, m, m, m), d2M[..., a, b] = e_a e_b M.
        c: Structure constants c^d_ab of the frame, (m, m, m), d first; None if they are zero.
    Returns:
        R_abcd, (m, m, m, m).
    """
    if c is not None:
        return _riemann_in_frame(M, dM, d2M, c)
    lowered = _lowered(M, dM, c)
    R = 0.5 * (np.einsum("adbc->abcd", d2M) + np.einsum("bcad->abcd", d2M))
    R -= 0.5 * (np.einsum("bdac->abcd", d2M) + np.einsum("acbd->abcd", d2M))
    raised = _raised(M, lowered)
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
    """Differentiate M = H_ss − Aᵀ H_bs, with A = I⁻¹ H_bs, twice.

    Args:
        d: Derivatives of the mass matrix at one shape.
        r: Dimension of the group.
    Returns:
        M, ∂M and ∂∂M, derivative indices last.
    """
    H, dH, d2H = d.H[0], d.dH[0], d.d2H[0]
    I, Hbs, dI, dHbs = H[:r, :r], H[:r, r:], dH[:r, :r], dH[:r, r:]
    A = np.linalg.solve(I, Hbs)
    # The matrices W = I ∂A follow from the product rule: W = ∂(IA) − ∂I A, with I A = H_bs.
    W = dHbs - np.einsum("ijc,jb->ibc", dI, A)
    dA = np.linalg.solve(I, W.reshape(r, -1)).reshape(W.shape)
    dM = dH[r:, r:] - np.einsum("iac,ib->abc", dHbs, A)
    dM -= np.einsum("ia,ibc->abc", A, W)
    # ∂∂(H_bsᵀ I⁻¹ H_bs), A = I⁻¹ H_bs: second derivatives of H_bs and I, plus Wᵀ I⁻¹ W twice.
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


def _riemann_in_frame(M: Array, dM: Array, d2M: Array, c: Array) -> Array:
    """Return R_abcd in a frame with structure constants c."""
    lowered = _lowered(M, dM, c)
    slopes = np.stack(  # [a, d, b, c]: e_c Γ_{a,db}, linear in M and in its derivatives
        [_lowered(dM[..., k], d2M[..., k, :], c) for k in range(len(M))], axis=-1
    )
    product = np.einsum("fca,fdb->abcd", lowered, _raised(M, lowered))
    half: Array = np.einsum("adbc->abcd", slopes) - product
    return np.asarray(half - np.swapaxes(half, 2, 3) - np.einsum("ecd,aeb->abcd", c, lowered))


def _lowered(M: Array, dM: Array, c: Array | None) -> Array:
    """Return the Christoffel symbols of the first kind Γ_{d,ab}, d first."""
    by_a = np.swapaxes(dM, 1, 2)  # [d, a, b]: ∂_a M_db
    symmetric: Array = 0.5 * (by_a + dM - np.moveaxis(dM, 2, 0))
    if c is None:
        return symmetric
    brackets = np.einsum("de,eab->dab", M, c)  # ⟨e_d, [e_a, e_b]⟩
    turned = np.einsum("bad->dab", brackets) + np.einsum("abd->dab", brackets)
    return np.asarray(symmetric + 0.5 * (brackets - turned))


def _raised(M: Array, lowered: Array) -> Array:
    """Return M⁻¹^{cd} Γ_{d,ab}."""
    return np.asarray(np.linalg.solve(M, lowered.reshape(len(M), -1))).reshape(lowered.shape)

"""Inverse dynamics with two derivatives at many states at once.

All terms are in the frame of the root body.  Body j has the twist V_j, the acceleration A_j and
the test twist Y_j = Y_0 + Σ S_k y_k, with the screws S_k of the joints k on its path.  The joint
torques τ and the wrench F on the base follow from the power of all bodies,

    φ = y · τ + Y_0 · F = Σ_j Y_j · f_j,      f_j = I_j A_j + V_j ×* I_j V_j.

To move joint l is to move its subtree rigidly.  In the frame of the subtree, only the inputs of
the subtree change: (V, A, Y) of body l change by t = (tV, tA, tY) for each variable of joint l,

    x:  (V_p × S, A_p × S + (V_p × S) × S ẋ, Y_p × S),   ẋ:  (S, V_p × S, 0),
    ẍ:  (0, S, 0),                                       y:  (0, 0, S),       p the parent of l.

In these inputs φ has the gradient (B, N, F) and the constant second derivatives ∂Y∂A = J (the
composite inertia), ∂Y∂V = D and ∂V∂V = G, so that the second derivative by a variable of joint l
and one of its ancestor k is a product of two vectors with 18 entries (P_l and t_k in the code).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ...common.arrays import Array
from ...lie.rotations import hat
from ...lie.spatial_groups import SE3
from ...system.system import System
from .second_derivatives import ScrewTree


@dataclass(frozen=True, eq=False)
class Bodies:
    """Screws and inertias at N shapes.

    Attributes:
        screws: Screws of the joints, (N, M, 6).
        inertias: Inertias of the bodies, root first, (N, M + 1, 6, 6).
        composites: Inertias of their subtrees, (N, M + 1, 6, 6).
    """

    screws: Array
    inertias: Array
    composites: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """Twists and accelerations of all bodies at N states.

    Attributes:
        bodies: Screws and inertias.
        u: Joint rates, (N, M, 1).
        V: Twists, (N, M + 1, 6).
        A: Accelerations, (N, M + 1, 6).
        ad: Cross products V ×, (N, M + 1, 6, 6).
        h: Momenta of the bodies, (N, M + 1, 6).
        F: Wrenches on the subtrees, (N, M + 1, 6).
        torque: Torques of the shape joints, (N, m).
        wrench: Wrench on the base, (N, r).
    """

    bodies: Bodies
    u: Array
    V: Array
    A: Array
    ad: Array
    h: Array
    F: Array
    torque: Array
    wrench: Array


class InverseDynamics:
    """Inverse dynamics, with two derivatives, of a tree of hinges and slides."""

    def __init__(self, system: System) -> None:
        """Store the constants of the tree."""
        self._system, self._tree = system, system.workspace(ScrewTree, lambda: ScrewTree(system))
        M, r = self._tree.count, system.r
        self._parents, self._root = self._tree.parents, self._tree.root
        self._path = np.zeros((M + 1, M))  # 1 if joint k is on the path to body j
        for j, path in enumerate(self._tree.paths):
            self._path[j, np.array(path, dtype=int) - 1] = 1.0
        self._base_armature, self._armature = np.split(self._tree.armature, [r])
        self._G = np.eye(M) if system.coupled is None else system.coupled.G

    def bodies(self, x: Array) -> Bodies:
        """Return screws and inertias at shapes (N, m)."""
        screws, inertias = self._tree.bodies(self._system.joint_values(x))
        return Bodies(screws[:, 1:], inertias, self._subtrees(inertias))

    def base_rows(self, bodies: Bodies) -> tuple[Array, Array]:
        """Return the rows of the base in the mass matrix, (N, r, r) and (N, r, m)."""
        E, J = self._root, bodies.composites
        H = E.T @ J[:, 0] @ E + np.diag(self._base_armature)
        momenta = _times(J[:, 1:], bodies.screws)
        return H, np.swapaxes(momenta @ E, 1, 2) @ self._G

    def motion(
        self, bodies: Bodies, twist: Array, acceleration: Array, u: Array, w: Array
    ) -> Motion:
        """Compute torques and the wrench on the base.

        Args:
            bodies: Screws and inertias.
            twist: Base twists, (N, r).
            acceleration: Accelerations of the base in its frame, (N, r).
            u: Shape rates, (N, m).
            w: Shape accelerations, (N, m).
        Returns:
            The motion.
        """
        S, I, E = bodies.screws, bodies.inertias, self._root
        rates, accelerations = ((values @ self._G.T)[..., None] for values in (u, w))
        V = (twist @ E.T)[:, None] + self._path @ (S * rates)
        ad = SE3.ad(V)
        bias = S * accelerations + _times(ad[:, 1:], S) * rates
        A = (acceleration @ E.T)[:, None] + self._path @ bias
        h = _times(I, V)
        F = self._subtrees(_times(I, A) - _times(_transposed(ad), h))
        torque = np.sum(S * F[:, 1:], -1) + self._armature * accelerations[..., 0]
        wrench = F[:, 0] @ E + self._base_armature * acceleration
        return Motion(bodies, rates, V, A, ad, h, F, torque @ self._G, wrench)

    def first(self, s: Motion) -> Array:
        """Compute derivatives of the wrench on the base and of the torques.

        Args:
            s: The motion.
        Returns:
            (N, r + m, 2r + 3m): derivatives by base twist, base acceleration, shape, shape rate and
            shape acceleration.
        """
        S, J, E = s.bodies.screws, s.bodies.composites, self._root
        N, M, r = len(S), S.shape[1], E.shape[1]
        D = self._by_twist(s)
        adS = SE3.ad(S)
        tV, tA = self._inputs(s, adS)
        by_joint = _times(J[:, None, 1:], tA) + _times(D[:, None, 1:], tV)
        by_joint[:, 0] -= _times(_transposed(adS), s.F[:, 1:])
        JS = by_joint[:, 2]
        on_V = _times(_transposed(D[:, 1:]), S) - s.u * _times(_transposed(adS), JS)
        on_V -= _times(_transposed(s.ad[:, self._parents]), JS)
        result = np.zeros((N, r + M, 2 * r + 3 * M))
        result[:, :r, :r], result[:, :r, r : 2 * r] = E.T @ D[:, 0] @ E, E.T @ J[:, 0] @ E
        from_base = on_V + _times(_transposed(s.ad[:, :1]), JS)
        result[:, r:, :r], result[:, r:, r : 2 * r] = from_base @ E, JS @ E
        flat = by_joint.reshape(N, 3 * M, 6)
        result[:, :r, 2 * r :] = np.swapaxes(flat @ E, 1, 2)
        up, strict = np.tile(self._path[1:].T, 3), np.tile(self._path[self._parents], 3)
        ahead = tA + _times(s.ad[:, None, 1:], tV)
        inputs = np.concatenate([tV, ahead], -1).reshape(N, 3 * M, 12)
        result[:, r:, 2 * r :] = up * (S @ np.swapaxes(flat, 1, 2))
        result[:, r:, 2 * r :] += strict * (
            np.concatenate([on_V, JS], -1) @ np.swapaxes(inputs, 1, 2)
        )
        diagonal, base = np.arange(M), np.arange(r)
        result[:, r + diagonal, 2 * r + 2 * M + diagonal] += self._armature
        result[:, base, r + base] += self._base_armature
        return self._on_shape(result, (r, 1), (2 * r, 3))

    def second(self, s: Motion, on_wrench: Array, on_torque: Array) -> tuple[Array, Array]:
        """Compute derivatives of a weighted sum of the wrench on the base and of the torques.

        Args:
            s: The motion.
            on_wrench: Weights Y_0 of the wrench, (N, r).
            on_torque: Weights y of the torques, (N, m).
        Returns:
            First derivative by the base twist, (N, r), and second derivatives by base twist, base
            acceleration, shape, shape rate and shape acceleration, (N, 2r + 3m, 2r + 3m).
        """
        S, I, J, E = s.bodies.screws, s.bodies.inertias, s.bodies.composites, self._root
        N, M, r, up = len(S), S.shape[1], E.shape[1], self._parents
        y = (on_torque @ self._G.T)[..., None]
        Y = (on_wrench @ E.T)[:, None] + self._path @ (S * y)
        adY, adS, D = SE3.ad(Y), SE3.ad(S), self._by_twist(s)
        n, coS = _times(I, Y), -_transposed(adS)
        half = I @ adY
        B = (
            _times(_transposed(adY), s.h)
            - _times(_transposed(s.ad), n)
            - _times(I, _times(s.ad, Y))
        )
        G, B, n = (self._subtrees(values) for values in (half + _transposed(half), B, n))
        B += _times(_transposed(s.ad), n)
        tV, tA = self._inputs(s, adS)
        tY = np.zeros_like(tV)
        tY[:, 0] = -_times(adS, Y[:, up])
        GV = _times(G[:, None, 1:], tV)
        Pb = _times(J[:, None, 1:], tY)
        Pc = _times(J[:, None, 1:], tA) + _times(D[:, None, 1:], tV)
        Pa = _times(_transposed(D)[:, None, 1:], tY) + GV + s.u[:, None] * _times(coS[:, None], Pb)
        # Second derivatives by two variables of one joint.
        same = np.sum(tV[:, :, None] * GV[:, None] + tY[:, :, None] * Pc[:, None], -1)
        same += np.sum(Pc[:, :, None] * tY[:, None], -1)
        twice = -_times(adS, tV[:, 0])  # (V_p × S) × S
        by_A = -_times(adS, tA[:, 0])
        same[:, 0, 0] += np.sum(B[:, 1:] * twice + n[:, 1:] * by_A, -1)
        same[:, 0, 0] -= np.sum(s.F[:, 1:] * _times(adS, tY[:, 0]), -1)
        product = np.sum(n[:, 1:] * twice, -1)
        same[:, 0, 1] += product
        same[:, 1, 0] += product
        # Second derivatives by variables of a joint and of one above it.
        Sn = _times(coS, n[:, 1:])
        Pb[:, 0] += Sn
        Pc[:, 0] += _times(coS, s.F[:, 1:])
        Pa[:, 0] += _times(coS, B[:, 1:]) + s.u * _times(coS, Sn)
        Pa[:, 1] += Sn
        Pa -= _times(_transposed(s.ad[:, None, up]), Pb)
        t = np.zeros((N, 12 + 3 * M, 18))
        t[:, :12, :12] = np.eye(12)
        t[:, :6, 6:12] = _transposed(s.ad[:, 0])
        ahead = tA + _times(s.ad[:, None, 1:], tV)
        t[:, 12:] = np.concatenate([tV, ahead, tY], -1).reshape(N, 3 * M, 18)
        P = np.concatenate([Pa, Pb, Pc], -1).reshape(N, 3 * M, 18)
        pairs = t @ _transposed(P)
        pairs[:, 12:] *= np.tile(self._path[up].T, (3, 3))
        result = np.zeros((N, 2 * r + 3 * M, 2 * r + 3 * M))
        result[:, :r, :r] = E.T @ G[:, 0] @ E
        result[:, :r, 2 * r :], result[:, r : 2 * r, 2 * r :] = (
            E.T @ pairs[:, :6], E.T @ pairs[:, 6:12],
        )  # fmt: skip
        result[:, 2 * r :, : 2 * r] = _transposed(result[:, : 2 * r, 2 * r :])
        result[:, 2 * r :, 2 * r :] = pairs[:, 12:] + _transposed(pairs[:, 12:])
        joint = 2 * r + np.arange(3 * M).reshape(3, M)
        for i in range(3):
            for j in range(3):
                result[:, joint[i], joint[j]] += same[:, i, j]
        return B[:, 0] @ E, self._on_shape(result, (2 * r, 3), (2 * r, 3))

    def _by_twist(self, s: Motion) -> Array:
        """Return D, the derivative of the wrench on a subtree by its twist, (N, M + 1, 6, 6)."""
        half = s.bodies.inertias @ s.ad
        of_bodies = _momentum_operator(s.h) - half - _transposed(half)
        return np.asarray(self._subtrees(of_bodies) + s.bodies.composites @ s.ad)

    def _inputs(self, s: Motion, adS: Array) -> tuple[Array, Array]:
        """Return changes of twists and accelerations by (x, ẋ, ẍ) of the joints, (N, 3, M, 6)."""
        S, up = s.bodies.screws, self._parents
        VS, AS = -_times(adS, s.V[:, up]), -_times(adS, s.A[:, up])
        zero = np.zeros_like(S)
        bend = -_times(adS, VS) * s.u
        return np.stack([VS, S, zero], 1), np.stack([AS + bend, VS, S], 1)

    def _subtrees(self, values: Array) -> Array:
        """Sum values (N, M + 1, …) of bodies over their subtrees."""
        total = np.array(values)
        for j in range(len(self._parents), 0, -1):
            total[:, self._parents[j - 1]] += total[:, j]
        return total

    def _on_shape(self, matrix: Array, rows: tuple[int, int], columns: tuple[int, int]) -> Array:
        """Convert (rows of the base, blocks of joints) of a matrix from joints to the shape."""
        if self._system.coupled is None:
            return matrix

        def change(base: int, blocks: int) -> Array:
            return np.asarray(block_diag(np.eye(base), *[self._G] * blocks))

        return np.asarray(change(*rows).T @ matrix @ change(*columns))


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(matrices @ vectors[..., None])[..., 0]


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)


def _momentum_operator(h: Array) -> Array:
    """Return matrices that map a twist V to V ×* h, for momenta h (..., 6)."""
    result = np.zeros((*h.shape, 6))
    result[..., :3, 3:] = result[..., 3:, :3] = -hat(h[..., :3])
    result[..., 3:, 3:] = -hat(h[..., 3:])
    return result

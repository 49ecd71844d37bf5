"""Mass matrix, centre of mass and inverse dynamics with two derivatives at many states at once.

All terms are in the frame of the root body.  S_k is the screw of joint k, J_k the inertia (6 × 6)
of the composite body of its subtree, and F_j = J_j S_j the momentum of this body at unit rate:

    H_ij = S_i · F_j,     i from the root to j.

A joint a moves its whole subtree: screws change by [S_a, ·], momenta by −ad_aᵀ, and inertias by
X_a J = −(ad_aᵀ J + J ad_a).  If several joints of one path move a term, the last one acts first:

    ∂_a F_j = −ad_aᵀ F_j  (a up to j),     (X_a J_a) S_j  (a after j)

H_ij does not depend on joints before i, and joints of different branches are independent.

Each rate has a screw; the three of a ball are the child's axes.  ∂_a is the derivative e_a along
the frame of the shape.  All three axes of a ball move the ball's own screws, ∂_a S_b = [S_a, S_b],
so in ∂_a ∂_b the derivative ∂_b acts first.  The second derivatives of a ball do not commute:

    ∂_a ∂_b H − ∂_b ∂_a H = c^γ_ab ∂_γ H.
Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 2 and 6; differentiated here.

Inverse dynamics: body j has the twist V_j, the acceleration A_j and
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

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag

from ...common.arrays import Array, FrozenArrays
from ...lie.groups import SE3
from ...lie.rotations import hat, rotation
from ...system.coordinates import ShapeSpace, tree_space
from ...system.joints import axes_of, is_prismatic
from ...system.system import System


@dataclass(frozen=True)
class InertiaDerivatives(FrozenArrays):
    """H(x) and the centre of mass c(x) with two derivatives; arrays are read-only.

    Attributes:
        H: Mass matrix, (N, n, n), base rows first.
        dH: Derivative of H, (N, n, n, m), derivative index last.
        d2H: Second derivative of H, (N, n, n, m, m), derivative indices last: d2H[..., a, b] is
            ∂_a ∂_b H, with ∂_b applied first.
        com: Centre of mass in the root body's frame, (N, 3) [m].
        dcom: Derivative of the centre of mass, (N, 3, m).
        d2com: Second derivative of the centre of mass, (N, 3, m, m), like d2H.
    """

    H: Array
    dH: Array
    d2H: Array
    com: Array
    dcom: Array
    d2com: Array


def inertia_derivatives(
    system: System, x: Array, *, of: Collection[int] | None = None
) -> InertiaDerivatives:
    """Compute the mass matrix and the centre of mass with their derivatives.

    Args:
        system: The system.
        x: Shapes, (N, nx) [rad | m | 1].
        of: Rates whose columns of H are differentiated; all if None.  A small set saves most of
            the work.  Entries of dH and d2H between other joints are then undefined.
    Returns:
        The values and derivatives.
    """
    tree = system.workspace(ScrewTree, lambda: ScrewTree(system))
    return tree.derivatives(x, None if system.coupled is not None else of)


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint of a tree behind the root.

    Attributes:
        x: Index of its first coordinate among those of all joints.
        rates: Its rates, numbered from 1.
        parent: Last rate of the parent body's joint, 0 for the root.
        turn: Rotation of the joint's placement on the parent, (3, 3).
        step: Translation of this placement, (3,) [m].
        axis: Screw of a hinge or slide in the child's frame, (6,).
        is_slide: Whether the joint is a slide.
        is_ball: Whether the joint is a ball.
        body: Inertia of the child.
    """

    x: int
    rates: range
    parent: int
    turn: Array
    step: Array
    axis: Array
    is_slide: bool
    is_ball: bool
    body: pin.Inertia


def _joint(model: pin.Model, i: int, space: ShapeSpace) -> _Joint:
    """Return joint i of a model, in the manifold of all joints behind the root."""
    joint, up, place = model.joints[i], int(model.parents[i]), model.jointPlacements[i]
    placed = space.joints[i - 2]
    return _Joint(
        x=placed.x.start,
        rates=range(placed.v.start + 1, placed.v.stop + 1),
        parent=0 if up == 1 else space.joints[up - 2].v.stop,
        turn=np.array(place.rotation),
        step=np.array(place.translation),
        axis=axes_of(joint)[:, 0],
        is_slide=is_prismatic(joint),
        is_ball=placed.kind.is_ball,
        body=model.inertias[i],
    )


class ScrewTree:
    """The constants of a tree, and the recursion over it.

    Attributes:
        count: Number M of rates of joints.
        root: Screws of the base, which are constant in its frame, (6, r).
        armature: Armature of base and joints, (r + M,).
        parents: Last rate of the parent of each rate, numbered from 1, 0 for the root.
        paths: Rates from the root to each rate, numbered from 1.
    """

    def __init__(self, system: System) -> None:
        """Store the constants."""
        model, space = system.sorted_model, tree_space(system.sorted_model)
        self._system, self.count = system, space.m
        self._joints = [_joint(model, i, space) for i in range(2, model.njoints)]
        self.root = axes_of(model.joints[1])  # screws of the base, constant in its frame
        self._root_body = model.inertias[1]
        self.armature = np.array(model.armature)
        self.parents = np.array([joint.parent for joint in self._joints for _ in joint.rates], int)
        # Rates are numbered from 1, and 0 is the root.
        self.paths, self._siblings = [list[int]()], [range(1)]
        for joint in self._joints:
            self._siblings += [joint.rates] * len(joint.rates)
            self.paths += [[*self.paths[joint.parent], *joint.rates]] * len(joint.rates)

    def derivatives(self, x: Array, of: Collection[int] | None) -> InertiaDerivatives:
        """Compute the sums over the tree; see `inertia_derivatives`."""
        N, M, r = len(x), self.count, self.root.shape[1]
        screws, composites = self._composites(self._system.joint_values(x))
        ad = SE3.ad(screws)  # (N, M + 1, 6, 6); the root's is not used
        H, dH = np.zeros((N, r + M, r + M)), np.zeros((N, r + M, r + M, M))
        d2H = np.zeros((N, r + M, r + M, M, M))
        first, second = np.zeros((N, M, 6, 6)), np.zeros((N, M, M, 6, 6))
        dJ, twice = {}, {}
        for b in range(1, M + 1):
            dJ[b] = _inertia_change(ad[:, b], composites[:, b])
            first[:, b - 1] = dJ[b]
            for a in self.paths[b]:
                twice[a, b] = _inertia_change(ad[:, a], dJ[b])
                second[:, a - 1, b - 1] = twice[a, b]
                if a not in self._siblings[b]:
                    second[:, b - 1, a - 1] = twice[a, b]
        E, J = self.root, composites[:, 0]
        H[:, :r, :r] = E.T @ J @ E
        dH[:, :r, :r] = np.moveaxis(E.T @ first @ E, 1, -1)
        d2H[:, :r, :r] = np.moveaxis(E.T @ second @ E, (1, 2), (-2, -1))
        for j in range(1, M + 1):
            S = screws[:, j, :, None]
            F = composites[:, j] @ S
            path = self.paths[j]
            path_screws = np.concatenate([np.broadcast_to(E.T, (N, r, 6)), screws[:, path]], axis=1)
            indices = [*range(r), *(r + k - 1 for k in path)]
            c = r + j - 1
            H[:, indices, c] = (path_screws @ F)[..., 0]
            if of is not None and j - 1 not in of:
                continue
            for b, dF in self._momentum_derivatives(j, ad, dJ, S, F):
                count = len(indices) if b not in path else r + self._moving(path, b)
                dH[:, indices[:count], c, b - 1] = (path_screws[:, :count] @ dF)[..., 0]
                for a in self.paths[b]:
                    if a in path:
                        d2F = -np.swapaxes(ad[:, a], 1, 2) @ dF
                    elif j in self.paths[a]:
                        d2F = twice[a, b] @ S
                    else:
                        continue
                    last = count if a not in path else r + self._moving(path, a)
                    entry, i = (path_screws[:, :last] @ d2F)[..., 0], indices[:last]
                    d2H[:, i, c, a - 1, b - 1] = entry
                    if a not in self._siblings[b]:
                        d2H[:, i, c, b - 1, a - 1] = entry
        for c in range(r, r + M):
            H[:, c, :c] = H[:, :c, c]
            if of is None or c - r in of:
                dH[:, c, :c], d2H[:, c, :c] = dH[:, :c, c], d2H[:, :c, c]
        diagonal = np.arange(r + M)
        H[:, diagonal, diagonal] += self.armature
        mass = self._system.mass
        return self._on_shape(
            H,
            dH,
            d2H,
            *(_moment(inertia) / mass for inertia in (J[:, None, None], first[:, None], second)),
        )

    def _moving(self, path: list[int], b: int) -> int:
        """Return the number of rates i on a path for which H_ij may depend on joint b.

        H_ij does not depend on the joints before i, nor on a ball if i is one of its axes.
        """
        first = path.index(self._siblings[b][0])
        return first + 1 if len(self._siblings[b]) == 1 else first

    def _momentum_derivatives(
        self, j: int, ad: Array, dJ: dict[int, Array], S: Array, F: Array
    ) -> Iterator[tuple[int, Array]]:
        """Yield the joints b on whose angle F_j depends, with ∂_b F_j, (N, 6, 1).

        Args:
            j: Index of the joint.
            ad: ad of all screws, (N, M + 1, 6, 6).
            dJ: Derivative of each composite inertia with respect to its joint.
            S: Screw of joint j, (N, 6, 1).
            F: Momentum of joint j's subtree at unit rate, (N, 6, 1).
        """
        for b in range(1, self.count + 1):
            if b in self.paths[j]:
                yield b, -np.swapaxes(ad[:, b], 1, 2) @ F
            elif j in self.paths[b]:
                yield b, dJ[b] @ S

    def _composites(self, x: Array) -> tuple[Array, Array]:
        """Return screws (N, M + 1, 6) and composite inertias (N, M + 1, 6, 6) at joint values x."""
        screws, inertias = self.bodies(x)
        for joint in reversed(self._joints):
            inertias[:, self._siblings[joint.parent]] += inertias[:, joint.rates[0], None]
        return screws, inertias

    def bodies(self, x: Array) -> tuple[Array, Array]:
        """Return screws (N, M + 1, 6) and inertias (N, M + 1, 6, 6) at joint values x (N, nx)."""
        N, M = len(x), self.count
        R, p = np.zeros((N, M + 1, 3, 3)), np.zeros((N, M + 1, 3))
        R[:, 0] = np.eye(3)
        screws, inertias = np.zeros((N, M + 1, 6)), np.zeros((N, M + 1, 6, 6))
        inertias[:, 0] = self._root_body.matrix()
        for joint in self._joints:
            up, i, k = joint.parent, joint.x, joint.rates[0]
            p[:, k] = p[:, up] + R[:, up] @ joint.step
            R[:, k] = R[:, up] @ joint.turn
            if joint.is_ball:
                R[:, k] = R[:, k] @ rotation(x[:, i : i + 4])
                for n in range(3):
                    axis = R[:, k, :, n]
                    screws[:, k + n, :3], screws[:, k + n, 3:] = _cross(p[:, k], axis), axis
                last = joint.rates[-1]
                R[:, last], p[:, last] = R[:, k], p[:, k]
            elif joint.is_slide:
                axis = R[:, k] @ joint.axis[:3]
                p[:, k] += axis * x[:, i, None]
                screws[:, k, :3] = axis
            else:
                axis = R[:, k] @ joint.axis[3:]
                R[:, k] = R[:, k] @ _rotations(joint.axis[3:], x[:, i])
                screws[:, k, :3], screws[:, k, 3:] = _cross(p[:, k], axis), axis
            inertias[:, k] = _in_root(joint.body.matrix(), R[:, k], p[:, k])
            inertias[:, joint.rates] = inertias[:, k, None]
        return screws, inertias

    def _on_shape(self, H: Array, dH: Array, d2H: Array, *com: Array) -> InertiaDerivatives:
        """Convert derivatives by all joints x = G y + b to derivatives by the shape y."""
        coupled, r = self._system.coupled, self.root.shape[1]
        c, dc, d2c = com[0][:, 0, 0], np.moveaxis(com[1][:, 0], 1, -1), np.moveaxis(com[2], 3, 1)
        if coupled is None:
            return InertiaDerivatives(H, dH, d2H, c, dc, d2c)
        # `coupled` acts on the last axes, so the derivative axes are moved to the front and
        # afterwards back.
        move = np.moveaxis
        H = coupled.matrix(H, r)
        dH = move(coupled.matrix(move(coupled.forces(dH, 0), -1, 1), r), 1, -1)
        by_shape = move(coupled.matrix(d2H, 0), (-2, -1), (1, 2))
        d2H = move(coupled.matrix(by_shape, r), (1, 2), (-2, -1))
        return InertiaDerivatives(H, dH, d2H, c, coupled.forces(dc, 0), coupled.matrix(d2c, 0))


def _inertia_change(ad: Array, J: Array) -> Array:
    """Return the change X J = −(adᵀ J + J ad) of a symmetric inertia J, (N, 6, 6)."""
    half = J @ ad
    return np.asarray(-(half + np.swapaxes(half, -1, -2)))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of vectors (N, 3), faster than NumPy's."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _rotations(axis: Array, angle: Array) -> Array:
    """Return rotations about an axis by angles (N,), (N, 3, 3) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))


def _in_root(J: Array, R: Array, p: Array) -> Array:
    """Return a body's inertia J (6, 6) in the root's frame, (N, 6, 6).

    R, p: rotations (N, 3, 3) and positions (N, 3) of the body.
    """
    to_body = np.zeros((len(p), 6, 6))  # maps twists from the root's to the body's frame
    to_body[:, :3, :3] = to_body[:, 3:, 3:] = T = np.swapaxes(R, 1, 2)
    x, y, z = p.T
    zero = np.zeros_like(x)
    hat = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    to_body[:, :3, 3:] = -T @ np.moveaxis(hat, -1, 0)
    return np.asarray(np.swapaxes(to_body, 1, 2) @ J @ to_body)


def _moment(J: Array) -> Array:
    """Return mass times centre of mass, (..., 3), from an inertia (..., 6, 6)."""
    return np.stack([J[..., 5, 1], J[..., 3, 2], J[..., 4, 0]], axis=-1)


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

"""The full system in Pinocchio: coordinates of the full state, totals, and constraints.

The root joint is described by Pinocchio's motion subspace alone, independent of pinred's groups.
The functions of coordinates accept arrays of symbols, too, which full_dynamics.py compiles.

Couplings between joints are constraints. This is independent of the reduction, which eliminates
follower (mimic) joints. In the full system all joints move. Multipliers keep each follower coupled
to its leaders, a_f − Σ k a_l = 0:

    a = a₀ − M⁻¹Jᵀ (J M⁻¹Jᵀ)⁻¹ J a₀,   a₀ and M⁻¹Jᵀ computed with Pinocchio's ABA.

Closed loops are further constraints, J(q) a + J̇ v = 0. Their equations and Jacobian come from the
frames in Pinocchio's model; the reduced equations use other expressions. Of redundant rows, those
are used that the system states as independent; `loop_errors` measures all of them. One linear
system for accelerations and multipliers is solved instead if the mass matrix of the uncoupled tree
is singular, or if accelerations are prescribed as well. Without couplings and loops ABA is used
alone, or the rows of Pinocchio's mass matrix without those of the joints with prescribed
accelerations.
Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 8.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..forces.force_numbers import FunctionBuffers
from ..system.loops.kinematics import LoopKinematics
from ..system.loops.loop_assembly import assemble, loop_length
from ..system.singular_mass_matrix import SingularShapes, singular_shapes
from ..system.state_fields import State
from ..system.system import System, moved_masses
from .reference_integrators import dposv


@dataclass(frozen=True)
class RootMotion:
    """Kinematics of the root joint of a model.

    Attributes:
        axes: Motion subspace in the joint's fixed frame, (6, r), translations first.
        linear: Number of translational directions.
        turns: Number of rotational directions.
        plane: The two translations that a single rotation mixes (planar joint), or None.
        circle: Whether Pinocchio stores the angle as cosine and sine.
    """

    axes: Array
    linear: int
    turns: int
    plane: tuple[int, int] | None
    circle: bool

    @property
    def size(self) -> int:
        """Number of root coordinates: positions, then the angle or the quaternion."""
        return self.linear + (4 if self.turns == 3 else self.turns)

    @property
    def is_pivoted(self) -> bool:
        """Whether the base rotates about a fixed point, so momentum is taken about that point."""
        slides_across = self.plane is not None or (self.turns == 3 and self.linear == 3)
        return self.turns > 0 and not slides_across

    def rate(
        self, root: Array | Sequence[float], v: Array | Sequence[float]
    ) -> Sequence[Any] | Array:
        """Compute the time derivative of the root coordinates (size,) at a body twist v (r,).

        Args:
            root: Root coordinates, (size,), numbers or symbols.
            v: Body twist, (r,).
        Returns:
            The time derivative, (size,).
        """
        if self.turns < 3:
            if self.plane is None:
                return v
            rate, (first, second) = list(v), self.plane
            (c,), (s,) = np.cos(root[-1:]), np.sin(root[-1:])
            rate[first] = c * v[first] - s * v[second]
            rate[second] = s * v[first] + c * v[second]
            return rate
        i, j, k, w = root[-4:]
        *slide, p, q, s = v
        quaternion_rate = [
            0.5 * (w * p + j * s - k * q),
            0.5 * (w * q + k * p - i * s),
            0.5 * (w * s + i * q - j * p),
            -0.5 * (i * p + j * q + k * s),
        ]
        if not slide:
            return quaternion_rate
        a, b, c = slide  # body translation, to be rotated by the matrix 1 + 2 (w ω̂ + ω̂²) / |q|²
        two = 2.0 / (i * i + j * j + k * k + w * w)
        l, m, n = two * (j * c - k * b), two * (k * a - i * c), two * (i * b - j * a)
        return [
            a + w * l + j * n - k * m,
            b + w * m + k * l - i * n,
            c + w * n + i * m - j * l,
            *quaternion_rate,
        ]

    def q(self, root: Array) -> Array:
        """Convert root coordinates (..., size) to Pinocchio's configuration of the joint."""
        if self.circle:
            angle = root[..., -1:]
            return np.concatenate((root[..., :-1], np.cos(angle), np.sin(angle)), axis=-1)
        q = root.copy()
        if self.turns == 3:
            normalise(q[..., -4:])
        return q


def normalise(quaternions: Array) -> None:
    """Divide quaternions (..., 4), of numbers or symbols, by their norms, in place."""
    quaternions /= np.sqrt((quaternions * quaternions).sum(axis=-1, keepdims=True))


def root_motion(model: pin.Model) -> RootMotion:
    """Derive the kinematics of the root joint of a model."""
    joint, single_joint = model.joints[1], pin.Model()
    single_joint.addJoint(0, joint, pin.SE3.Identity(), "alone")
    data = single_joint.createData()
    pin.computeJointJacobians(single_joint, data, pin.neutral(single_joint))
    axes = np.array(data.joints[1].S).reshape(6, joint.nv)
    linear = int((~axes[3:].any(axis=0)).sum())
    turns = joint.nv - linear
    plane = _mixed_translations(axes, linear) if turns == 1 else None
    return RootMotion(axes, linear, turns, plane, circle=turns == 1 and joint.nq > joint.nv)


def _mixed_translations(axes: Array, linear: int) -> tuple[int, int] | None:
    """Return the two translations that the single rotation of a root joint mixes, if any."""
    rotated = np.cross(axes[3:, -1], axes[:3, :linear], axis=0)
    overlap = axes[:3, :linear].T @ rotated  # (i, j): component of rotated axis j along axis i
    pairs = np.argwhere(overlap > 0.5)
    return (int(pairs[0, 1]), int(pairs[0, 0])) if pairs.size else None


class Configuration:
    """Coordinates of all joints except the root, and their map to Pinocchio's configuration q.

    A joint has one unwrapped value; a ball has a quaternion (x, y, z, w) of any length.

    Attributes:
        size: Number of coordinates.
        rates: Number of rates.
        balls: First coordinate and first rate of each ball.
    """

    def __init__(self, model: pin.Model, root: RootMotion) -> None:
        """Derive the coordinates from the numbers nq and nv of Pinocchio's joints."""
        # Index of each entry of q in (q of the root, coordinates, cosines, sines).
        order = list(range(model.joints[1].nq))
        circles: list[int] = []
        self.balls: list[tuple[int, int]] = []
        self.size = self.rates = 0
        joints = list(model.joints)[2:]
        first, count = len(order), sum(joint.nq == 2 for joint in joints)
        cosine = first + sum(joint.nq if joint.nq != 2 else 1 for joint in joints)
        for joint in joints:
            if joint.nq == 2:
                order += [cosine + len(circles), cosine + count + len(circles)]
                circles.append(self.size)
                self.size += 1
            else:
                if joint.nv == 3:
                    self.balls.append((self.size, self.rates))
                order += [first + self.size + k for k in range(joint.nq)]
                self.size += joint.nq
            self.rates += joint.nv
        self._root, self._has_circles = root, bool(circles)
        self._circles, self._order = np.array(circles, dtype=np.intp), np.array(order)

    def __call__(self, root: Array, joints: Array) -> Array:
        """Return q (..., nq) for root coordinates and the coordinates of all joints."""
        root_q, joints = self._root.q(root), self.normalised(joints)
        if not self._has_circles:
            return np.concatenate((root_q, joints), axis=-1)
        angles = joints[..., self._circles]
        entries = root_q, joints, np.cos(angles), np.sin(angles)
        return np.asarray(np.concatenate(entries, axis=-1)[..., self._order])

    def normalised(self, joints: Array) -> Array:
        """Return the coordinates of all joints, (..., size), with quaternions of length one."""
        if self.balls:
            joints = joints.copy()
            for first, _ in self.balls:
                normalise(joints[..., first : first + 4])
        return joints

    def derivative(self, joints: Array, v: Array) -> Sequence[Any]:
        """Return the time derivative of the coordinates at rates v; see RootMotion.rate."""
        derivative: list[Any] = []
        first_v = 0
        for x, rate in self.balls:
            derivative.extend(v[first_v:rate])
            i, j, k, w = joints[x : x + 4]
            a, b, c = v[rate : rate + 3]
            derivative += [
                0.5 * (w * a + j * c - k * b),
                0.5 * (w * b + k * a - i * c),
                0.5 * (w * c + i * b - j * a),
                -0.5 * (i * a + j * b + k * c),
            ]
            first_v = rate + 3
        return [*derivative, *v[first_v:]]


# Levi-Civita symbol: a × b = Σ ε_ijk a_j b_k.
_CROSS = np.array([np.cross(axis, np.eye(3)) for axis in np.eye(3)])


class SystemTotals:
    """Sums over all bodies of a model, as functions of Pinocchio's q and v.

    Energies and momenta accept one state, or T states with a leading axis.

    Attributes:
        mass: Total mass [kg].
    """

    def __init__(self, model: pin.Model, root: RootMotion) -> None:
        """Prepare copies of the model without gravity, without armature, and with pivot gravity."""
        self._model, self._data, self._root = model, pin.Data(model), root
        self._r, self._linear = root.axes.shape[1], root.linear
        self._weightless = model.copy()
        self._weightless.gravity.setZero()
        # Pinocchio 4.1 omits the armature of revolute joints with a general axis from the
        # kinetic energy, so it is added here.
        self._bare = model.copy()
        self._bare.armature = np.zeros(model.nv)
        self._rotors = model.armature[: self._r].copy()
        placement = model.jointPlacements[1]
        self._to_root, self._pivot = placement.rotation.T.copy(), placement.translation.copy()
        self._axes = np.hstack([axes.T @ self._to_root for axes in (root.axes[:3], root.axes[3:])])
        self._slides = placement.rotation @ root.axes[:3, : root.linear]
        # Gravity along the root's translations only accelerates the centre of mass.
        self._pivot_gravity = model.copy()
        along = self._slides @ (self._slides.T @ model.gravity.linear)
        self._pivot_gravity.gravity.linear -= along
        pin.ccrba(model, self._data, pin.neutral(model), np.zeros(model.nv))
        self.mass = float(self._data.Ig.mass)

    def radius_of_gyration(self, q: Array) -> float:
        """Compute the radius of gyration about the centre of mass, √(tr I / m) [m]."""
        pin.ccrba(self._model, self._data, q, np.zeros(self._model.nv))
        return float(np.sqrt(np.trace(self._data.Ig.inertia) / self._data.Ig.mass))

    def kinetic_energy(self, q: Array, v: Array) -> Array:
        """Compute the kinetic energy, armature included, (...) [J]."""
        rotors = 0.5 * v**2 @ self._model.armature
        energy = partial(pin.computeKineticEnergy, self._bare, self._data)
        return np.asarray(_at_states(energy, q, v) + rotors)

    def potential_energy(self, q: Array) -> Array:
        """Compute the potential energy in the model's gravity, (...) [J]."""
        return _at_states(partial(pin.computePotentialEnergy, self._model, self._data), q)

    def com_kinetic_energy(self, centroidal: Array) -> Array:
        """Compute the kinetic energy of the centre of mass along translations, (...) [J].

        Args:
            centroidal: Result of `centroidal`.
        Returns:
            The energy.
        """
        momentum = centroidal[..., :3] @ self._axes[: self._linear, :3].T
        return np.asarray(0.5 * (momentum * momentum).sum(axis=-1) / self.mass)

    def body_momentum(self, q: Array, v: Array) -> Array:
        """Compute the body momentum μ of the base, (..., r) [N·s; N·m·s]."""
        model, data, zero = self._weightless, self._data, np.zeros(v.shape[-1])
        return _at_states(lambda q, v: pin.rnea(model, data, q, zero, v)[: self._r], q, v)

    def momentum(
        self,
        q: Array,
        v: Array,
        fall: Array,
        *,
        about_pivot: bool,
        centroidal: Array | None = None,
    ) -> Array:
        """Compute the momentum along the group's axes in the root's fixed frame.

        Args:
            q: Pinocchio's configuration, (..., nq).
            v: Pinocchio's velocity, (..., nv).
            fall: Linear momentum gained in free fall, subtracted, (..., 3) [N·s].
            about_pivot: Whether angular momentum is taken about the frame's origin; otherwise about
                the centre of mass.
            centroidal: Result of `centroidal` at these states; computed if None.
        Returns:
            (..., r) linear, then angular momentum [N·s; N·m·s].
        """
        moving = self.centroidal(q, v) if centroidal is None else centroidal.copy()
        momentum, com = np.split(moving, [6], axis=-1)
        if about_pivot:
            arm = com - self._pivot + q[..., : self._linear] @ self._slides.T
            # np.cross is ten times slower.
            momentum[..., 3:] += np.einsum("ijk,...j,...k", _CROSS, arm, momentum[..., :3])
        momentum[..., :3] -= fall
        return np.asarray(momentum @ self._axes.T + self._rotors * v[..., : self._r])

    def centroidal(self, q: Array, v: Array) -> Array:
        """Return the momentum about the centre of mass and its position, (..., 9), at the origin.

        Both have the world's axes.
        """
        model, data = self._model, self._data

        def at_state(q: Array, v: Array) -> Array:
            pin.ccrba(model, data, q, v)
            return np.concatenate((data.hg.vector, data.com[0]))

        return _at_states(at_state, self.at_origin(q), v)

    def about_com(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute body twist and body momentum relative to the centre of mass.

        About a pivot, angular momentum refers to the pivot.

        Args:
            q: Configuration, (nq,).
            v: Velocity, (nv,).
        Returns:
            Body twist and body momentum, (r,) each.
        """
        data, r, k = self._data, self._r, self._linear
        momentum = self.momentum(q, v, np.zeros(3), about_pivot=self._root.is_pivoted)
        to_body = data.oMi[1].rotation.T
        xi, mu = v[:r].copy(), np.zeros(r)
        if k:
            velocity = to_body @ data.hg.linear / data.Ig.mass
            xi[:k] -= (self._root.axes[:3].T @ velocity)[:k]
        angular = momentum[k:]
        mu[k:] = to_body @ (angular @ self._to_root) if len(angular) == 3 else angular
        return xi, mu

    def gravity_slopes(self, q: Array) -> Array:
        """Return the magnitudes of the gravity forces, (..., nv), without free fall."""
        if not self._pivot_gravity.gravity.linear.any():
            return np.zeros((*q.shape[:-1], self._model.nv))
        gravity = partial(pin.computeGeneralizedGravity, self._pivot_gravity, self._data)
        return np.abs(_at_states(gravity, q))

    def pivot_load_sizes(self, q: Array) -> Array:
        """Return the magnitudes of gravity's moments about the pivot axes, (T, turns)."""
        return gravity_load_sizes(self._pivot_gravity, self._data, q)[:, self._linear : self._r]

    def at_origin(self, q: Array) -> Array:
        """Return q (..., nq) with the base moved to the origin.

        Pinocchio sums momenta in the world frame, with round-off of the distance squared.
        """
        q = q.copy()
        q[..., : self._linear] = 0.0
        return q


def _at_states(function: Callable[..., Any], *arrays: Array) -> Array:
    """Return a function's results at one state, or at T states with a leading axis."""
    if arrays[0].ndim == 1:
        return np.asarray(function(*arrays))
    return np.array([function(*state) for state in zip(*arrays, strict=True)])


def mass_matrix(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Compute Pinocchio's mass matrices (..., nv, nv) at configurations (..., nq)."""
    # CRBA fills the upper triangle only, of a matrix that its next call overwrites.
    upper = np.triu(_at_states(lambda q: pin.crba(model, data, q).copy(), q))
    return np.asarray(upper + np.triu(upper, 1).swapaxes(-2, -1))


def gravity_load_sizes(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Compute Σ m |g| |c − p| over the bodies that each velocity coordinate moves.

    Args:
        model: Model with its gravity.
        data: Work space of the model.
        q: Pinocchio's configurations, (T, nq).
    Returns:
        (T, nv) [N·m | N]. c is a body's centre of mass and p the position of the joint.
        Prismatic joints have no lever arm; their entry is Σ m |g|.
    """
    loads = np.zeros((len(q), model.nv))
    g = float(np.linalg.norm(model.gravity.linear))
    if not g:
        return loads
    angular, mass = moved_masses(model, data, q[0])
    bodies = range(1, model.njoints)
    levers = [model.inertias[i].lever for i in bodies]
    force = np.array([g * model.inertias[i].mass for i in bodies])
    origins, centres = np.empty((2, len(q), len(bodies), 3))
    for k, q_k in enumerate(q):
        pin.forwardKinematics(model, data, q_k)
        places = [data.oMi[i] for i in bodies]
        origins[k] = [place.translation for place in places]
        centres[k] = [place.act(lever) for place, lever in zip(places, levers, strict=True)]
    for i in bodies:
        joint = model.joints[i]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        subtree = np.array(list(model.subtrees[i])) - 1
        moments = np.linalg.norm(centres[:, subtree] - origins[:, [i - 1]], axis=2) @ force[subtree]
        loads[:, columns] = np.where(angular[columns], moments[:, None], g * mass[columns])
    return loads


RANK = 1e-6  # singular values below this fraction of the largest belong to redundant equations


@dataclass(frozen=True)
class LoopErrors:
    """Violations of the loops along a motion.

    Attributes:
        gap: Largest |φ|, in units of the size of the loops or 1 rad; None without loops.  Files
            round numbers, so redundant equations may differ by rounding from others; the part of φ
            that no joint can change is left out.
        rate: Largest |φ̇|, without the same part, relative to its largest value if all joints moved
            at the fastest rate; None without loops.
    """

    gap: float | None = None
    rate: float | None = None


def loop_errors(system: System, states: State) -> LoopErrors:
    """Measure the violations of the loops with Pinocchio at the q and v of states."""
    loops = (*system.loops, *system.contents.coupled_loops)
    if not loops:
        return LoopErrors()
    kinematics = LoopKinematics(system.sorted_model, loops)
    unit = np.where(kinematics.is_length, loop_length(system, loops), 1.0)
    gap, rates, terms = 0.0, np.zeros(len(unit)), np.zeros(len(unit))
    for q, v in zip(system.sort_q(states.q), system.sort_v(states.v), strict=True):
        J = kinematics.jacobian(q)
        both = _reachable(J[:, system.r :], np.column_stack([kinematics.values(q), J @ v]))
        gaps, gap_rates = np.abs(both).T / unit
        gap, rates = max(gap, float(gaps.max())), np.maximum(rates, gap_rates)
        # The joints of a loop may rest exactly, so the unit is the fastest rate of any joint.
        fastest = float(np.abs(v[system.r :]).max(initial=0.0))
        terms = np.maximum(terms, np.abs(J).sum(axis=1) * fastest / unit)
    largest = float(terms.max())
    return LoopErrors(gap, float(rates.max()) / largest if largest > 0.0 else 0.0)


def _reachable(J: Array, values: Array) -> Array:
    """Return the parts of values of φ or φ̇, (c, k), that joints can change."""
    U, sizes, _ = np.linalg.svd(J, full_matrices=False)
    U = U[:, sizes > RANK * sizes[0]]
    return np.asarray(U @ (U.T @ values))


def closed(
    system: System, x: Array, xdot: Array, driven: Collection[int] = ()
) -> tuple[Array, Array]:
    """Return the nearest shape (nx,) and rates (m,) that keep all loops closed.

    Rates with the indices `driven`, and the coordinates of their joints, do not change.
    """
    assert system.closure is not None
    free = np.ones(system.m)
    free[list(driven)] = 0.0
    x, _ = assemble(system, x, system.closure.length, free)
    kinematics = LoopKinematics(system.sorted_model, system.loops)
    q = system.sorted_q(system.group.identity(), x)
    J = system.on_shape(kinematics.jacobian(q))[:, system.r :]
    return x, xdot - np.linalg.lstsq(J * free, J @ xdot, rcond=RANK)[0] * free


class _FreeRows:
    """The linear equations of all accelerations when some of them are prescribed.

    The rows of prescribed accelerations are those of the identity matrix. Compiled code fills the
    equations, because numpy's selection of rows and columns takes longer than their solution.

    Attributes:
        inputs: Mass matrix H row by row, of which only the upper triangle is read, because CRBA
            computes no more, (nv²,); forces (nv,); and prescribed accelerations (k,).
        matrix: Lower triangle of the symmetric matrix, (nv, nv), which `run` computes.
        right: Right-hand side, (nv,), which `run` computes.
        run: Function without arguments that computes the equations.
    """

    def __init__(self, nv: int, driven: list[int]) -> None:
        """Compile the equations of a model with nv velocities; `driven`: prescribed velocities."""
        free = [k for k in range(nv) if k not in driven]
        columns, force = ca.SX.sym("H", nv, nv), ca.SX.sym("force", nv)  # CasADi reads columns
        known = ca.SX.sym("known", len(driven))
        H = ca.tril2symm(ca.tril(columns))
        matrix, right = ca.SX(nv, nv), ca.SX(nv, 1)
        matrix[free, free], matrix[driven, driven] = H[free, free], ca.SX.eye(len(driven))
        right[free], right[driven] = force[free] - H[free, driven] @ known, known
        outputs = [ca.densify(ca.tril(matrix)), ca.densify(right)]
        buffers = FunctionBuffers(ca.Function("free", [columns, force, known], outputs))
        self.inputs, (self.matrix, column) = buffers.inputs, buffers.outputs
        self.right, self.run = column[:, 0], buffers.run


class CouplingConstraints:
    """The couplings of a system, each between a follower and its leaders as named in the file.

    Attributes:
        J: Constraint Jacobian, (c, nv), with J v = 0.
        leads: Indices of the shape's rates among the rates of all joints, (m,).
        leads_x: Indices of the shape's coordinates among the coordinates of all joints, (nx,).
    """

    def __init__(self, system: System) -> None:
        """Collect the couplings of a system by joint names."""
        model, r = system.sorted_model, system.r
        at = {name: k for k, name in enumerate(system.tree.names)}
        at_x = {name: k for k, name in enumerate(system.tree.x_names)}
        pending, placed = list(system.couplings), {*system.shape_names}
        self._at_x = {at[name]: k for name, k in at_x.items() if name in at}
        self._couplings: list[tuple[int, dict[int, float], float]] = []
        while pending:  # process leaders before their followers
            coupling = next(c for c in pending if placed.issuperset(c.leaders))
            pending.remove(coupling)
            placed.add(coupling.follower)
            ratios = {at[leader]: ratio for leader, ratio in coupling.ratios.items()}
            self._couplings.append((at[coupling.follower], ratios, coupling.offset))
        self.J = np.zeros((len(self._couplings), model.nv))
        for row, (follower, ratios, _) in zip(self.J, self._couplings, strict=True):
            row[r + follower] = 1.0
            for leader, ratio in ratios.items():
                row[r + leader] -= ratio
        self.leads = np.array([at[name] for name in system.shape_names], dtype=np.intp)
        self.leads_x = np.array([at_x[name] for name in system.x_names], dtype=np.intp)
        self._count, self._count_x = len(at), len(at_x)
        self._model, self._data = model, model.createData()
        self._weightless = model.copy()
        self._weightless.gravity.setZero()
        self._borders: dict[tuple[int, ...], Array] = {}
        self._uses_aba = not self._couplings or singular_shapes(model) == SingularShapes()
        self._loops = LoopKinematics(model, system.loops) if system.loops else None
        self._independent = None if system.closure is None else system.closure.rows
        self._is_constrained = bool(self._couplings or system.loops)
        self._all_lead = np.array_equal(self.leads, np.arange(len(at)))
        self._all_lead_x = np.array_equal(self.leads_x, np.arange(len(at_x)))
        self._free_rows: dict[tuple[int, ...], _FreeRows] = {}

    def values(self, x: Array) -> Array:
        """Return the coordinates of all joints at shape x (..., nx)."""
        coordinates, at = np.zeros((*x.shape[:-1], self._count_x), dtype=x.dtype), self._at_x
        coordinates[..., self.leads_x] = x
        for follower, ratios, offset in self._couplings:
            coordinates[..., at[follower]] = offset
            for leader, ratio in ratios.items():
                coordinates[..., at[follower]] += ratio * coordinates[..., at[leader]]
        return coordinates

    def rates(self, xdot: Array) -> Array:
        """Return the rates of all joints at shape rate ẋ (..., m)."""
        rates = np.zeros((*xdot.shape[:-1], self._count), dtype=xdot.dtype)
        rates[..., self.leads] = xdot
        for follower, ratios, _ in self._couplings:
            for leader, ratio in ratios.items():
                rates[..., follower] += ratio * rates[..., leader]
        return rates

    def shape(self, joints: Array) -> Array:
        """Select the shape (..., nx) from the coordinates of all joints."""
        return joints if self._all_lead_x else joints[..., self.leads_x]

    def shape_rate(self, rates: Array) -> Array:
        """Select the shape rate (..., m) from the rates of all joints."""
        return rates if self._all_lead else rates[..., self.leads]

    def joint_torques(self, torque: Array) -> Array:
        """Expand torques on the shape (m,) to all joints; followers get zero."""
        if self._all_lead:
            return torque
        torques = np.zeros(self._count, dtype=torque.dtype)
        torques[self.leads] = torque
        return torques

    def acceleration(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: Sequence[int] = (),
        prescribed: Array | Sequence[float] = (),
        axes: pin.Convention = pin.Convention.LOCAL,
    ) -> Array:
        """Compute the acceleration (nv,) of the coupled system.

        Args:
            q: Pinocchio's configuration, (nq,).
            v: Pinocchio's velocity, (nv,).
            tau: Generalised forces, (nv,) [N | N·m].
            driven: Indices, among the rates of all joints, with prescribed acceleration.
            prescribed: Accelerations of these joints [rad/s² | m/s²].
            axes: Frames in which ABA is evaluated. Comparing two choices measures its round-off.
        Returns:
            (nv,) acceleration.
        """
        if len(driven) and not self._is_constrained:
            return self._solve_free_rows(q, v, tau, tuple(driven), prescribed)
        if len(driven) or not (self._uses_aba or self._loops):
            return self._solve_with_multipliers(q, v, tau, tuple(driven), prescribed)
        model, data = self._model, self._data
        free: Array = pin.aba(model, data, q, v, tau, axes)
        if not self._is_constrained:
            return free
        J, bias = self.J, np.zeros(len(self.J))
        if self._loops is not None:
            J = np.vstack([J, self._loops.jacobian(q)[self._independent]])
            bias = np.append(bias, self._loops.bias(q, v)[self._independent])
        zero = np.zeros(len(v))
        responses = np.array([pin.aba(self._weightless, data, q, zero, row, axes) for row in J])
        if self._loops is None:
            return np.asarray(free - np.linalg.solve(J @ responses.T, J @ free) @ responses)
        # Light links in loops have responses that are 1e10 times those of others.  Without scales
        # and a second solution of the remaining equations, integrators take steps of round-off.
        A = J @ responses.T
        sizes = A.diagonal()
        scale = 1.0 / np.sqrt(np.maximum(sizes, RANK**3 * sizes.max()))
        inverse = np.linalg.pinv(scale[:, None] * A * scale, RANK**2, hermitian=True)
        # Without the second solution, the other axes show what one solution loses by round-off.
        for _ in range(2 if axes == pin.Convention.LOCAL else 1):
            free = free - (scale * (inverse @ (scale * (J @ free + bias)))) @ responses
        return np.asarray(free)

    def _solve_free_rows(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: tuple[int, ...],
        prescribed: Array | Sequence[float],
    ) -> Array:
        """Return the acceleration (nv,) of `acceleration` without couplings and loops."""
        equations = self._free_rows.get(driven)
        if equations is None:
            equations = self._free_rows[driven] = _FreeRows(
                len(v), [len(v) - self._count + int(k) for k in driven]
            )
        H, force, known = equations.inputs
        H[:] = pin.crba(self._model, self._data, q).ravel()
        np.subtract(tau, pin.nonLinearEffects(self._model, self._data, q, v), out=force)
        known[:] = prescribed
        equations.run()
        # Only the lower triangle is read; matrix and right side are overwritten.
        _, a, failure = dposv(equations.matrix, equations.right, 1, 1)
        if failure:  # Cholesky's method needs a matrix that is positive despite round-off
            return self._solve_with_multipliers(q, v, tau, driven, prescribed)
        return np.asarray(a)

    def _solve_with_multipliers(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: tuple[int, ...],
        prescribed: Array | Sequence[float],
    ) -> Array:
        """Return the acceleration (nv,) of `acceleration` from one linear system.

        The mass matrix need only be regular in the directions that the constraints allow.
        """
        if self._loops is not None:
            return self._solve_in_null_space(q, v, tau, driven, prescribed)
        n = len(v)
        matrix = self._border(driven).copy()
        matrix[:n, :n] = mass_matrix(self._model, self._data, q)
        right = np.zeros(len(matrix))
        right[:n] = tau - pin.nonLinearEffects(self._model, self._data, q, v)
        right[n + len(self.J) :] = prescribed
        return np.asarray(np.linalg.solve(matrix, right)[:n])

    def _solve_in_null_space(
        self,
        q: Array,
        v: Array,
        tau: Array,
        driven: tuple[int, ...],
        prescribed: Array | Sequence[float],
    ) -> Array:
        """Return the acceleration (nv,) of `acceleration` with loops.

        Rows may be redundant at shapes where loops determine prescribed joints.

        With all constraints C a = c and the null space N of C, a = C⁺c + N z and
        NᵀM N z = Nᵀ(τ − b − M C⁺c).
        """
        assert self._loops is not None
        n, at = len(v), len(self.J)
        border = self._border(driven)
        C = np.vstack([border[n:, :n], self._loops.jacobian(q)[self._independent]])
        c = np.zeros(len(C))
        c[at : at + len(driven)] = prescribed
        c[at + len(driven) :] = -self._loops.bias(q, v)[self._independent]
        U, sizes, Vt = np.linalg.svd(C)
        rank = int((sizes > RANK * sizes[0]).sum())
        a = Vt[:rank].T @ ((U.T @ c)[:rank] / sizes[:rank])
        N = Vt[rank:].T
        M = mass_matrix(self._model, self._data, q)
        force = tau - pin.nonLinearEffects(self._model, self._data, q, v) - M @ a
        return np.asarray(a + N @ np.linalg.solve(N.T @ M @ N, N.T @ force))

    def _border(self, driven: tuple[int, ...]) -> Array:
        """Return the matrix [[0, Cᵀ], [C, 0]] for the constraints C of couplings and driven joints.

        A run calls this at each evaluation of its vector field, so the matrix is kept.
        """
        if driven not in self._borders:
            n = self.J.shape[1]
            selection = np.eye(n)[[n - self._count + k for k in driven]]
            constraints = np.vstack([self.J, selection])
            matrix = np.zeros((n + len(constraints), n + len(constraints)))
            matrix[n:, :n], matrix[:n, n:] = constraints, constraints.T
            self._borders[driven] = matrix
        return self._borders[driven]

"""Random states for the validation of kernels, and reference values computed with Pinocchio.

Loads and closed loops by Pinocchio also serve the judge.  The generalised forces τ = Jᵀ (F, N) of
wrenches on links validate forces/force_model.py, with which they share no formula.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from ..forces.force_numbers import BaseInSpace, ForceInputs
from ..reduction.pointwise_reduction import mass_matrix_at
from ..reduction.potential import acting_gravity, falling, translations
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.free_bodies import Freed, free_numbers, other_placement
from ..reduction.tree.loop_constraints import GAUGE_RATE
from ..system.loops.kinematics import loop_jacobian, loop_jacobian_rate
from ..system.loops.loop_assembly import CLOSED, assemble
from ..system.system import System, in_gravity, moved_masses, radius_of_gyration, with_numbers

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel
    from ..lie.group import Group
    from .kernel import Kernel, Layout

# Displacement from a closed shape at which kernels of robots with loops are compared, relative to
# that of other robots, because equations of loops may be dependent far from closed shapes.
_NEAR_CLOSED = 0.1
_SMALL = 1e-3  # smallest size of a body parameter, relative to the largest of its body
_GRAVITY_FACTOR = 1.3  # factor on gravity in perturbed systems


@dataclass(frozen=True)
class Sizes:
    """Sizes of a robot's displacements, times and momenta, in which its states are of size one.

    Attributes:
        length: Largest distance of a joint or of a body's mass from the previous joint [m].
        mass: Mass of the robot [kg].
        time: Time in which the forces at rest change the velocity by one displacement [s].
        steps: Displacement along each velocity, (n,) [m | rad].
        momenta: Momentum of one displacement per `time` along each velocity, (n,), from the
            diagonal of the mass matrix.
        numbers: Force numbers that change a force or a prescribed motion by its size, (p,), for
            numbers that are zero; the magnitudes of other numbers.
    """

    length: float
    mass: float
    time: float
    steps: Array
    momenta: Array
    numbers: Array

    def of_state(self, layout: Layout, r: int) -> Array:
        """Return the size of each entry of the reduced state y, (size,)."""
        x, pi, base = self.steps[r:], self.momenta[r:], layout.base
        active, attitudes = list(layout.active), np.ones(4 * len(layout.balls))
        blocks = [x[active]]
        if layout.lifted_balls:
            # The momentum of a quaternion is four numbers of the size of 2π.
            covectors = [np.full(4, 2.0 * pi[v : v + 3].max()) for _, v in layout.balls]
            blocks += [attitudes, pi[active], *covectors, x[list(layout.cyclic)]]
        else:
            blocks += [pi[active], x[list(layout.cyclic)], pi[layout.ball_pi], attitudes]
        pushed = np.repeat([self.length, self.mass * self.length / self.time], base.push // 2)
        blocks += [np.ones(base.attitude + base.down), self.momenta[r - base.momentum : r], pushed]
        return np.concatenate([*blocks, [self.time] * layout.clock])

    def of_shape(self, system: System) -> Array:
        """Return the size of each shape coordinate, (nx,); quaternions have size one."""
        sizes = np.ones(system.nx)
        sizes[system.space.scalar_x] = self.steps[system.r :][system.space.scalar_v]
        return sizes

    def of_pose(self, group: Group) -> Array:
        """Return the size of each entry of a pose, (size,)."""
        return np.repeat([self.length, 1.0], [group.linear, group.size - group.linear])

    def of_parameters(self, layout: Layout, r: int, parameters: Array) -> Array:
        """Return the size of each parameter of a kernel, (p,).

        Body and force parameters are their own sizes.  Small parameters of a body have a
        thousandth of the size of its other parameters.

        Args:
            layout: Layout of the kernel.
            r: Dimension of the group.
            parameters: Parameters, (p,).
        """
        sizes = np.abs(parameters)
        spin, pi = layout.base.spin, layout.constant_pi
        sizes[:spin], sizes[spin : spin + len(pi)] = (
            self.momenta[r - spin : r],
            self.momenta[r:][pi],
        )
        gravity = slice(layout.gravity_at, layout.bodies_at)
        sizes[gravity] = np.linalg.norm(parameters[gravity])
        variable, bodies = layout.freed, sizes[layout.bodies_at :]
        for i in variable.inertias:
            mass, moments, inertia = np.split(bodies[variable.of_inertia(i)], [1, 4])
            largest = inertia.max()
            moments[:] = np.maximum(moments, _SMALL * np.sqrt(mass * largest))
            inertia[:] = np.maximum(inertia, _SMALL * largest)
        placements = [(bodies[variable.of_step(i)], 4) for i, _ in variable.steps]
        placements += [(bodies[variable.of_link(i)], 9) for i in variable.links]
        for numbers, turns in placements:
            numbers[:turns] = np.maximum(numbers[:turns], _SMALL)
            numbers[turns:] = np.maximum(numbers[turns:], _SMALL * self.length)
        path = self.of_path(layout.com_path // 3)
        sizes[layout.com_path_at : layout.com_path_at + len(path)] = path
        numbers = sizes[layout.parameters - layout.numbers :]
        numbers[numbers == 0.0] = self.numbers[numbers == 0.0]
        return sizes

    def of_path(self, k: int) -> Array:
        """Return the sizes of a path (c₀, v₀, g) of the centre of mass, (3k,)."""
        return np.repeat(self.length / self.time ** np.arange(3.0), k)


@dataclass(frozen=True)
class ReferenceState:
    """A random state with the corresponding arguments of the kernel and reference values.

    Attributes:
        system: System of the kernel.
        model: Pinocchio model of the system; its gravity includes only the part that acts on
            shape and base, not the free fall of the whole system.
        data: Pinocchio's work space of the system; other functions overwrite it.
        gravity: Gravity of `model` in the root joint's fixed frame, (3,) [m/s²].
        gravity_strength: Norm of the system's full gravity [m/s²].
        time: Time [s].
        pose: Pose of the base, (size,).
        q: Pinocchio's configuration, (nq,).
        x: Shape, (nx,) [rad | m | 1].
        v: Body twist relative to the centre of mass, then shape rate, (n,).  They are chosen so
            that momenta which the kernel assumes to be zero are zero.
        accelerations: Accelerations of the prescribed joints, (k,).
        force_parameters: Parameters of the forces, (p,).
        down: Direction of gravity in the body frame, (3,), or empty.
        push: Displacement and momentum of the centre of mass caused by a wrench, (2k,), or
            empty.
        com_path: Centre-of-mass path (c0, v0, g), (3k,) [m, m/s, m/s²].
        H: Mass matrix, (n, n).
        com: Centre of mass in the body frame, (3,) [m].
        mu: Body momentum, (r,).
        pi: Canonical momenta, (m,).
        nu: Random multipliers ν of the loops, (k,); the impetus in y is π + Jᵀν.
        y: Reduced state, (size,).
        parameters: Parameters of the kernel, (p,).
        prescribed: Indices of the prescribed joints.
        sizes: Sizes of the robot's displacements, times and momenta.
    """

    system: System
    model: pin.Model
    data: pin.Data
    gravity: Array
    gravity_strength: float
    time: float
    pose: Array
    q: Array
    x: Array
    v: Array
    accelerations: Array
    force_parameters: Array
    down: Array
    push: Array
    com_path: Array
    H: Array
    com: Array
    mu: Array
    pi: Array
    nu: Array
    y: Array
    parameters: Array
    prescribed: tuple[int, ...]
    sizes: Sizes

    @cached_property
    def free(self) -> Array:
        """Indices of the velocities determined by momenta, (f,)."""
        r = len(self.mu)
        # np.setdiff1d would load numpy.ma.
        return np.delete(np.arange(len(self.v)), [r + k for k in self.prescribed])

    def in_space(self, v: Array) -> BaseInSpace:
        """Return the base state in the fixed frame for a velocity (n,) about the centre of mass."""
        return _base_in_space(
            self.system, self.pose, self.com_path, self.push, self.time, self.com, self.H, v
        )

    @cached_property
    def is_linear(self) -> NDArray[np.bool_]:
        """Whether each velocity, momentum or force is a linear one, (n,)."""
        base = np.arange(self.system.r) < self.system.group.linear
        return np.append(base, np.array([unit == "m" for unit in self.system.units], dtype=bool))

    @cached_property
    def is_linear_x(self) -> NDArray[np.bool_]:
        """Whether each shape coordinate is a length, (nx,)."""
        is_length, space = np.zeros(self.system.nx, dtype=bool), self.system.space
        is_length[space.scalar_x] = self.is_linear[self.system.r :][space.scalar_v]
        return is_length

    @property
    def is_linear_v(self) -> NDArray[np.bool_]:
        """Whether each of Pinocchio's velocities is a linear one, (nv,)."""
        return ~self._moved_masses[0]

    @cached_property
    def is_linear_q(self) -> NDArray[np.bool_]:
        """Whether each entry of Pinocchio's configuration is a length, (nq,)."""
        is_length = np.zeros(len(self.q), dtype=bool)
        for joint in self.model.joints[1:]:
            linear = int(self.is_linear_v[joint.idx_v : joint.idx_v + joint.nv].sum())
            is_length[joint.idx_q : joint.idx_q + linear] = True
        return is_length

    @cached_property
    def pose_jacobian(self) -> Array:
        """Return the map from body twists to rates of the pose, (size, r)."""
        twists = np.eye(len(self.mu))
        poses = np.broadcast_to(self.pose, (len(twists), len(self.pose)))
        return self.system.group.rate(poses, twists).T

    @cached_property
    def momentum_terms(self) -> Array:
        """Return |H| |v|, (n,), the magnitude of the terms that sum to the momenta H v.

        The round-off of the momenta is proportional to it.  Base momenta are rotated between
        frames, which mixes their components, so each component is assigned the largest of their
        magnitudes.  Masses around the root may cancel in H, but their round-off remains.
        """
        terms = np.abs(self.H) @ np.abs(self.v)
        linear = len(self.com_path) // 3
        turn = float(np.abs(self.v[linear : len(self.mu)]).sum())
        terms[:linear] += self.system.mass * self.reach * turn
        for block in (slice(0, linear), slice(linear, len(self.mu))):
            terms[block] = terms[block].max(initial=0.0)
        return np.asarray(terms)

    @cached_property
    def velocity_terms(self) -> Array:
        """Return the magnitude, (n,), of terms that sum to the solution v of H v = (μ, π)."""
        J, rates = np.abs(self.loop_rows), np.abs(self.v)
        prescribed = [len(self.mu) + k for k in self.prescribed]
        terms = self.momentum_terms + J.T @ np.abs(self.nu)
        return self.solved_terms(terms, J[:, prescribed] @ rates[prescribed]) + rates

    @cached_property
    def loop_rows(self) -> Array:
        """Return the Jacobian of the independent equations of closed loops, (k, n)."""
        closure = self.system.closure
        J = np.zeros((0 if closure is None else closure.rank, len(self.v)))
        if closure is not None:
            J[:, len(self.mu) :] = loop_jacobian(self.system, self.x)[closure.rows]
        return J

    def solved_terms(self, terms: Array, drift: Array | float = 0.0) -> Array:
        """Compute the magnitude of the terms that sum to the solution a of H a = b + Jᵀλ.

        The multipliers λ of closed loops keep J a + d = 0.  Near shapes at which the loops are
        singular, they are much larger than b.

        Args:
            terms: Magnitude of the terms that sum to b, (n,).
            drift: Magnitude of the terms that sum to d, (k,).
        Returns:
            (n,): the magnitude, zero for prescribed joints.
        """
        free, solution = self.free, np.zeros(len(self.v))
        inverse, J = np.linalg.inv(self.H[np.ix_(free, free)]), self.loop_rows[:, free]
        opened = np.abs(inverse) @ terms[free]
        response = inverse @ J.T
        multipliers = np.abs(np.linalg.inv(J @ response)) @ (np.abs(J) @ opened + drift)
        solution[free] = opened + np.abs(response) @ multipliers
        return solution

    @cached_property
    def force_terms(self) -> Array:
        """Return the magnitude, (n,), of inertial forces, as if those of bodies did not cancel.

        Inertial forces are sums of products of angular rates with momenta, and of products of
        masses with two speeds.
        """
        angular, mass = self._moved_masses
        v = np.abs(self.system.joint_rates(self.v))
        rate = float(v[angular].sum())
        speed = float(v[~angular].sum()) + self.reach * rate
        inertial = self.system.sizes_on_shape(mass * speed * np.where(angular, speed, rate))
        return np.asarray(rate * self.momentum_terms + inertial)

    @cached_property
    def gravity_terms(self) -> Array:
        """Return the magnitude, (n,), of gravity forces, as if their components did not cancel."""
        angular, mass = self._moved_masses
        force = mass * self.gravity_strength * np.where(angular, self.reach, 1.0)
        return np.asarray(self.system.sizes_on_shape(force))

    @cached_property
    def _moved_masses(self) -> tuple[NDArray[np.bool_], Array]:
        """Return whether each velocity is angular, (nv,), and its moved mass, (nv,) [kg]."""
        return moved_masses(self.model, self.data, self.q)

    @cached_property
    def reach(self) -> float:
        """Return the largest distance of a joint from the root joint, plus its body's size [m]."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, self.q)
        root = data.oMi[1].translation
        bodies = range(1, model.njoints)
        return max(
            float(np.linalg.norm(data.oMi[i].translation - root)) + _size(model.inertias[i])
            for i in bodies
        )


def _size(body: pin.Inertia) -> float:
    """Return the distance of a body's mass from its joint, plus its radius of gyration [m]."""
    return float(np.linalg.norm(body.lever)) + radius_of_gyration(body)


def length_of(system: System) -> float:
    """Return the largest distance of a joint or a body's mass from the previous joint [m].

    A system without any length has length one.
    """
    model = system.model
    steps = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements[2:]]
    return max([*steps, *(_size(body) for body in model.inertias[1:])]) or 1.0


def steps_of(system: System, length: float) -> Array:
    """Return the displacement along each velocity that counts as one, (n,) [m | rad]."""
    turns = system.r - system.group.linear
    shape = [length if unit == "m" else 1.0 for unit in system.units]
    return np.array([length] * system.group.linear + [1.0] * turns + shape)


def _rate_of(
    system: System, forces: ForceModel | None, inputs: ForceInputs, H: Array, steps: Array
) -> float:
    """Return the rate at which forces displace the robot from rest by its size [1/s].

    Without forces at rest, it is the rate at which forces slow the robot down.  It is zero without
    any force.  Kinetic forces at this rate are of the size of the other forces.
    """
    if forces is None:
        return 0.0
    r = system.r

    def work(rate: float) -> float:
        v = rate * steps
        moving = replace(inputs, xdot=v[r:], xi=v[:r], mu=H[:r] @ v)
        acting = forces.acting(moving)
        return float(
            np.abs(np.append(acting.wrench, acting.torque)) @ steps / (np.diag(H) @ steps**2)
        )

    with np.errstate(all="ignore"):
        rate = np.sqrt(work(0.0)) or work(1.0)
    return rate if np.isfinite(rate) else 0.0


def _sizes_of_numbers(
    system: System,
    forces: ForceModel,
    at: ForceInputs,
    sizes: Sizes,
    H: Array,
    is_zero: NDArray[np.bool_],
) -> Array:
    """Return the size of each force number, (p,); see Sizes.

    Numbers that are zero and have no effect have size one.  Groups of numbers are tested together,
    because most numbers of a table have no effect at one time.

    Args:
        system: The system.
        forces: The forces.
        at: Their inputs at rest.
        sizes: Sizes of displacements, times and momenta.
        H: Mass matrix, (n, n).
        is_zero: Whether each number is zero, (p,).
    Returns:
        The sizes.
    """
    numbers = np.abs(forces.numbers)
    if not is_zero.any():
        return numbers
    r, period, force = len(at.xi), sizes.time, sizes.momenta / sizes.time
    v, steps = sizes.steps / period, sizes.steps[r:][list(forces.joints)]
    mu, units = H[:r] @ v, [force[r:], force[:r]]
    if forces.joints:
        space = system.space
        coordinates = space.coordinates_of_joints(list(forces.joints))
        first = [r + space.rates_of(k)[0] for k in coordinates]  # a ball has four coordinates
        units += [sizes.steps[first], steps / period, steps / period**2]
    base = None if at.base is None else BaseInSpace(at.base.pose, v[:r], mu, mu)

    def effects(given: Array) -> Array:
        acting = forces.acting(ForceInputs(at.t, at.x, v[r:], v[:r], mu, given, base))
        values = [acting.torque, acting.wrench]
        if forces.joints:
            motion = forces.prescribed(at.t, given)
            values += [motion.x, motion.xdot, motion.xddot]
        return np.concatenate(values) / np.concatenate(units)

    trial = 1.0 + np.arange(len(numbers)) * np.sqrt(2.0) % 1.0  # effects of these do not cancel
    with np.errstate(all="ignore"):
        start, groups = effects(at.numbers), [np.flatnonzero(is_zero)]
        while groups:
            group = groups.pop()
            given = at.numbers.copy()
            given[group] = trial[group]
            change = float(np.abs(effects(given) - start).max(initial=0.0))
            has_effect = np.isfinite(change) and change > 0.0
            numbers[group] = trial[group] / change if has_effect else 1.0
            if len(group) > 1 and change != 0.0:
                groups += np.array_split(group, 2)
    return numbers


def random_state(
    kernel: Kernel, rng: np.random.Generator, reach: float, *, is_closed: bool = True
) -> ReferenceState | None:
    """Draw a random state, of size one in the robot's own units (see Sizes).

    Args:
        kernel: The kernel.
        rng: Random number generator.
        reach: Factor on shape and velocity.
        is_closed: Whether the loops are closed; otherwise the shape is only near a closed one.
    Returns:
        The state, or None if the forces are not finite there.
    """
    system, layout, forces = kernel.system, kernel.layout, kernel.forces
    r, m, k = system.r, system.m, system.group.linear
    group, counts = system.group, layout.base
    model, gravity = system.sorted_model.copy(), np.zeros(3)
    if layout.gravity:
        gravity = acting_gravity(system)
    model.gravity.linear = model.jointPlacements[1].rotation @ gravity
    length = length_of(system)
    steps = steps_of(system, length)
    pose = group.exp(steps[:r] * rng.uniform(-1.0, 1.0, r))
    pose = pose if r > k else group.identity()
    displacement, v = steps[r:] * rng.uniform(-2.0, 2.0, m), steps * rng.normal(size=system.n)
    span = _span(forces)
    time = float(rng.uniform(*span))
    prescribed = list(layout.prescribed)
    force_parameters, accelerations = np.empty(0), np.zeros(len(prescribed))
    start = system.space.neutral
    if system.closure is not None:
        start, displacement = system.closure.x, _NEAR_CLOSED * displacement
    x = system.space.integrate(start, displacement * reach)
    if system.closure is not None and is_closed:
        movable = np.ones(m, dtype=bool)
        movable[prescribed] = False
        closed, gaps = assemble(system, x, system.closure.length, movable)
        x = closed if gaps.max() <= CLOSED else x
    if forces is not None:
        force_parameters = forces.random_numbers(rng, time)
        force_parameters[forces.within][:1] = time
        # The sizes of numbers that are zero follow from the other forces.
        is_zero = forces.numbers == 0.0
        is_zero[forces.within] = False
        zeros, force_parameters[is_zero] = force_parameters[is_zero], 0.0
    if forces is not None and prescribed:
        motion = forces.prescribed(time, force_parameters)
        x[list(layout.prescribed_x)], accelerations = motion.x, motion.xddot
        if not np.isfinite([*motion.x, *motion.xdot, *motion.xddot]).all():
            return None
    q, data = system.sorted_q(pose, x), system.sorted_data
    H = mass_matrix_at(system, model, data, pose, x)
    still = BaseInSpace(pose, np.zeros(r), np.zeros(r), np.zeros(r))
    inputs = ForceInputs(time, x, np.zeros(m), np.zeros(r), np.zeros(r), force_parameters, still)
    fall = falling(system)
    rate = np.hypot(
        _rate_of(system, forces, inputs, H, steps), np.sqrt(np.linalg.norm(gravity) / length)
    ) or np.sqrt(np.linalg.norm(fall) / length)
    if prescribed:
        rate = max(rate, float((np.abs(motion.xdot) / steps[r:][prescribed]).max()))
    if layout.clock:  # forces that vary with time may vanish at the time that was drawn
        rate = max(rate, 1.0 / max(span[1] - span[0], np.finfo(float).tiny))
    period = 1.0 / rate if rate > 0.0 else 1.0
    sizes = Sizes(length, system.mass, period, steps, np.diag(H) * steps / period, np.empty(0))
    if forces is not None:
        sizes = replace(sizes, numbers=_sizes_of_numbers(system, forces, inputs, sizes, H, is_zero))
        force_parameters[is_zero] = zeros * sizes.numbers[is_zero]
    if forces is not None and prescribed and is_zero.any():
        motion = forces.prescribed(time, force_parameters)
        x[list(layout.prescribed_x)], accelerations = motion.x, motion.xddot
        if not np.isfinite([*motion.x, *motion.xdot, *motion.xddot]).all():
            return None
        q = system.sorted_q(pose, x)
        H = mass_matrix_at(system, model, data, pose, x)
    com = np.array(data.Ycrb[1].lever)
    v *= reach / period
    if prescribed:
        v[[r + j for j in prescribed]] = motion.xdot
    # Conditions on time were evaluated at the time that was drawn.
    if not layout.clock and (forces is None or forces.within.start == forces.within.stop):
        time *= period
    v, mu = _with_known_momentum(kernel, H, v)
    v, impetus, nu = with_closed_loops(system, x, H, v, rng, prescribed)
    pi = H[r:] @ v
    R = group.Ad(pose)[k:, k:]
    down = R.T @ gravity / np.linalg.norm(gravity) if counts.down else np.zeros(0)
    spin = R @ mu[k:] if counts.spin else np.zeros(0)
    push = rng.normal(size=counts.push)
    push *= np.repeat([length, system.mass * length / period], counts.push // 2)
    b = np.concatenate([pose[len(pose) - counts.attitude :], down, mu[r - counts.momentum :], push])
    com_path = np.append(sizes.of_path(k)[: 2 * k] * rng.normal(size=2 * k), fall)
    if forces is not None:
        base = _base_in_space(system, pose, com_path, push, time, com, H, v)
        acting = forces.acting(ForceInputs(time, x, v[r:], v[:r], mu, force_parameters, base))
        potential = np.array([forces.potential(x, force_parameters)])
        if not np.isfinite(np.concatenate([acting.torque, acting.wrench, potential])).all():
            return None
    body_parameters = free_numbers(system, layout.freed)
    parameters = [spin, pi[layout.constant_pi], gravity[list(layout.gravity)], body_parameters]
    parameters += [com_path[: layout.com_path], force_parameters]
    return ReferenceState(
        system=system,
        model=model,
        data=data,
        gravity=gravity,
        gravity_strength=float(np.linalg.norm(system.gravity)),
        time=time,
        pose=pose,
        q=q,
        x=x,
        v=v,
        accelerations=accelerations,
        force_parameters=force_parameters,
        down=down,
        push=push,
        com_path=com_path,
        H=H,
        com=com,
        mu=mu,
        pi=pi,
        nu=nu,
        y=np.concatenate([*layout.shape_entries(x, impetus), b, [time] * layout.clock]),
        parameters=np.concatenate(parameters),
        prescribed=tuple(prescribed),
        sizes=sizes,
    )


def perturb_parameters(system: System, freed: Freed, cyclic: tuple[int, ...] = ()) -> System:
    """Return a system with random, physical values of its variable parameters and stronger gravity.

    Inertias of the bodies that a cyclic joint moves are only scaled, so that the joint stays
    cyclic.

    Args:
        system: The system.
        freed: Variable body parameters.
        cyclic: Indices of the cyclic joints.
    Returns:
        The perturbed system.
    """
    rng, inertias, model = np.random.default_rng(1), {}, system.sorted_model
    bodies, placements, length = bodies_of(system), {}, length_of(system)
    for i, pattern in freed.steps:
        parent = bodies[bodies[i].parent]
        placements[i + 1] = other_placement(parent, bodies[i], pattern, length, rng)
    carried = {system.sorted_joints[k] for k in cyclic}
    for i in range(2, model.njoints):
        if model.parents[i] in carried:
            carried.add(i)
    for i in freed.inertias:
        nominal = model.inertias[i + 1]
        if i + 1 in carried:
            factor = rng.uniform(1.2, 1.5)
            inertias[i + 1] = pin.Inertia(
                factor * nominal.mass, nominal.lever, factor * nominal.inertia
            )
            continue
        reach = radius_of_gyration(nominal) + 1e-3 * float(np.linalg.norm(nominal.lever))
        A = reach * rng.normal(size=(3, 3))
        spread = nominal.mass * A @ A.T
        moments = nominal.inertia + np.trace(spread) * np.eye(3) - spread
        lever = nominal.lever + reach * rng.normal(size=3)
        inertias[i + 1] = pin.Inertia(nominal.mass * rng.uniform(0.5, 1.5), lever, moments)
    frames = {k: _perturb_placement(model.frames[k].placement, length, rng) for k in freed.links}
    other = with_numbers(system, inertias, placements, frames)
    return in_gravity(other, _GRAVITY_FACTOR * system.gravity)


def _perturb_placement(placement: pin.SE3, length: float, rng: np.random.Generator) -> pin.SE3:
    """Return a random placement near a link's placement on its body.  length: of the robot [m]."""
    size = 0.1 * length + float(np.linalg.norm(placement.translation))
    return placement * pin.SE3(pin.exp3(rng.uniform(0.1, 0.4, 3)), size * rng.uniform(0.1, 0.5, 3))


def _base_in_space(
    system: System,
    pose: Array,
    com_path: Array,
    push: Array,
    time: float,
    com: Array,
    H: Array,
    v: Array,
) -> BaseInSpace:
    """Compute the base state in the fixed frame from Pinocchio's mass matrix.

    Args:
        system: The system.
        pose: Pose, (size,).  Its position is ignored, because the position follows from the
            centre of mass.
        com_path: Centre-of-mass path, (3k,).
        push: Displacement and momentum of the centre of mass caused by a wrench, (2k,), or empty.
        time: Time [s].
        com: Centre of mass in the body frame, (3,).
        H: Mass matrix, (n, n).
        v: Velocity relative to the centre of mass, (n,).
    Returns:
        Pose, body twist, body momentum and spatial momentum.
    """
    group, k = system.group, system.group.linear
    c0, v0, fall = com_path.reshape(3, k)
    c, velocity = c0 + v0 * time + 0.5 * fall * time**2, v0 + fall * time
    if push.size:
        c, velocity = c + push[:k], velocity + push[k:] / system.mass
    attitude, v = pose[k:], v.copy()
    v[:k] += group.turned_back(attitude, velocity)
    position = c - group.turned(attitude, translations(system).T @ com)
    full_pose, mu = np.append(position, attitude), H[: system.r] @ v
    return BaseInSpace(full_pose, v[: system.r], mu, group.spatial_momentum(full_pose, mu))


def _with_known_momentum(kernel: Kernel, H: Array, v: Array) -> tuple[Array, Array]:
    """Remove momenta that the kernel assumes to be zero from v; return v and its body momentum."""
    system, counts = kernel.system, kernel.layout.base
    r, k, v = system.r, system.group.linear, v.copy()
    if not (counts.spin or counts.momentum):
        v[:r] = -np.linalg.solve(H[:r, :r], H[:r, r:] @ v[r:])
        return v, np.zeros(r)
    v[:k] = -np.linalg.solve(H[:k, :k], H[:k, k:] @ v[k:])
    mu = H[:r] @ v
    mu[:k] = 0.0
    return v, mu


def _span(forces: ForceModel | None) -> tuple[float, float]:
    """Return a time interval in which all time functions of the forces are defined."""
    signals = () if forces is None else (*forces.signals, *forces.references)
    first = max([0.0, *(signal.span[0] for signal in signals)])
    return first, min([1.0, *(signal.span[1] for signal in signals)])


class LoadsByPinocchio:
    """The generalised forces of wrenches on the links of one system."""

    def __init__(
        self, system: System, axes: Array, places: Sequence[tuple[str | None, str]]
    ) -> None:
        """Find the frames of the links.

        Args:
            system: The system.
            axes: Motion axes of the root joint in its fixed frame, (6, r).
            places: For each wrench, the name of the link (None for the base) and the frame of its
                components ("world" or "body").
        """
        self._model, self._data = system.sorted_model, system.sorted_model.createData()
        self._axes, self._places = axes, tuple(places)
        self._to_world = system.model.jointPlacements[1].rotation
        self._frames = [None if link is None else self._frame(link) for link, _ in places]

    def _frame(self, link: str) -> int:
        """Return the index of the body with this name, or else of the frame with this name."""
        model = self._model
        if model.existBodyName(link):
            return int(model.getBodyId(link))
        return int(model.getFrameId(link))

    def generalised(self, q: Array, loads: Array) -> Array:
        """Compute the generalised forces of wrenches.

        Args:
            q: Pinocchio's configuration, (nq,).
            loads: Force, moment and point of each wrench, (9, L) [N, N·m, m].
        Returns:
            (nv,): the generalised forces.
        """
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        tau = np.zeros(model.nv)
        reference = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for (_, axes), frame, load in zip(self._places, self._frames, loads.T, strict=True):
            force, moment, point = load[:3], load[3:6], load[6:]
            if frame is None:  # along the group's axes in the root joint's fixed frame
                force, moment = np.split(self._axes @ load[: self._axes.shape[1]], 2)
                to_world, arm = self._to_world, np.zeros(3)
                jacobian = pin.getJointJacobian(model, data, 1, reference)
            else:
                orientation = data.oMf[frame].rotation
                to_world = self._to_world if axes == "world" else orientation
                arm = orientation @ point
                jacobian = pin.getFrameJacobian(model, data, frame, reference)
            F = to_world @ force
            tau += jacobian.T @ np.concatenate([F, to_world @ moment + pin.skew(arm) @ F])
        return tau


def with_closed_loops(
    system: System,
    x: Array,
    H: Array,
    v: Array,
    rng: np.random.Generator,
    prescribed: Sequence[int] = (),
) -> tuple[Array, Array, Array]:
    """Project v on velocities that keep loops closed, with the same body momentum.

    Rates of prescribed joints do not change.

    Returns:
        The velocity (n,), the impetus (m,) for random multipliers, and the multipliers (k,).
    """
    r = system.r
    if system.closure is None:
        return v, H[r:] @ v, np.empty(0)
    J = np.zeros((system.closure.rank, len(v)))
    J[:, r:] = loop_jacobian(system, x)[system.closure.rows]
    free = np.setdiff1d(np.arange(len(v)), r + np.array(prescribed, dtype=int))
    response = np.linalg.solve(H[np.ix_(free, free)], J[:, free].T)
    # Multipliers of this size have impulses of the size of the momenta, in every unit.
    mobility = J[:, free] @ response
    nu: Array = np.asarray(np.linalg.solve(mobility, J @ v))
    v = v.copy()
    v[free] -= response @ nu
    v[free] -= response @ np.linalg.solve(mobility, J @ v)  # Round-off moves light links.
    nu = nu * rng.uniform(0.5, 2.0, len(nu))
    return v, (H @ v + J.T @ nu)[r:], nu


def impetus_terms(system: System, x: Array, xdot: Array, nu: Array) -> Array:
    """Return ṗ less the rates of the canonical momenta and less Jᵀν̇, (m,); see LoopTerms."""
    if system.closure is None:
        return np.zeros(system.m)
    rows = system.closure.rows
    rate = loop_jacobian_rate(system, x, xdot)[rows]
    return np.asarray((rate - GAUGE_RATE * loop_jacobian(system, x)[rows]).T @ nu)


def closed_solver(
    system: System, x: Array, xdot: Array, inertia: Array, prescribed: Sequence[int], a: Array
) -> Callable[[Array], Array]:
    """Return the map from generalised forces to accelerations that keep loops closed.

    Args:
        system: The system.
        x: Shape, (nx,).
        xdot: Shape rate, (m,).
        inertia: Mass matrix without the rows and columns of prescribed joints.
        prescribed: Indices of the prescribed joints.
        a: Accelerations of the prescribed joints.
    """
    if system.closure is None:
        return lambda force: np.asarray(np.linalg.solve(inertia, force))
    r, rows = system.r, system.closure.rows
    on_shape = loop_jacobian(system, x)[rows]
    bias = loop_jacobian_rate(system, x, xdot)[rows] @ xdot + on_shape[:, list(prescribed)] @ a
    J = np.zeros((len(rows), len(inertia)))
    J[:, r:] = np.delete(on_shape, list(prescribed), axis=1)
    response = np.linalg.solve(inertia, J.T)

    def solve(force: Array) -> Array:
        free = np.linalg.solve(inertia, force)
        return np.asarray(free - response @ np.linalg.solve(J @ response, J @ free + bias))

    return solve

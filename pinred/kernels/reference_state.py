"""A random state at which a kernel is judged, with Pinocchio's numbers for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from ..forces.acting import BaseInSpace
from ..reduction.inertia_split import mass_matrix_at
from ..reduction.potential import acting_gravity, falling, translations
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.free_bodies import Freed, free_numbers, other_placement
from ..system.in_gravity import in_gravity
from ..system.inertias import moved_masses, radius_of_gyration
from ..system.other_inertias import with_numbers

if TYPE_CHECKING:
    from ..forces.force_model import ForceModel
    from ..system.system import System
    from .kernel import Kernel

_HEAVIER = 1.3  # is the gravity in which kernels are judged again


@dataclass(frozen=True)
class ReferenceState:
    """A state, the kernel's arguments there, and Pinocchio's numbers.

    system: the kernel's.  model: in the gravity that the kernel knows, which is without what
    makes the system fall.  data: Pinocchio's work space for it, which others use, too.
    gravity: (3,) the same in the root joint's fixed frame [m/s²].  weight: the strength of all
    of it, of which that is a part, [m/s²].  pose: (size,).
    q: (nq,).  x: (m,).  v: (n,) body twist and shape rate, whose momentum is of a kind that
    the kernel has terms for.  accelerations: of the prescribed joints.  numbers: (p,) in the
    forces.  down: (3,) direction of gravity in the body's frame, or none.  pushed: the
    displacement and momentum that a wrench has given the centre of mass, or none.  line: (3k,)
    start, velocity and fall of the centre of mass.  H: (n, n) mass matrix.  com: (3,)
    centre of mass in the body's frame.  mu: (r,) body momentum.  pi: (m,) canonical momenta.
    y, parameters: the kernel's arguments.  driven: the prescribed joints.
    """

    system: System
    model: pin.Model
    data: pin.Data
    gravity: Array
    weight: float
    time: float
    pose: Array
    q: Array
    x: Array
    v: Array
    accelerations: Array
    numbers: Array
    down: Array
    pushed: Array
    line: Array
    H: Array
    com: Array
    mu: Array
    pi: Array
    y: Array
    parameters: Array
    driven: tuple[int, ...]

    @property
    def free(self) -> Array:
        """Indices of the velocities that momenta decide, (f,)."""
        r = len(self.mu)
        return np.setdiff1d(np.arange(len(self.v)), [r + k for k in self.driven])

    def in_space(self, v: Array) -> BaseInSpace:
        """Return the base as seen from space, with a velocity (n,) relative to the CoM."""
        return _in_space(
            self.system, self.pose, self.line, self.pushed, self.time, self.com, self.H, v
        )

    @cached_property
    def momentum_terms(self) -> Array:
        """Magnitude of what the momenta are sums of, |H| |v|, (n,).

        The base's are turned into its frame from another, which mixes their components.
        """
        terms = np.abs(self.H) @ np.abs(self.v)
        linear = len(self.line) // 3
        for part in (slice(0, linear), slice(linear, len(self.mu))):
            terms[part] = terms[part].max(initial=0.0)
        return np.asarray(terms)

    @cached_property
    def velocity_terms(self) -> Array:
        """Magnitude of what round-off in the momenta's terms changes velocities by, (n,)."""
        return self.solved_terms(self.momentum_terms) + np.abs(self.v)

    def solved_terms(self, terms: Array) -> Array:
        """Return the magnitude, (n,), of what solutions a of H a = b are sums of.

        terms: (n,) magnitude of what b is a sum of.
        """
        free, out = self.free, np.zeros(len(self.v))
        out[free] = np.abs(np.linalg.inv(self.H[np.ix_(free, free)])) @ terms[free]
        return out

    @cached_property
    def force_terms(self) -> Array:
        """Magnitude of the inertial forces, (n,), before those of several bodies cancel.

        They are sums of products of angular rates with momenta, and of speeds among each other
        times masses.
        """
        angular, mass = self._moved
        v = np.abs(self.system.joint_rates(self.v))
        turning = float(v[angular].sum())
        speed = float(v[~angular].sum()) + self.reach * turning
        moving = self.system.sizes_on_shape(mass * speed * np.where(angular, speed, turning))
        return np.asarray(turning * self.momentum_terms + moving)

    @cached_property
    def weight_terms(self) -> Array:
        """Magnitude of the forces of gravity, (n,), before the parts across an axis cancel."""
        angular, mass = self._moved
        weight = mass * self.weight * np.where(angular, self.reach, 1.0)
        return np.asarray(self.system.sizes_on_shape(weight))

    @cached_property
    def _moved(self) -> tuple[NDArray[np.bool_], Array]:
        """Which of the model's velocities turn, (nv,), and the mass that each moves, (nv,) [kg]."""
        return moved_masses(self.model, self.data, self.q)

    @cached_property
    def reach(self) -> float:
        """Largest distance of a joint from the root's, with the size of its body, [m]."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, self.q)
        root = data.oMi[1].translation
        bodies = range(1, model.njoints)
        return max(
            float(np.linalg.norm(data.oMi[i].translation - root)) + _size(model.inertias[i])
            for i in bodies
        )


def _size(body: pin.Inertia) -> float:
    """Return the distance of a body's mass from its joint, and its radius of gyration, [m]."""
    return float(np.linalg.norm(body.lever)) + radius_of_gyration(body)


def random_state(kernel: Kernel, rng: np.random.Generator, reach: float) -> ReferenceState | None:
    """Return a random state of a size; None where the forces are not defined."""
    system, layout, forces = kernel.system, kernel.layout, kernel.forces
    r, m, k = system.r, system.m, system.group.linear
    group, parts = system.group, layout.base
    model, gravity = system.model.copy(), np.zeros(3)
    if layout.gravity:
        gravity = acting_gravity(system)
    model.gravity.linear = model.jointPlacements[1].rotation @ gravity
    pose = group.exp(rng.uniform(-1.0, 1.0, r))
    pose = pose if r > k else group.identity()
    x, v = rng.uniform(-2.0, 2.0, m), rng.normal(size=system.n)
    time = float(rng.uniform(*_span(forces)))
    driven = list(layout.prescribed)
    numbers, accelerations = np.empty(0), np.zeros(len(driven))
    x, v = x * reach, v * reach
    if forces is not None:
        numbers = forces.random_numbers(rng)
        numbers[forces.within] = time  # far beyond its piece a table means nothing
    if forces is not None and driven:
        given = forces.prescribed(time, numbers)
        x[driven], v[[r + j for j in driven]], accelerations = given.x, given.xdot, given.xddot
        if not np.isfinite([given.x, given.xdot, given.xddot]).all():
            return None
    q, data = system.model_q(pose, x), system.data
    H = mass_matrix_at(system, model, data, pose, x)
    v, mu = _with_known_momentum(kernel, H, v)
    pi = H[r:] @ v
    # A base with heavy arms in a fixed direction of gravity, or with its direction alone.
    turn = group.Ad(pose)[k:, k:]
    down = turn.T @ gravity / np.linalg.norm(gravity) if parts.down else np.zeros(0)
    spin = turn @ mu[k:] if parts.spin else np.zeros(0)
    pushed = rng.normal(size=parts.push)
    b = np.concatenate([pose[len(pose) - parts.attitude :], down, mu[r - parts.momentum :], pushed])
    active, cyclic = list(layout.active), list(layout.cyclic)
    line = np.append(rng.normal(size=2 * k), falling(system))
    com = np.array(data.Ycrb[1].lever)
    if forces is not None:
        base = _in_space(system, pose, line, pushed, time, com, H, v)
        acting = forces.acting(time, x, v[r:], v[:r], mu, numbers, base)
        potential = np.array([forces.potential(x, numbers)])
        if not np.isfinite(np.concatenate([acting.torque, acting.wrench, potential])).all():
            return None
    acts, bodies = gravity[list(layout.gravity)], free_numbers(system, layout.freed)
    return ReferenceState(
        system=system,
        model=model,
        data=data,
        gravity=gravity,
        weight=float(np.linalg.norm(system.gravity)),
        time=time,
        pose=pose,
        q=q,
        x=x,
        v=v,
        accelerations=accelerations,
        numbers=numbers,
        down=down,
        pushed=pushed,
        line=line,
        H=H,
        com=com,
        mu=mu,
        pi=pi,
        y=np.concatenate([x[active], pi[active], x[cyclic], b, [time] * layout.clock]),
        parameters=np.concatenate([spin, pi[cyclic], acts, bodies, line[: layout.line], numbers]),
        driven=tuple(driven),
    )


def perturb_parameters(system: System, freed: Freed, cyclic: tuple[int, ...] = ()) -> System:
    """Return the system with other numbers, inertias physical, of what is freed, in more gravity.

    Inertias that a cyclic joint carries are made heavier and no more: it has to stay cyclic.
    """
    rng, changed, model = np.random.default_rng(1), {}, system.model
    bodies, placed = bodies_of(system), {}
    for i, pattern in freed.steps:
        placed[i + 1] = other_placement(bodies[bodies[i].parent], bodies[i], pattern, rng)
    carried = {system.joints[k] for k in cyclic}
    for i in range(2, model.njoints):
        if model.parents[i] in carried:
            carried.add(i)
    for i in freed.inertias:
        own = model.inertias[i + 1]
        if i + 1 in carried:
            factor = rng.uniform(1.2, 1.5)
            changed[i + 1] = pin.Inertia(factor * own.mass, own.lever, factor * own.inertia)
            continue
        reach = radius_of_gyration(own) + 1e-3 * float(np.linalg.norm(own.lever))
        A = reach * rng.normal(size=(3, 3))
        spread = own.mass * A @ A.T
        moments = own.inertia + np.trace(spread) * np.eye(3) - spread
        lever = own.lever + reach * rng.normal(size=3)
        changed[i + 1] = pin.Inertia(own.mass * rng.uniform(0.5, 1.5), lever, moments)
    frames = {k: _elsewhere(model.frames[k].placement, rng) for k in freed.links}
    other = with_numbers(system, changed, placed, frames)
    return in_gravity(other, _HEAVIER * system.gravity)


def _elsewhere(place: pin.SE3, rng: np.random.Generator) -> pin.SE3:
    """Return another place of a link on its body."""
    size = 0.1 + float(np.linalg.norm(place.translation))
    return place * pin.SE3(pin.exp3(rng.uniform(0.1, 0.4, 3)), size * rng.uniform(0.1, 0.5, 3))


def _in_space(
    system: System,
    pose: Array,
    line: Array,
    pushed: Array,
    time: float,
    com: Array,
    H: Array,
    v: Array,
) -> BaseInSpace:
    """Return the base as seen from space, by Pinocchio's mass matrix and the group's own turns.

    pose: its place is not read, for it follows the centre of mass.  com: (3,) in the body's frame.
    v: (n,) relative to the centre of mass.
    """
    group, k = system.group, system.group.linear
    c0, v0, fall = line.reshape(3, k)
    c, velocity = c0 + v0 * time + 0.5 * fall * time**2, v0 + fall * time
    if pushed.size:
        c, velocity = c + pushed[:k], velocity + pushed[k:] / system.mass
    attitude, whole = pose[k:], v.copy()
    whole[:k] += group.turned_back(attitude, velocity)
    place = c - group.turned(attitude, translations(system).T @ com)
    there, mu = np.append(place, attitude), H[: system.r] @ whole
    return BaseInSpace(there, whole[: system.r], mu, group.spatial_momentum(there, mu))


def _with_known_momentum(kernel: Kernel, H: Array, v: Array) -> tuple[Array, Array]:
    """Return a velocity whose momentum is of the kind that a kernel knows, and that momentum."""
    system, parts = kernel.system, kernel.layout.base
    r, k, v = system.r, system.group.linear, v.copy()
    if not (parts.spin or parts.momentum):
        v[:r] = -np.linalg.solve(H[:r, :r], H[:r, r:] @ v[r:])
        return v, np.zeros(r)
    v[:k] = -np.linalg.solve(H[:k, :k], H[:k, k:] @ v[k:])
    mu = H[:r] @ v
    mu[:k] = 0.0
    return v, mu


def _span(forces: ForceModel | None) -> tuple[float, float]:
    """Return a span of time on which every function of time in the forces is defined."""
    signals = () if forces is None else (*forces.signals, *forces.references)
    first = max([0.0, *(signal.span[0] for signal in signals)])
    return first, min([1.0, *(signal.span[1] for signal in signals)])

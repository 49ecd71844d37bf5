"""The engine that evaluates the equations with Pinocchio: vector field, full states, integration.

The reduced state is (x, π, b): positions and canonical momenta of the joints that are not
prescribed, in the frame of the centre of mass, and the integrated variables b of the base.  The
momenta and quaternions of balls come before b.

`Base.rate` is the momentum equation μ̇ = μ × ω + N; reduction/base_parts.py explains the variables.
The compiled engine has the same equations in kernels/reduced_graph.py.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial

import numpy as np
from scipy.integrate import DOP853, DenseOutput, OdeSolution

from ..common.arrays import Array
from ..common.errors import IntegrationError
from ..common.waiting import Progress
from ..forces.force_numbers import BaseInSpace, ForceInputs
from ..forces.switch_times import time_within
from ..integrators.integrate import RunKeeper
from ..integrators.methods import DOP853_LEAST
from ..lie.rotations import apply, rotation, unit
from ..reduction.base_parts import base_parts, into_body, quaternion_rate, root_of
from ..reduction.canonical_form import CanonicalForm, lost_inertia
from ..reduction.pointwise_reduction import symmetric
from ..reduction.potential import shape_gravity
from ..scene.initial_state import Start
from ..system.loops.kinematics import on_surfaces
from ..system.loops.loop import BallSurface, quaternion_parts
from ..system.state_fields import ShapeState, State
from .checkpoint import RunRecord
from .motion import Motion, Solver, follow
from .plan import Plan
from .reduced_flow import Integrate, Sample, Segment, entry_name, map_samples


class Base:
    """The base of one scene: its integrated variables b, and its motion.

    Attributes:
        parts: The integrated variables.
        b0: Initial values of the integrated variables, (parts.size,).
        axes: Directions of the translations, (3, k).
        spin: Constant angular momentum in the fixed frame, (parts.spin,) [N·m·s].
        relative_twist0: Initial body twist relative to the centre of mass, (r,).
        has_momentum: Whether the equations have terms with angular momentum.
        turns: Number of angular momentum components.
    """

    def __init__(self, plan: Plan, start: Start) -> None:
        """Set up the base for a plan and its initial state."""
        system, weight, wrench = plan.system, plan.weight, plan.wrench
        group, root = system.group, root_of(system)
        k = self._k = group.linear
        self._group, self._mass, self.turns = group, system.mass, group.turns
        self.axes, self._g, self._weight = root.axes, root.g, weight
        self._lift = float(root.origin @ root.axes @ root.g)
        self._pivot = float(weight @ root.origin)
        heavy = plan.turned
        attitude, c, P = start.pose[k:], start.com @ root.axes, start.mu[:k]
        about = group.about(start.com, start.mu)
        self.parts = base_parts(
            group, wanted=plan.wanted, heavy=heavy, wrench=wrench, zero_momentum=not about.any()
        )
        self.has_momentum = plan.momentum_changes or bool(about.any())
        self._c0 = start.pose[:k] + group.turned(attitude, c)
        self._v0 = group.turned(attitude, P / system.mass)
        self.spin = self._fixed(attitude, about)[: self.parts.spin]
        down = self._body(attitude, weight / np.linalg.norm(weight)) if self.parts.down else weight
        initial_values = [attitude[: self.parts.attitude], down[: self.parts.down]]
        initial_values += [about[: self.parts.momentum], np.zeros(self.parts.push)]
        self.b0 = np.concatenate(initial_values)
        self.relative_twist0 = start.xi - np.append(P / system.mass, np.zeros(self.turns))
        self._none = np.zeros(system.r)

    def momentum(self, b: Array) -> Array:
        """Return the body momentum (r,) in the frame of the centre of mass."""
        if not (self.parts.momentum or self.parts.spin):
            return self._none
        attitude, _, momentum, _ = self.parts.split(b)
        if self.parts.spin:
            momentum = _into_body(attitude, self.spin) if self.parts.spin == 3 else self.spin
        body_momentum = self._none.copy()
        body_momentum[self._k :] = momentum
        return body_momentum

    def body_weight(self, b: Array) -> Array:
        """Return gravity's force (3,) [N] in the body frame if gravity rotates the base, else 0."""
        if not self._weight.any():
            return self._weight
        attitude, down, _, _ = self.parts.split(b)
        if self.parts.down:
            return np.asarray(np.linalg.norm(self._weight) * down)
        return _into_body(attitude, self._weight)

    def rate(self, b: Array, xi: Array, moment: Array, force: Array) -> Array:
        """Return db/dt.

        Args:
            b: Integrated variables of the base, (parts.size,).
            xi: Body twist relative to the centre of mass, (r,).
            moment: Moment about the centre of mass (for gravity, about the pivot), in the body
                frame [N·m].
            force: Force on the centre of mass in the body frame, (k,) [N].
        Returns:
            Time derivative of b, (parts.size,).
        """
        attitude, down, momentum, push = self.parts.split(b)
        omega = xi[self._k :]
        rates = []
        if self.parts.attitude == 1:
            rates.append(omega)
        elif self.parts.attitude:
            rates.append(quaternion_rate(attitude, omega))
        if self.parts.down:
            rates.append(np.cross(down, omega))
        if self.parts.momentum == 3:
            rates.append(np.cross(momentum, omega) + moment)
        elif self.parts.momentum:
            rates.append(moment)
        if self.parts.push:
            in_space = self._group.turned(self._normal(attitude), force)
            rates += [push[self._k :] / self._mass, in_space]
        return np.concatenate(rates) if rates else np.empty(0)

    def pose(self, b: Array, com: Array, t: Array) -> Array:
        """Return poses (T, size) from b (T, …), body-frame centres of mass (T, 3), times (T,)."""
        attitude = self._attitude(b)
        p = self._centre(b, t) - self._group.turned(attitude, com @ self.axes)
        return np.concatenate([p, attitude], axis=1)

    def twist(self, b: Array, xi: Array, t: Array) -> Array:
        """Return body twists (T, r) from twists xi relative to the centre of mass."""
        if not self._k:
            return xi
        twists = xi.copy()
        carried = self._linear(b, t) / self._mass
        twists[:, : self._k] += self._group.turned_back(self._attitude(b), carried)
        return twists

    def base_energy(self, b: Array, com: Array, t: Array) -> Array:
        """Return the energy ½ m |ċ|² − m g · c, or −m g · R c_b of a pivoted base, (T,) [J]."""
        energy = np.zeros(len(t))
        if self._k:
            P, c = self._linear(b, t), self._centre(b, t)
            energy += 0.5 * np.sum(P * P, axis=1) / self._mass
            energy -= self._mass * (c @ self._g + self._lift)
        return energy + self.weight_energy(b, com)

    def weight_energy(self, b: Array, com: Array) -> Array:
        """Return the potential energy −m g · R c_b of a pivoted base, (T,) [J]."""
        if not self._weight.any():
            return np.zeros(len(b))
        attitude, down, _, _ = self.parts.split(b)
        if self.parts.down:
            weight = np.linalg.norm(self._weight) * down
        else:
            weight = self._body(self._normal(attitude), self._weight)
        return np.asarray(-np.sum(weight * com, axis=-1) - self._pivot)

    def _attitude(self, b: Array) -> Array:
        return self._normal(self.parts.split(b)[0])

    def _normal(self, attitude: Array) -> Array:
        return unit(attitude) if self.parts.attitude == 4 else attitude

    def _centre(self, b: Array, t: Array) -> Array:
        """Return the centre of mass in the root joint's fixed frame, (T, k) [m]."""
        s = t[:, None]
        path = self._c0 + self._v0 * s + 0.5 * self._g * s**2
        return path + self.parts.split(b)[3][:, : self._k] if self.parts.push else path

    def _linear(self, b: Array, t: Array) -> Array:
        """Return the linear momentum, (T, k) [N s]."""
        P = self._mass * (self._v0 + self._g * t[:, None])
        return P + self.parts.split(b)[3][:, self._k :] if self.parts.push else P

    def _fixed(self, attitude: Array, v: Array) -> Array:
        """Rotate angular components (a,) from the body frame to the fixed frame."""
        return np.asarray(apply(rotation(attitude), v)) if v.shape[-1] == 3 else v

    def _body(self, attitude: Array, v: Array) -> Array:
        """Rotate vectors (..., 3) to the body frame; planar angular components stay."""
        if v.shape[-1] != 3 or attitude.shape[-1] != 4:
            return v
        return into_body(attitude, v)


def _into_body(q: Array, J: Array) -> Array:
    """Return Rᵀ J, (3,), for a quaternion of any length.  Scalar code is faster than NumPy here."""
    x, y, z, w = q.tolist()
    a, b, c = J.tolist()
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    # t = J × u, then J + scale (w t + t × u): the rotation by the conjugate quaternion.
    t1, t2, t3 = b * z - c * y, c * x - a * z, a * y - b * x
    return np.array(
        [
            a + scale * (w * t1 + t2 * z - t3 * y),
            b + scale * (w * t2 + t3 * x - t1 * z),
            c + scale * (w * t3 + t1 * y - t2 * x),
        ]
    )


class PinocchioFlow:
    """The reduced flow of a scene, evaluated with Pinocchio.  Not thread-safe.

    Attributes:
        y0: Initial reduced state, (k,).
        parameters: Force parameters, (p,).
        numbers_at: Indices of the force parameters among `parameters`, which has no others.
        clock: Index of the time in a reduced state; empty, because the time is not integrated.
        base: The motion of the base.
        system: The system.
        forces: Forces besides gravity; None if there are none.
    """

    def __init__(self, plan: Plan, base: Base | None = None) -> None:
        """Set up the flow of a plan from its initial state.

        Args:
            plan: The plan.
            base: The motion of the base; None for that from the initial state.
        """
        system, start = plan.system, plan.scene.start
        self.system, self._wanted = system, plan.wanted
        self.forces = forces = plan.forces
        self._seen = forces is not None and (forces.sees_attitude or forces.sees_place)
        space, self._driven = system.space, list(plan.driven)
        self._ball_joints = [j for j in space.balls if j.v.start not in self._driven]
        self._balls = [k for j in self._ball_joints for k in range(j.v.start, j.v.stop)]
        self._balls_x = [k for j in self._ball_joints for k in range(j.x.start, j.x.stop)]
        self._free = [k for k in plan.free if k not in self._balls]
        self._driven_x = space.coordinates_of_joints(self._driven)
        self._free_x = space.coordinates_of(self._free)
        self._balls_at = 2 * len(self._free)
        self._surfaces = dict[str, list[BallSurface]]()
        for loop in system.loops:
            if isinstance(loop, BallSurface):
                self._surfaces.setdefault(loop.ball, []).append(loop)
        first = self._balls_at + 7 * len(self._ball_joints)
        self._potential = shape_gravity(system)
        self._weight = plan.weight
        self._form = CanonicalForm(system, self._potential)
        self.parameters, self.numbers_at = plan.numbers, slice(None)
        self.clock = slice(0)
        self.base = base = Base(plan, start) if base is None else base
        self._base_at = slice(first, first + base.parts.size)
        pi = start.mass_matrix[system.r :] @ np.concatenate([base.relative_twist0, start.xdot])
        self.y0 = self._reduced(start.x, pi, base.b0)

    @property
    def numbers(self) -> Array:
        """Force parameters, (p,)."""
        return self.parameters

    @property
    def position_entries(self) -> dict[int, int]:
        """Entry of the reduced state for each hinge or slide that moves, by index of its rate."""
        return {v: k for k, v in enumerate(self._free)}

    def in_mode(self, plan: Plan) -> PinocchioFlow:
        """Return the flow of the same run with other prescribed joints, without a state.

        Args:
            plan: Plan of the run's scene with other prescribed joints.
        Returns:
            The flow. Its base has the same constant momentum and centre-of-mass path.
        """
        return PinocchioFlow(plan, self.base)

    def resumed(
        self,
        t: float,  # noqa: ARG002
        x: Array,
        pi: Array,
        before: PinocchioFlow,
        y: Array,
    ) -> PinocchioFlow:
        """Return the flow from a state at any time, with the base of another flow of the run.

        Args:
            t: Time [s].
            x: Shape, (nx,) [rad | m | 1].
            pi: Canonical momenta in the frame of the centre of mass, (m,).
            before: Flow that provides the base.
            y: Its reduced state, (k,).
        Returns:
            The flow.
        """
        flow = copy(self)
        flow.y0 = self._reduced(x, pi, y[before._base_at])
        return flow

    def canonical_momenta(
        self, t: float, y: Array, parameters: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return the shape, its rate, and its canonical momenta, from a reduced state (k,)."""
        x, v = self._motion(t, y, self.parameters if parameters is None else parameters)
        r, pi = self.system.r, self._momentum(y)[self.system.r :]
        H = symmetric(self._form.mass_matrix(x))
        pi[self._driven] = (H[r:] @ v)[self._driven]
        return x, v[r:], pi

    def parameters_between(self, start: float, stop: float) -> Array:
        """Return a copy of the parameters for the time between two stops."""
        parameters = self.parameters.copy()
        if self.forces is not None:
            self.forces.set_span(parameters, time_within(start, stop))
        return parameters

    def _reduced(self, x: Array, pi: Array, b: Array) -> Array:
        """Return the reduced state, (k,), from shape, canonical momenta and base variables."""
        columns = [x[self._free_x], pi[self._free], pi[self._balls], x[self._balls_x], b]
        return np.concatenate(columns)

    def rates(self, t: Array, y: Array, numbers: Array) -> Array:
        """Return dy/dt (T, k) at times t (T,) of reduced states y (T, k)."""
        pairs = zip(t.tolist(), y, strict=True)
        return np.array([self.rate(time, y_t, numbers) for time, y_t in pairs]).reshape(y.shape)

    def rate(self, t: float, y: Array, numbers: Array | None = None) -> Array:
        """Return dy/dt, (k,), with force parameters (p,); None for the initial parameters."""
        numbers = self.parameters if numbers is None else numbers
        system, form, free, r = self.system, self._form, self._free, self.system.r
        k = system.group.linear
        b = y[self._base_at]
        x, v = self._motion(t, y, numbers)
        com = form.com()
        pidot, moment, push = form.force(x, v), np.zeros(r - k), np.zeros(k)
        if system.closure is not None:
            pidot = pidot + form.loop_terms(x, v[r:], self._momentum(y), self._driven)
        slope = None
        if self.forces is not None:
            mu = self.base.momentum(b)
            base = self._in_space(t, b, x, v, com) if self._seen else None
            acting = self.forces.acting(ForceInputs(t, x, v[r:], v[:r], mu, numbers, base))
            pidot = pidot + acting.torque
            if self.forces.has_wrench:
                push = acting.wrench[:k]
                moment = system.group.about(com, acting.wrench)
                slope = form.com_slope(x)
                pidot = pidot - push @ (self.base.axes.T @ slope)
        if self._weight.any():
            weight = self.base.body_weight(b)
            moment = moment + np.cross(com, weight)
            slope = form.com_slope(x) if slope is None else slope
            pidot = pidot + weight @ slope
        rate = self.base.rate(b, v[:r], moment, push)
        xdot = v[r:]
        balls = [pidot[self._balls], *self._quaternion_rates(y, xdot)]
        return np.concatenate([xdot[free], pidot[free], *balls, rate])

    def sample(self, t: float, y: Array, numbers: Array) -> Sample:
        """Return the state at time t that forces depend on."""
        x, v = self._motion(t, y, numbers)
        r, b = self.system.r, y[self._base_at]
        base = self._in_space(t, b, x, v, self._form.com()) if self._wanted else None
        return Sample(x, v[r:], v[:r], self.base.momentum(b), self.base.body_weight(b), base)

    def samples(self, t: Array, y: Array, numbers: Array) -> Sample:
        """Return the states at times (T,) that forces depend on, from reduced states (T, k)."""
        samples = [self.sample(time, y_t, numbers) for time, y_t in zip(t.tolist(), y, strict=True)]
        return map_samples(np.array, samples)

    def _in_space(self, t: float, b: Array, x: Array, v: Array, com: Array) -> BaseInSpace:
        """Return the base in the fixed frame; v, (n,), is relative to the centre of mass."""
        system, times = self.system, np.array([t])
        r = system.r
        pose = self.base.pose(b[None], com[None], times)[0]
        xi = self.base.twist(b[None], v[None, :r], times)[0]
        H = symmetric(self._form.mass_matrix(x))
        mu = H[:r] @ np.concatenate([xi, v[r:]])
        return BaseInSpace(pose, xi, mu, system.group.spatial_momentum(pose, mu))

    def states(self, t: Array, y: Array, numbers: Array) -> State | ShapeState:
        """Compute full states from reduced states.

        Args:
            t: Times, (T,) [s].
            y: Reduced states, (T, k).
            numbers: Force parameters at these times, (p,).
        Returns:
            The states, without the base if the scene leaves it out.
        Raises:
            IntegrationError: A velocity is not finite.
        """
        system, form = self.system, self._form
        r, T = system.r, len(t)
        b = y[:, self._base_at]
        x, v, com = np.empty((T, system.nx)), np.empty((T, system.n)), np.empty((T, 3))
        energy, H = np.empty(T), np.empty((T, system.n, system.n))
        for k in range(T):
            x[k], v[k] = self._motion(float(t[k]), y[k], numbers)
            com[k] = form.com()
            H[k] = symmetric(form.mass_matrix(x[k]))
            energy[k] = 0.5 * v[k] @ H[k] @ v[k] + self._potential.value(x[k])
            if self.forces is not None:
                energy[k] += self.forces.potential(x[k], numbers)
        if not np.isfinite(v).all():
            bad = t[~np.isfinite(v).all(axis=1)][0]
            raise IntegrationError(f"the motion of '{system.name}' is not finite at t = {bad:g} s")
        if not self._wanted:
            return ShapeState(
                t=t.copy(),
                x=x,
                xdot=v[:, r:].copy(),
                energy=energy + self.base.weight_energy(b, com),
            )
        energy += self.base.base_energy(b, com, t)
        pose, xi = self.base.pose(b, com, t), self.base.twist(b, v[:, :r], t)
        mu = np.empty((T, r))
        for k in range(T):
            mu[k] = H[k, :r] @ np.concatenate([xi[k], v[k, r:]])
        J = system.group.spatial_momentum(pose, mu)
        xdot = v[:, r:].copy()
        return State(
            t=t.copy(),
            x=x,
            xdot=xdot,
            xi=np.ascontiguousarray(xi),
            pose=pose,
            q=system.q(pose, x),
            v=system.v(xi, xdot),
            body_momentum=mu,
            spatial_momentum=J,
            energy=energy,
        )

    def _motion(self, t: float, y: Array, numbers: Array) -> tuple[Array, Array]:
        """Return the shape (nx,) and v = (ξ, ẋ) relative to the centre of mass."""
        momentum = self._momentum(y)
        if self.forces is None or not self._driven:
            x = self._shape(y)
            return x, self._form.velocity(x, momentum)
        planned = self.forces.prescribed(t, numbers)
        x = self._shape(y, planned.x)
        return x, self._form.driven_velocity(x, momentum, self._driven, planned.xdot)

    def _momentum(self, y: Array) -> Array:
        """Return (μ, π), (n,), of a reduced state, with zeros for prescribed joints."""
        free, pi = self._free, np.zeros(self.system.m)
        pi[free] = y[len(free) : 2 * len(free)]
        pi[self._balls] = y[self._balls_at : self._balls_at + len(self._balls)]
        return np.concatenate([self.base.momentum(y[self._base_at]), pi])

    def shape(self, t: float, y: Array, numbers: Array) -> Array:
        """Return the shape (nx,) of a reduced state, with quaternions of length one."""
        if self.forces is None or not self._driven:
            return self._shape(y)
        return self._shape(y, self.forces.prescribed(t, numbers).x)

    def _shape(self, y: Array, planned: Array | None = None) -> Array:
        """Return the shape (nx,) with the coordinates of the prescribed joints, if any."""
        x = np.empty(self.system.nx)
        x[self._free_x] = y[: len(self._free)]
        x[self._balls_x] = y[self._balls_at + len(self._balls) : self._base_at.start]
        for joint in self._ball_joints:
            x[joint.x] = on_surfaces(self._surfaces.get(joint.name, ()), x[joint.x])
        if planned is not None:
            x[self._driven_x] = planned
        return x

    def _quaternion_rates(self, y: Array, xdot: Array) -> list[Array]:
        """Return the rates ½ q σ of the quaternions of balls, of any length.

        The parts of a ball at rest at a stop have constant norms; see `quaternion_parts`.
        """
        quaternions = y[self._balls_at + len(self._balls) : self._base_at.start].reshape(-1, 4)
        rates = []
        for q, joint in zip(quaternions, self._ball_joints, strict=True):
            surfaces = self._surfaces.get(joint.name)
            if surfaces is None:
                rates.append(quaternion_rate(q, xdot[joint.v]))
                continue
            turn = quaternion_rate(on_surfaces(surfaces, q), xdot[joint.v])
            projections = [p for p in quaternion_parts(surfaces) if np.trace(p[0]) > 1.5]
            scaled = [np.linalg.norm(P @ q) / radius * (P @ turn) for P, radius in projections]
            rates.append(np.sum(scaled, axis=0))
        return rates

    def entry_name(self, entry: int) -> str:
        """Return the name of an entry of the reduced state, for messages."""
        return entry_name(self.system, self._free, [], entry, driven=self._driven)


MOST_STEPS = 1_000_000
DEGREE = 7  # of the dense output of DOP853 within a step


def integrator(
    flow: PinocchioFlow,
    plan: Plan,
    progress: Progress | None,
    _chunk: int | None = None,
) -> Integrate:
    """Return the function that integrates a flow from one time of its plan to another.

    Args:
        flow: The flow of the plan.
        plan: The plan.
        progress: Called after each step with the completed fraction of the time, 0 to 1.
        _chunk: Not used: `watch` is called after each step.
    Returns:
        The function; its IntegrationError states the time and the entry of the reduced state.
    """
    scene = plan.scene
    rtol, atol = scene.tolerance
    rtol = max(rtol, DOP853_LEAST)

    def run(
        start: float,
        end: float,
        y0: Array,
        parameters: Array,
        watch: Callable[[Segment], bool] | None = None,
        keeper: RunKeeper | None = None,  # noqa: ARG001
    ) -> Segment:
        if y0.size == 0:  # a single body that only translates has no reduced state
            return Segment.stored(
                np.array([start, end]), lambda t: np.empty((len(t), 0)), parameters, 0, 0
            )

        def rate(t: float, y: Array) -> Array:
            return flow.rate(t, y, parameters)

        solver = DOP853(rate, start, y0, end, plan.longest, rtol, atol)
        knots: list[float] = [start]

        def lost() -> str:
            y = solver.y if np.isfinite(solver.y).all() else solver.y_old
            return lost_inertia(scene.system, flow.shape(solver.t, y, parameters))

        steps: list[DenseOutput] = []

        def so_far() -> Segment:
            dense = OdeSolution(knots, steps)
            return Segment.stored(
                np.array(knots), lambda t: np.asarray(dense(t)).T, parameters, len(steps),
                solver.nfev,
            )  # fmt: skip

        while solver.status == "running":
            if watch is not None and steps and watch(so_far()):
                return so_far()
            if len(steps) >= MOST_STEPS:
                raise IntegrationError(
                    f"'{scene.system.name}' reached the limit of {MOST_STEPS} steps at t = "
                    f"{solver.t:g} s, before the end at {scene.end:g} s; shorten the scene or "
                    f"loosen the tolerance{lost()}"
                )
            with np.errstate(over="ignore", invalid="ignore"):  # overflows are reported below
                message = solver.step()
                step = solver.dense_output() if solver.status != "failed" else None
            if not np.isfinite(solver.y).all():
                entry = int(np.argmin(np.isfinite(solver.y)))
                raise IntegrationError(
                    f"{flow.entry_name(entry)} of '{scene.system.name}' is not finite after "
                    f"t = {knots[-1]:g} s{lost()}"
                )
            if solver.status == "failed":
                raise IntegrationError(
                    f"'{scene.system.name}' cannot be integrated beyond t = {solver.t:g} s of "
                    f"{scene.end:g} s at rtol = {scene.rtol:g}: {message}{lost()}"
                )
            knots.append(solver.t)
            steps.append(step)
            if progress is not None:
                progress(solver.t / scene.end)
        return so_far()

    return run


def _motion(
    flow: PinocchioFlow,
    plan: Plan,
    progress: Progress | None,
    _record: RunRecord | None,
) -> Callable[[], Motion]:
    return partial(follow, plan, flow, integrator(flow, plan, progress))


SOLVER = Solver("DOP853", DEGREE, PinocchioFlow, integrator, _motion)

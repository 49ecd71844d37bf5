"""CasADi expressions of the reduced vector field, for one robot and one structure.

The graph omits all terms that a scene does not need.  The reduced state is

    y = (x, π) of the active joints, x of the cyclic joints, π and quaternions of the balls,
        the integrated entries of the base, and the time, if any term depends on it.

The parameters are, in this order: the angular momentum of the base if it is constant, the constant
momenta of joints, the gravity components that act [m/s²], the variable body parameters, the
centre-of-mass path if forces depend on it, and the force parameters.  A joint is cyclic if no
term depends on its angle and no force acts on it; then its momentum is constant.

A spherical rotor is a ball whose body has equal moments of inertia and its centre of mass at the
ball.  Its momentum π in its own axes is constant.  The other bodies feel only ℓ = R π, its momentum
in the axes of its parent, so the sweep works in these axes, with R = 1.

With closed loops, π is the impetus (see reduction/tree/loop_constraints.py).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cached_property

import casadi as ca

from ..common.argument_kinds import checks_arguments
from ..forces.force_model import ForceModel
from ..forces.force_numbers import numbers_in
from ..reduction.base_parts import BaseParts, root_of
from ..reduction.tree.all_joints import configuration, joint_rates, joint_values, shape_gradient
from ..reduction.tree.articulated_sweep import Swept, sweep
from ..reduction.tree.body_frames import bodies_of, with_rotors
from ..reduction.tree.free_bodies import total_mass, with_free
from ..reduction.tree.identical_branches import Lanes
from ..reduction.tree.loop_constraints import LoopTerms, RestingBall, solve_with_loops
from ..reduction.tree.momenta import casadi_reduction, centre_of_mass
from ..reduction.tree.scalars import (
    Scalar,
    Vec,
    add,
    as_column,
    as_scalars,
    cross,
    dot,
    mul,
    plus,
    quaternion_matrix,
    quaternion_rate,
    quaternion_rate_in_parent,
    sub,
    total,
)
from ..system.loops.loop import BallSurface
from ..system.system import System
from .kernel import Layout, Structure, layout_of, separate_fields


class ReducedGraph:
    """CasADi expressions of the reduced equations of a system, for one structure and its forces.

    Attributes:
        system: The system.
        forces: Forces on the system, or None.
        layout: Layout of the reduced state and of the parameters.
        x: Shape, (nx,).
        pi: Canonical momenta, (m,); the impetus if the system has closed loops.
        base: Expressions of the base.
        loops: Terms of closed loops, or None.
        xi: Body twist relative to the centre of mass, (r,).
        xdot: Shape rate, (m,).
        pidot: Rates of the canonical momenta, (m,).
        swept: Results of the sweep.
        sweep_inputs: The inputs (μ, x, π) of the sweep, in one column.
        sweep_results: The results (ξ, ẋ, π̇) of the sweep, without forces, in one column.
        cuts: Symbols that stand for these results if the graph is cut.
    """

    def __init__(
        self,
        system: System,
        structure: Structure,
        forces: ForceModel | None = None,
        lanes: Lanes | None = None,
        *,
        cut: bool = False,
    ) -> None:
        """Build the expressions with an articulated-body sweep.

        Args:
            system: The system.
            structure: Structure of the reduced equations.
            forces: Forces on the system, or None.
            lanes: If not None, identical branches are computed in SIMD lanes.  The Functions must
                then be compiled by `compile_object` with the marks of `lanes`.
            cut: Whether `rates` depends on symbols that stand for the results of the sweep.
        """
        self.system, self.forces, self._lanes = system, forces, lanes
        self._freed = structure.freed
        self._body_numbers = [ca.SX.sym(f"Y{k}") for k in range(structure.freed.size)]
        bodies = with_free(bodies_of(system), structure.freed, self._body_numbers)
        self._bodies = with_rotors(bodies, [system.sorted_joints[v] - 1 for v in structure.rotors])
        self._mass = total_mass(self._bodies) if structure.freed.inertias else system.mass
        group, m = system.group, system.m
        self.layout = layout_of(system, structure, forces)
        self._gravity = [ca.SX.sym(f"g{axis}") for axis in structure.gravity]
        self._weight = self._weight_of(structure)
        self.x = [ca.SX.sym(f"x{k}") for k in range(system.nx)]
        self.pi = [ca.SX.sym(f"pi{k}") for k in range(m)]
        self._lifted_momenta = self._lift_balls(structure)
        rotating_weight = self._weight if self.layout.gravity_on_base else None
        self.base = BaseGraph(
            system, self.layout.base, rotating_weight, lifted=structure.lifted, mass=self._mass
        )
        self._t = ca.SX.sym("t")
        prescribed, cyclic_x = self.layout.prescribed, self.layout.cyclic_x
        self._com_path = [ca.SX.sym(f"line{k}") for k in range(self.layout.com_path)]
        self._numbers = [ca.SX.sym(f"p{k}") for k in range(self.layout.numbers)]
        self._angles = ca.vertcat(ca.SX(0, 1), *self.x)  # variables of differentiation of energies
        motion = self._prescribed()
        for k, position in zip(self.layout.prescribed_x, motion, strict=False):
            self.x[k] = position
        self._integrated_x, self._resting = list(self.x), self._balls_at_rest()
        for k, v in self.layout.balls:
            if v in self._resting:
                self.x[k : k + 4] = self._resting[v].attitude
        self._mu = mu = self.base.body_momentum()
        armature = float(system.model.armature[0])  # nonzero only for single-axis roots
        # No term depends on the angle of a cyclic joint, so set it to zero.
        angles: list[Scalar] = [0.0 if k in cyclic_x else x for k, x in enumerate(self.x)]
        momenta = self._align_rotors(angles)
        rates = dict(zip(prescribed, motion[len(self.layout.prescribed_x) :], strict=True))
        # Constraint terms are not packed into lanes, so sweep all branches of robots with loops.
        lanes = lanes if system.closure is None else None

        def sweep_from(pi: list[Scalar], momentum: bool) -> Swept:
            return sweep(
                self._bodies, joint_values(system, angles), pi, mu if momentum else [0.0] * len(mu),
                group.axes, armature, rates if momentum else dict.fromkeys(rates, 0.0), lanes,
                system.coupled,
            )  # fmt: skip

        self.loops: LoopTerms | None = None
        if system.closure is not None:
            self.loops = solve_with_loops(
                system, self._bodies, self.x, self.pi, sweep_from, prescribed=prescribed
            )
        result = sweep_from(momenta, True) if self.loops is None else self.loops.swept
        twist = [*result.root_linear, *result.root_angular]
        self.xi: list[Scalar] = [twist[axis] for axis in group.axes]
        self.xdot: list[Scalar] = result.xdot
        shape_rates = result.pidot
        self.swept, self.sweep_inputs = result, as_column(mu, angles, momenta)
        self.sweep_results = as_column(self.xi, self.xdot, shape_rates)
        self.cuts = ca.SX.sym("cut", self.sweep_results.numel())
        if cut:
            cuts = ca.vertsplit(self.cuts)
            self.xi, self.xdot = cuts[: system.r], cuts[system.r : system.r + m]
            shape_rates = cuts[system.r + m :]
        self._rotor_rates = self._turn_rotor_rates()
        self._prescribed_pi = {k: result.pi[k] for k in prescribed}
        torque, wrench = self._forces(mu)
        pidot = [add(p, t) for p, t in zip(shape_rates, torque, strict=True)]
        if self.loops is not None:
            pidot = [add(p, t) for p, t in zip(pidot, self.loops.rates, strict=True)]
        self.pidot = self._add_shape_loads(pidot, wrench)
        weight = self.base.body_weight()
        self._base_rate = self.base.rates(self.xi, self.com(), wrench, weight)

    @cached_property
    def y(self) -> ca.SX:
        """The reduced state, (size,)."""
        layout, lifted = self.layout, self.layout.lifted_balls
        return as_column(
            [self.x[k] for k in (*layout.active_x, *(layout.ball_x if lifted else ()))],
            [self.pi[k] for k in layout.active],
            *(self._lifted_momenta if lifted else ()),
            [self.x[k] for k in layout.cyclic_x],
            [self.pi[k] for k in (() if lifted else layout.ball_pi)],
            [self._integrated_x[k] for k in (() if lifted else layout.ball_x)],
            self.base.b,
            [self._t] * layout.clock,
        )

    @cached_property
    def parameters(self) -> ca.SX:
        """The parameters, (parameters,)."""
        momenta = [self.pi[k] for k in self.layout.constant_pi]
        physical = [*self._gravity, *self._body_numbers, *self._com_path]
        return as_column(self.base.spin, momenta, physical, self._numbers)

    def _lift_balls(self, structure: Structure) -> list[list[Scalar]]:
        """Create conjugate momenta p, (4,), of the balls, and set π = ½ E(q)ᵀ p."""
        if not structure.lifted_balls:
            return []
        momenta: list[list[Scalar]] = []
        for k, (x, v) in enumerate(self.layout.balls):
            p = [ca.SX.sym(f"p{k}_{n}") for n in range(4)]
            a, b, c, d = self.x[x : x + 4]
            self.pi[v : v + 3] = [
                0.5 * (d * p[0] - a * p[3] - b * p[2] + c * p[1]),
                0.5 * (d * p[1] - b * p[3] - c * p[0] + a * p[2]),
                0.5 * (d * p[2] - c * p[3] - a * p[1] + b * p[0]),
            ]
            momenta.append(p)
        return momenta

    def _balls_at_rest(self) -> dict[int, RestingBall]:
        """Return the balls that rest at their stops, by the indices of their first rates."""
        names = {loop.ball for loop in self.system.loops if isinstance(loop, BallSurface)}
        return {
            joint.v.start: RestingBall.of(self.system, joint, self.x[joint.x])
            for joint in self.system.space.balls
            if joint.name in names
        }

    def _align_rotors(self, x: list[Scalar]) -> list[Scalar]:
        """Set the attitudes R of the rotors in x to 1; return the momenta with ℓ = R π."""
        momenta = list(self.pi)
        for at, v in self.layout.balls:
            if v in self.layout.rotors:
                R = quaternion_matrix(x[at : at + 4])
                momenta[v : v + 3] = [dot(row, self.pi[v : v + 3]) for row in R]
                x[at : at + 4] = [0.0, 0.0, 0.0, 1.0]
        return momenta

    def _turn_rotor_rates(self) -> dict[int, list[Scalar]]:
        """Turn the rates of the rotors into their own axes; return those in the parents' axes."""
        rates: dict[int, list[Scalar]] = {}
        for at, v in self.layout.balls:
            if v in self.layout.rotors:
                rates[v] = self.xdot[v : v + 3]
                columns = zip(*quaternion_matrix(self.x[at : at + 4]), strict=True)
                self.xdot[v : v + 3] = [dot(list(column), rates[v]) for column in columns]
        return rates

    def _lifted_momentum_rates(self) -> list[list[Scalar]]:
        """Return ṗ = 2 (q ∘ F)/|q|² + ½ p ∘ σ for each ball, with F = π̇ − π × σ."""
        rates: list[list[Scalar]] = []
        for p, (x, v) in zip(self._lifted_momenta, self.layout.balls, strict=True):
            q, sigma = self.x[x : x + 4], self.xdot[v : v + 3]
            gyroscopic = cross(self.pi[v : v + 3], sigma)
            force = [sub(a, b) for a, b in zip(self.pidot[v : v + 3], gyroscopic, strict=True)]
            scale = 2.0 / total([mul(c, c) for c in q])
            pushed = quaternion_rate(q, [mul(scale, c) for c in force])
            rates.append(
                [2.0 * a + b for a, b in zip(pushed, quaternion_rate(p, sigma), strict=True)]
            )
        return rates

    @cached_property
    def _unit_x(self) -> list[Scalar]:
        """The shape, (nx,), with quaternions of length one, which states inside a step lack."""
        x = list(self.x)
        for joint in self.system.space.balls:
            if joint.v.start in self._resting:
                continue
            q = self.x[joint.x]
            scale = 1.0 / ca.sqrt(total([mul(c, c) for c in q]))
            x[joint.x] = [mul(scale, c) for c in q]
        return x

    def rate(self) -> ca.Function:
        """Return the vector field as a Function (y, parameters) → dy/dt."""
        return self._function("rate", self.rates, [self.y, self.parameters])

    @cached_property
    def rates(self) -> ca.SX:
        """The rates dy/dt, (size,)."""
        layout, lifted = self.layout, self.layout.lifted_balls
        attitudes = [
            quaternion_rate_in_parent(self.x[x : x + 4], self._rotor_rates[v])
            if v in self._rotor_rates
            else quaternion_rate(self.x[x : x + 4], self.xdot[v : v + 3])
            for x, v in layout.balls
        ]
        for k, (_, v) in enumerate(layout.balls):
            if v in self._resting:
                attitudes[k] = self._resting[v].rate(attitudes[k])
        return as_column(
            [self.xdot[k] for k in layout.active],
            *(attitudes if lifted else ()),
            [self.pidot[k] for k in layout.active],
            *(self._lifted_momentum_rates() if lifted else ()),
            [self.xdot[k] for k in layout.cyclic],
            [self.pidot[k] for k in (() if lifted else layout.ball_pi)],
            *(() if lifted else attitudes),
            self._base_rate,
            [1.0] * layout.clock,
        )

    def outputs(self) -> ca.Function:
        """Return the outputs as a Function ((y, t), (parameters, c0, v0, g)) → fields of Outputs.

        The time is an input only if it is not the last entry of y.  c0, v0 and g, (k,) each, are
        the initial position, initial velocity and gravity of the centre of mass in the root
        joint's fixed frame.
        """
        system, k = self.system, self.system.group.linear
        com, positions = self.com(), [self.x[j] for j in self.layout.prescribed_x]
        canonical = self.pi if self.loops is None else self.loops.pi
        momenta = [self._prescribed_pi.get(j, canonical[j]) for j in range(system.m)]
        about = self._mu[k:]
        energy = mul(0.5, add(dot(self.xi[k:], about), dot(self.xdot, momenta)))
        energy = add(energy, self._potential(com))
        weight: list[Scalar] = self.base.body_weight() or []
        blocks = [self.xi, self.xdot, com, self._mu, weight]
        blocks += [positions, list(self._prescribed_pi.values())]
        fields: dict[str, list[Scalar]] = {"x": self._unit_x}
        com_path = [ca.SX.sym(f"line{j}") for j in range(3 * k)]
        if self.layout.base_requested:
            full = self.base.full(self.xi, self._mu, com, self._t, com_path)
            fields["pose"] = full.pose
            fields["q"] = configuration(system, full.pose, self._unit_x)
            fields["v"] = [*full.xi, *joint_rates(system, self.xdot)]
            fields["body_momentum"] = full.body_momentum
            fields["spatial_momentum"] = full.spatial_momentum
            energy = add(energy, full.energy)
        fields["energy"] = [energy]
        blocks += [fields[name] for name in separate_fields(base=self.layout.base_requested)]
        y = self.y if self.layout.clock else ca.vertcat(self.y, self._t)
        inputs = [y, ca.vertcat(self.parameters, *com_path)]
        return self._function("outputs", as_column(*blocks), inputs)

    def _potential(self, com: Vec) -> Scalar:
        """Return the potential V(x) plus the gravitational energy of a pivoted body."""
        energy: Scalar = 0.0
        if self.forces is not None:
            value = self.forces.potential_function(
                as_column(self._unit_x), as_column(self._numbers)
            )
            energy = add(energy, as_scalars(value)[0])
        if self._weight is not None:
            weight = self.base.body_weight() or self._weight
            origin = dot(self._weight, root_of(self.system).origin.tolist())
            energy = sub(energy, add(dot(weight, com), origin))
        return energy

    def _function(self, name: str, value: ca.SX, inputs: list[ca.SX]) -> ca.Function:
        if self._lanes is not None:
            return self._lanes.function(name, inputs, value)
        return ca.Function(name, inputs, [ca.densify(value)], {"cse": True})

    def _weight_of(self, structure: Structure) -> Vec | None:
        """Return the gravity force m g on the shape or on a pivoted base, or None."""
        weight: Vec = [0.0, 0.0, 0.0]
        for axis, g in zip(structure.gravity, self._gravity, strict=True):
            weight[axis] = mul(self._mass, g)
        return weight if structure.gravity else None

    def com(self) -> Vec:
        """Return the centre of mass in the root body's frame, (3,)."""
        return centre_of_mass(self._bodies, joint_values(self.system, self.x))

    def _prescribed(self) -> list[Scalar]:
        """Return the coordinates, then the rates of the prescribed joints."""
        if self.forces is None or not self.layout.prescribed:
            return []
        x, xdot, _ = self.forces.prescribed_function(self._t, as_column(self._numbers))
        return as_scalars(x) + as_scalars(xdot)

    def _forces(self, mu: list[Scalar]) -> tuple[list[Scalar], list[Scalar]]:
        """Evaluate the forces; return the torques, (m,), and the base wrench, (r,) or empty."""
        if self.forces is None:
            return [0.0] * self.system.m, []
        base, robot = self._observed_base(mu), self._robot_parameters(self.forces)
        columns = (self._unit_x, self.xdot, self.xi, mu, self._numbers, *base, robot)
        state = [as_column(list(column)) for column in columns]
        torque, wrench = self.forces.acting_function(self._t, *state)
        return as_scalars(torque), as_scalars(wrench) if self.forces.has_wrench else []

    def _robot_parameters(self, forces: ForceModel) -> list[Scalar]:
        """Return the robot parameters that the forces depend on; constants remain floats."""
        links = {
            frame: self._body_numbers[self._freed.of_link(frame)] for frame in self._freed.links
        }
        gravity: Vec = [0.0, 0.0, 0.0]
        for axis, g in zip(self.layout.gravity, self._gravity, strict=True):
            gravity[axis] = g
        return [*numbers_in(self._bodies, self.system, forces.freed, links), *gravity]

    def _observed_base(self, mu: list[Scalar]) -> list[list[Scalar]]:
        """Return the base state that forces depend on, or zeros if no force depends on it.

        The entries are the pose, the body twist, the body momentum and the spatial momentum.
        """
        group, forces = self.system.group, self.forces
        if forces is None or not (forces.sees_attitude or forces.sees_place):
            return [[0.0] * group.size, *([0.0] * group.dim for _ in range(3))]
        com_path: list[Scalar] = [*self._com_path] or [0.0] * (3 * group.linear)
        full = self.base.full(self.xi, mu, self.com(), self._t, com_path)
        return [full.pose, full.xi, full.body_momentum, full.spatial_momentum]

    def _add_shape_loads(self, pidot: list[Scalar], wrench: list[Scalar]) -> list[Scalar]:
        """Return π̇ plus the generalised forces of gravity and of the base wrench on the shape."""
        # With F and the centre of mass c in the body frame, gravity contributes ∂(F·c)/∂x. A force
        # on the base accelerates the frame of the centre of mass, so it contributes −∂(F·c)/∂x.
        m = self.system.m
        angles = joint_values(self.system, ca.vertsplit(self._angles) if m else [])
        com = centre_of_mass(self._bodies, angles)
        loads: list[tuple[Scalar, Scalar]] = []  # symbol and value for each coordinate of c
        energy: Scalar = 0.0
        pairs = list(zip(wrench, self.base.along(com), strict=False))  # only the linear part
        weight = self.base.body_weight()
        if weight is None:
            weight = self._weight
        if weight is not None:
            pairs += [(mul(-1.0, w), c) for w, c in zip(weight, com, strict=True)]
        for load, c in pairs:
            if isinstance(c, ca.SX) and not (isinstance(load, float) and load == 0.0):
                symbol = ca.SX.sym("load")
                loads.append((symbol, load))
                energy = add(energy, mul(symbol, c))
        if not (isinstance(energy, ca.SX) and m):
            return pidot
        gradient = shape_gradient(self.system, energy, self._angles)
        symbols, values = as_column([s for s, _ in loads]), as_column([v for _, v in loads])
        at = [values, as_column(self.x)]
        (gradient,) = ca.substitute([gradient], [symbols, self._angles], at)
        return [add(pidot[k], mul(-1.0, gradient[k])) for k in range(m)]


@dataclass(frozen=True)
class FullBase:
    """CasADi expressions for the base fields of State.

    Attributes:
        pose: Pose coordinates, (size,).
        xi: Body twist, (r,).
        body_momentum: Body momentum, (r,).
        spatial_momentum: Spatial momentum, (r,).
        energy: Kinetic and potential energy of the centre-of-mass motion.
    """

    pose: list[Scalar]
    xi: list[Scalar]
    body_momentum: list[Scalar]
    spatial_momentum: list[Scalar]
    energy: Scalar


class BaseGraph:
    """CasADi expressions for the state and the rates of the base of one system.

    Attributes:
        parts: Numbers of integrated and constant entries (see BaseParts).
        attitude: Angle or quaternion of the base.
        down: Unit vector of gravity in the body frame.
        momentum: Angular momentum in the body frame, about the centre of mass.
        push: Displacement and momentum of the centre of mass caused by a wrench.
        b: All integrated entries of the base, in the order of the attributes above.
        spin: Constant angular momentum in the fixed frame.
    """

    def __init__(
        self,
        system: System,
        parts: BaseParts,
        weight: Vec | None,
        *,
        lifted: bool = False,
        mass: Scalar = None,
    ) -> None:
        """Create the symbols.

        Args:
            system: The system.
            parts: How many base variables of each kind are integrated or constant.
            weight: Gravity force m g in the root joint's fixed frame, (3,), if it rotates the base.
            lifted: See Structure.
            mass: Mass of the system, if it is a variable parameter.
        """
        self._lifted = lifted
        self._k, self._r = system.group.linear, system.r
        self._mass = system.mass if mass is None else mass
        self._group, self.parts = system.group, parts
        self._weight = weight
        self._root = root_of(system)
        names = ("attitude", "down", "momentum", "push")
        self.attitude, self.down, self.momentum, self.push = (
            [ca.SX.sym(f"{name}{i}") for i in range(count)]
            for name, count in zip(names, astuple(parts)[:4], strict=True)
        )
        self.b = [*self.attitude, *self.down, *self.momentum, *self.push]
        self.spin = [ca.SX.sym(f"spin{i}") for i in range(parts.spin)]

    def body_momentum(self) -> list[Scalar]:
        """Return μ relative to the centre of mass, in body axes; its linear part is zero."""
        if self.parts.momentum:
            angular: list[Scalar] = list(self.momentum)
        elif self.parts.spin:
            lifted = self._lifted and self.parts.attitude == 4
            angular = _lift(self.attitude, self.spin) if lifted else self._to_body(self.spin)
        else:
            return [0.0] * self._r
        return [0.0] * self._k + angular

    def body_weight(self) -> Vec | None:
        """Return the gravity force that rotates the base, (3,) in the body frame, or None."""
        if self._weight is None:
            return None
        if self.parts.down:
            norm = ca.sqrt(total([mul(w, w) for w in self._weight]))
            return [mul(norm, d) for d in self.down]
        return self._to_body(self._weight)

    def rates(
        self, xi: list[Scalar], com: Vec, wrench: list[Scalar], weight: Vec | None
    ) -> list[Scalar]:
        """Compute the rates of the base entries b.

        Args:
            xi: Body twist relative to the centre of mass, (r,).
            com: Centre of mass in the body frame, (3,).
            wrench: Wrench at the base's origin, (r,), or empty.
            weight: Gravity force in the body frame, (3,), or None.
        Returns:
            The rates, as many as b has entries.
        """
        rates: list[Scalar] = []
        omega = xi[self._k :]
        if self.parts.attitude == 1:
            rates += omega
        elif self.parts.attitude:
            rates += quaternion_rate(self.attitude, omega)
        if self.parts.down:
            rates += cross(self.down, omega)
        if self.parts.momentum:
            moment: list[Scalar] = [0.0] * self.parts.momentum
            if self.parts.momentum == 3:
                moment = cross(self.momentum, omega)
            if wrench:
                moment = plus(moment, self.about(com, wrench))
            if weight is not None:
                moment = plus(moment, cross(com, weight))
            rates += moment
        if self.parts.push:
            rates += [mul(1.0 / self._mass, P) for P in self.push[self._k :]]
            rates += self.turned(wrench[: self._k])
        return rates

    def along(self, com: Vec) -> list[Scalar]:
        """Return the components (k,) of the centre of mass along the group's translations."""
        axes = self._root.axes.T.tolist()
        return [dot(axis, com) for axis in axes]

    def about(self, com: Vec, wrench: list[Scalar]) -> list[Scalar]:
        """Return the angular part N − c × F of a wrench or momentum about the centre of mass c."""
        moment = self._moment(com, wrench[: self._k])
        return [sub(a, b) for a, b in zip(wrench[self._k :], moment, strict=True)]

    def turned_angular(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate the angular part of a twist or momentum from the body to the fixed frame."""
        return rotated(self.attitude, v, 1.0) if len(v) == 3 else list(v)

    def full(
        self, xi: list[Scalar], mu: list[Scalar], com: Vec, t: Scalar, com_path: list[Scalar]
    ) -> FullBase:
        """Compute the full state of the base from quantities relative to the centre of mass.

        Args:
            xi: Body twist relative to the centre of mass, (r,).
            mu: Body momentum relative to the centre of mass, (r,).
            com: Centre of mass in the body frame, (3,).
            t: Time.
            com_path: Centre-of-mass path (c0, v0, g), (3k,).
        Returns:
            The full state.
        """
        k, m = self._k, self._mass
        c0, v0, g = com_path[:k], com_path[k : 2 * k], com_path[2 * k :]
        c = [c0[i] + v0[i] * t + 0.5 * g[i] * t * t for i in range(k)]
        P = [m * (v0[i] + g[i] * t) for i in range(k)]
        if self.push:
            c = plus(c, self.push[:k])
            P = plus(P, self.push[k:])
        shift, about = self.along(com), mu[k:]
        norm = ca.sqrt(sum(a * a for a in self.attitude)) if len(self.attitude) == 4 else 1.0
        position = [sub(a, b) for a, b in zip(c, self.turned(shift), strict=True)]
        body_P = self._linear_to_body(P)
        origin = (self._root.origin @ self._root.axes).tolist()
        spatial = self.turned_angular(about)
        return FullBase(
            pose=position + [a / norm for a in self.attitude],
            xi=[add(a, mul(1.0 / m, b)) for a, b in zip(xi, body_P, strict=False)] + xi[k:],
            body_momentum=body_P + plus(self._moment(self._in_space(shift), body_P), about),
            spatial_momentum=P + plus(self._moment(self._in_space(c), P), spatial),
            energy=0.5 / m * dot(P, P) - m * dot(g, plus(c, origin)),
        )

    def _in_space(self, v: list[Scalar]) -> Vec:
        """Return the linear part (k,) of a twist or momentum as a vector in space, (3,)."""
        vector: Vec = [0.0, 0.0, 0.0]
        for axis, entry in zip(self._group.axes, v, strict=False):
            vector[axis] = entry
        return vector

    def _moment(self, c: Vec, P: list[Scalar]) -> list[Scalar]:
        """Return the components of c × P about the group's rotation axes; c is (3,), P is (k,)."""
        moment = cross(c, self._in_space(P))
        return [moment[axis - 3] for axis in self._group.axes[self._k :]]

    def _to_body(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate an angular part, or any vector (3,), from the fixed to the body frame."""
        return rotated(self.attitude, v, -1.0) if len(v) == 3 else list(v)

    def turned(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate the linear part of a twist or momentum from the body to the fixed frame."""
        if self._group.plane:
            *normal, x, y = v
            c, s = ca.cos(self.attitude[0]), ca.sin(self.attitude[0])
            return [*normal, sub(mul(c, x), mul(s, y)), add(mul(s, x), mul(c, y))]
        return self.turned_angular(v) if self._group.turns == 3 else list(v)

    def _linear_to_body(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate the linear part of a twist or momentum from the fixed to the body frame."""
        if self._group.plane:
            *normal, x, y = v
            c, s = ca.cos(self.attitude[0]), ca.sin(self.attitude[0])
            return [*normal, add(mul(c, x), mul(s, y)), sub(mul(c, y), mul(s, x))]
        return self._to_body(v) if self._group.turns == 3 else list(v)


def rotated(q: list[Scalar], v: list[Scalar], sign: float) -> list[Scalar]:
    """Rotate a vector by a quaternion of any norm.

    Args:
        q: Quaternion (x, y, z, w).
        v: Vector, (3,).
        sign: 1 for R v, −1 for Rᵀ v.
    Returns:
        The rotated vector, (3,).
    """
    u, w = [mul(sign, c) for c in q[:3]], q[3]
    scale = 2.0 / (sum(c * c for c in u) + w * w)
    t = cross(u, v)
    u_t = cross(u, t)
    return [add(v[i], mul(scale, add(mul(w, t[i]), u_t[i]))) for i in range(3)]


def _lift(q: list[Scalar], v: list[Scalar]) -> list[Scalar]:
    """Return q̄ v q = |q|² Rᵀ v for a quaternion (x, y, z, w)."""
    u, w = [mul(-1.0, c) for c in q[:3]], q[3]
    square = add(dot(u, u), mul(w, w))
    t = cross(u, v)
    u_t = cross(u, t)
    return [add(mul(square, v[i]), mul(2.0, add(mul(w, t[i]), u_t[i]))) for i in range(3)]


@dataclass(frozen=True)
class CasadiFunctions:
    """Reduced quantities as CasADi Functions of the shape x, (nx,).

    The quaternion (x, y, z, w) of a ball takes four entries of x and must have length one.
    Velocities and momenta have three entries for each ball, along the axes of its child.  In the
    reduced state y, balls follow hinges and slides: first the momenta of all balls, three for each,
    then their quaternions, four for each (`layout.balls_at` is the index of the first).

    Attributes:
        mass_matrix: Mass matrix H(x), (n, n).
        locked_inertia: Locked inertia I(x), (r, r).
        local_connection: Local connection A(x), (r, m).
        reduced_metric: Reduced metric M(x), (m, m).
        curvature: Curvature B of the connection, (r, m²); column α m + β is B_αβ.
        vector_field: Reduced equations (y, parameters) → dy/dt, with nonzero momentum and
            without forces.
        vector_field_jacobian: Jacobian of the vector field with respect to y.
        layout: Layout of y and of the parameters.
    """

    mass_matrix: ca.Function
    locked_inertia: ca.Function
    local_connection: ca.Function
    reduced_metric: ca.Function
    curvature: ca.Function
    vector_field: ca.Function
    vector_field_jacobian: ca.Function
    layout: Layout


@checks_arguments
def casadi_functions(system: System) -> CasadiFunctions:
    """Build the CasADi Functions of a system.

    Args:
        system: The system.
    Returns:
        The Functions.
    Raises:
        UnsupportedOperationError: The system has closed loops.
    """
    system.refuse_loops(
        "casadi_functions",
        "Use flow, or the functions of system.open_tree() with the Jacobian of the loops.",
    )
    terms = casadi_reduction(system)
    graph = ReducedGraph(system, Structure(zero_momentum=False))
    field = graph.rate()
    rate = field(graph.y, graph.parameters)

    def function(name: str, value: ca.SX) -> ca.Function:
        return ca.Function(name, [terms.x], [value], ["x"], [name])

    return CasadiFunctions(
        mass_matrix=function("mass_matrix", terms.H),
        locked_inertia=function("locked_inertia", terms.I),
        local_connection=function("local_connection", terms.A),
        reduced_metric=function("reduced_metric", terms.M),
        curvature=function("curvature", terms.B),
        vector_field=field,
        vector_field_jacobian=ca.Function(
            "vector_field_jacobian", [graph.y, graph.parameters], [ca.jacobian(rate, graph.y)]
        ),
        layout=graph.layout,
    )

"""The reduced vector field of a robot and a kind of scene, as CasADi expressions.

The graph contains nothing that a scene does not need.  The reduced state is

    y = (x, π) of the active joints, x of the cyclic joints, the parts of the base that are
        integrated, and the time, if anything depends on it

and the parameters are the angular momentum of the base where it is a constant, the momenta
of the cyclic joints, gravity where it acts [m/s²], the numbers of bodies that are freed, start,
velocity and fall of the centre of mass where forces see these, and the numbers in the forces.
A joint is cyclic if nothing depends on its angle and nothing acts on it: then its momentum is
constant.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from ..forces.force_model import ForceModel
from ..forces.robot_symbols import numbers_in
from ..reduction.base_parts import root_of
from ..reduction.tree.all_joints import joint_rates, joint_values
from ..reduction.tree.articulated_sweep import sweep
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.free_bodies import total_mass, with_free
from ..reduction.tree.limbs import Lanes
from ..reduction.tree.momenta import centre_of_mass
from ..reduction.tree.scalars import Scalar, Vec, add, dot, mul, sub
from ..system.system import System
from .base_graph import BaseGraph
from .layout import Structure, layout_of, separate_fields


class ReducedGraph:
    """The expressions of one system under one structure, with forces on it."""

    def __init__(
        self,
        system: System,
        structure: Structure,
        forces: ForceModel | None = None,
        lanes: Lanes | None = None,
    ) -> None:
        """Build the sweep.

        lanes: if given, limbs of one build are computed at once, and the Functions are for
        `compile_object` with the marks of `lanes` alone.
        """
        self.system, self.forces, self._lanes = system, forces, lanes
        self._freed, own = (
            structure.freed,
            [ca.SX.sym(f"Y{k}") for k in range(structure.freed.size)],
        )
        self._own = own  # numbers of the robot
        self._bodies = with_free(bodies_of(system), structure.freed, own)
        self._mass = total_mass(self._bodies) if structure.freed.inertias else system.mass
        group, m = system.group, system.m
        self.layout = layout_of(system, structure, forces)
        self._gravity = [ca.SX.sym(f"g{axis}") for axis in structure.gravity]
        self._weight = self._weight_of(structure)
        self.x = [ca.SX.sym(f"x{k}") for k in range(m)]
        self.pi = [ca.SX.sym(f"pi{k}") for k in range(m)]
        turned = self._weight if self.layout.heavy else None
        self.base = BaseGraph(
            system, self.layout.base, turned, lifted=structure.lifted, mass=self._mass
        )
        self._t = ca.SX.sym("t")
        prescribed = self.layout.prescribed
        self._line = [ca.SX.sym(f"line{k}") for k in range(self.layout.line)]
        self._numbers = [ca.SX.sym(f"p{k}") for k in range(self.layout.numbers)]
        self._angles = ca.vertcat(ca.SX(0, 1), *self.x)  # by which energies are differentiated
        given = self._given()
        for k, place in zip(prescribed, given, strict=False):
            self.x[k] = place
        self._mu = mu = self.base.body_momentum()
        armature = float(system.model.armature[0])  # zero for all but one axis
        # Nothing depends on the angle of a cyclic joint, so it may as well be zero.
        angles: list[Scalar] = [0.0 if k in structure.cyclic else self.x[k] for k in range(m)]
        rates = dict(zip(prescribed, given[len(prescribed) :], strict=True))
        found = sweep(
            self._bodies, joint_values(system, angles), self.pi, mu, group.axes, armature, rates,
            lanes, system.coupled,
        )  # fmt: skip
        self.xi: list[Scalar] = [
            [*found.root_linear, *found.root_angular][axis] for axis in group.axes
        ]
        self.xdot: list[Scalar] = found.xdot
        self._driven_pi = {k: found.pi[k] for k in prescribed}
        torque, acting = self._acting(mu)
        pidot = [add(p, t) for p, t in zip(found.pidot, torque, strict=True)]
        self.pidot = self._with_loads(pidot, acting)
        weight = self.base.body_weight()
        self._base_rate = self.base.rates(self.xi, self.com(), acting, weight)

    @cached_property
    def y(self) -> ca.SX:
        """The reduced state, (size,)."""
        active, cyclic = self.layout.active, self.layout.cyclic
        return _column(
            [self.x[k] for k in active],
            [self.pi[k] for k in active],
            [self.x[k] for k in cyclic],
            self.base.b,
            [self._t] * self.layout.clock,
        )

    @cached_property
    def parameters(self) -> ca.SX:
        """The parameters, (parameters,)."""
        constant = [self.pi[k] for k in self.layout.cyclic]
        free = (*self._gravity, *self._own, *self._line)
        return _column(self.base.spin, constant, list(free), self._numbers)

    def rate(self) -> ca.Function:
        """Return the vector field (y, parameters) → dy/dt."""
        active, cyclic = self.layout.active, self.layout.cyclic
        rate = _column(
            [self.xdot[k] for k in active],
            [self.pidot[k] for k in active],
            [self.xdot[k] for k in cyclic],
            self._base_rate,
            [1.0] * self.layout.clock,
        )
        return self._function("rate", rate, [self.y, self.parameters])

    def outputs(self) -> ca.Function:
        """Return ((y, t), (parameters, c0, v0, g)) → everything of Outputs.

        The time is not repeated where it is the last number of y.  c0, v0, g: (k,) start,
        velocity and fall of the centre of mass, in the root joint's fixed frame.
        """
        system, k = self.system, self.system.group.linear
        com, places = self.com(), [self.x[j] for j in self.layout.prescribed]
        momenta = [self._driven_pi.get(j, self.pi[j]) for j in range(system.m)]
        about = self._mu[k:]
        energy = mul(0.5, add(dot(self.xi[k:], about), dot(self.xdot, momenta)))
        energy = add(energy, self._potential(com))
        weight: list[Scalar] = self.base.body_weight() or []
        parts = [self.xi, self.xdot, com, self._mu, weight]
        parts += [places, list(self._driven_pi.values())]
        fields: dict[str, list[Scalar]] = {"x": self.x}
        line = [ca.SX.sym(f"line{j}") for j in range(3 * k)]
        if self.layout.wanted:
            full = self.base.full(self.xi, self._mu, com, self._t, line)
            fields["pose"], fields["q"] = full.pose, self._q(full.pose)
            fields["v"] = [*full.xi, *joint_rates(system, self.xdot)]
            fields["body_momentum"] = full.body_momentum
            fields["spatial_momentum"] = full.spatial_momentum
            energy = add(energy, full.energy)
        fields["energy"] = [energy]
        parts += [fields[name] for name in separate_fields(base=self.layout.wanted)]
        y = self.y if self.layout.clock else ca.vertcat(self.y, self._t)
        inputs = [y, ca.vertcat(self.parameters, *line)]
        return self._function("outputs", _column(*parts), inputs)

    def _potential(self, com: Vec) -> Scalar:
        """Return V(x), and the potential energy of a pivoted body's weight."""
        energy: Scalar = 0.0
        if self.forces is not None:
            value = self.forces.potential_function(_column(self.x), _column(self._numbers))
            energy = add(energy, _scalars(value)[0])
        if self._weight is not None:
            weight = self.base.body_weight() or self._weight
            origin = dot(self._weight, root_of(self.system).origin.tolist())
            energy = sub(energy, add(dot(weight, com), origin))
        return energy

    def _q(self, pose: list[Scalar]) -> list[Scalar]:
        """Return Pinocchio's configuration."""
        y, q = [*pose, *joint_values(self.system, self.x)], [0.0] * self.system.model.nq
        for i, at in self.system.plain:
            q[at] = y[i]
        for i, at in self.system.angles:
            q[at], q[at + 1] = ca.cos(y[i]), ca.sin(y[i])
        return q

    def _function(self, name: str, value: ca.SX, inputs: list[ca.SX]) -> ca.Function:
        if self._lanes is not None:
            return self._lanes.function(name, inputs, value)
        return ca.Function(name, inputs, [ca.densify(value)], {"cse": True})

    def _weight_of(self, structure: Structure) -> Vec | None:
        """Return the weight m g that acts on the shape or turns a pivoted base, if there is one."""
        weight: Vec = [0.0, 0.0, 0.0]
        for axis, g in zip(structure.gravity, self._gravity, strict=True):
            weight[axis] = mul(self._mass, g)
        return weight if structure.gravity else None

    def com(self) -> Vec:
        """Return the centre of mass in the root body's own frame, from the joints' placements."""
        return centre_of_mass(self._bodies, joint_values(self.system, self.x))

    def _given(self) -> list[Scalar]:
        """Return positions and then rates of the prescribed joints."""
        if self.forces is None or not self.layout.prescribed:
            return []
        x, xdot, _ = self.forces.prescribed_function(self._t, _column(self._numbers))
        return _scalars(x) + _scalars(xdot)

    def _acting(self, mu: list[Scalar]) -> tuple[list[Scalar], list[Scalar]]:
        """Return torques (m,) and the wrench, (r,) or none, of the forces."""
        if self.forces is None:
            return [0.0] * self.system.m, []
        seen, robot = self._in_space(mu), self._robot(self.forces)
        columns = (self.x, self.xdot, self.xi, mu, self._numbers, *seen, robot)
        state = [_column(list(column)) for column in columns]
        torque, wrench = self.forces.acting_function(self._t, *state)
        on_base = _scalars(wrench) if self.forces.has_wrench else []
        return _scalars(torque), on_base

    def _robot(self, forces: ForceModel) -> list[Scalar]:
        """Return the numbers of the robot as forces take them; those that fold here fold there."""
        links = {frame: self._own[self._freed.of_link(frame)] for frame in self._freed.links}
        gravity: Vec = [0.0, 0.0, 0.0]
        for axis, g in zip(self.layout.gravity, self._gravity, strict=True):
            gravity[axis] = g
        return [*numbers_in(self._bodies, self.system, forces.freed, links), *gravity]

    def _in_space(self, mu: list[Scalar]) -> list[list[Scalar]]:
        """Return pose, body twist, body and spatial momentum, if a force sees any of it."""
        group, forces = self.system.group, self.forces
        if forces is None or not (forces.sees_attitude or forces.sees_place):
            return [[0.0] * group.size, *([0.0] * group.dim for _ in range(3))]
        line: list[Scalar] = [*self._line] or [0.0] * (3 * group.linear)
        full = self.base.full(self.xi, mu, self.com(), self._t, line)
        return [full.pose, full.xi, full.body_momentum, full.spatial_momentum]

    def _with_loads(self, pidot: list[Scalar], acting: list[Scalar]) -> list[Scalar]:
        """Add the forces of weight and wrench on the shape: −∂/∂x of F·c, in the body's frame.

        The weight pulls at the centre of mass; a force on the base moves the frame of the
        centre of mass, in which the shape is pushed the other way.
        """
        m = self.system.m
        angles = joint_values(self.system, ca.vertsplit(self._angles) if m else [])
        com = centre_of_mass(self._bodies, angles)
        loads: list[tuple[Scalar, Scalar]] = []  # of each coordinate of c: name and value
        energy: Scalar = 0.0
        pairs = list(zip(acting, self.base.along(com), strict=False))  # the linear part
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
        slope = ca.gradient(energy, self._angles)
        names, values = _column([s for s, _ in loads]), _column([v for _, v in loads])
        (slope,) = ca.substitute([slope], [names, self._angles], [values, _column(self.x)])
        return [add(pidot[k], mul(-1.0, slope[k])) for k in range(m)]


def _column(*parts: list[Scalar]) -> ca.SX:
    entries = [entry for part in parts for entry in part]
    return ca.vertcat(*entries) if entries else ca.SX(0, 1)


def _scalars(column: ca.SX) -> list[Scalar]:
    """Return the entries of a column; constants as floats, so that zeros fold away."""
    parts = [column[k] for k in range(column.numel())]
    return [float(part) if part.is_constant() else part for part in parts]

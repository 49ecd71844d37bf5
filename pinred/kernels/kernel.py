"""The compiled kernel: its structure, the layout of its states, parameters and outputs, and calls.

Compiled functions evaluate kernels and their derivatives at many states, along many directions.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise, starmap

import numpy as np

from ..common.arrays import Array
from ..common.machine_code import NativeCode
from ..forces.force_model import ForceModel
from ..integrators.stepping.compiling import compiled
from ..integrators.stepping.intrinsics import (
    SEEDS,
    call,
    call_adjoint,
    call_slopes,
    call_tangent,
    from_lanes,
    to_lanes,
)
from ..integrators.stepping.run_state import Canonical
from ..lie.rotations import quaternion_product
from ..reduction.base_parts import BaseParts, base_parts
from ..reduction.tree.free_bodies import NOTHING, Freed, free_numbers
from ..system.state_fields import FIELDS, axis_lengths
from ..system.system import System


@dataclass(frozen=True)
class Structure:
    """The structure of a kernel; together with the forces, it determines which terms exist.

    With `lifted`, a quaternion q of any norm represents the angular momentum: μ = q̄ J q for the
    constant angular momentum J in the fixed frame, so μ is quadratic in q.  Under this map of
    Cayley and Klein from ℝ⁴ to so(3)*, the canonical bracket becomes the Lie–Poisson bracket.
    A symplectic method for (x, π, q) is then a Poisson map of (x, π, μ).

    With `lifted_balls`, the attitude q of a ball has a conjugate momentum p in ℝ⁴, and
    π = ½ E(q)ᵀ p with E(q) e = q ∘ (e, 0).  The pair (q, p) is canonical, and |q|² and q · p are
    invariants.

    Attributes:
        zero_momentum: Whether the momentum of the base is exactly zero.
        cyclic: Indices of the cyclic joints.
        rotors: Indices of the first rates of the spherical rotors.
        axial: Indices of the rates of balls along an axis of symmetry of their body.
        gravity: Indices of the axes of the root joint's fixed frame along which gravity acts on the
            shape or rotates a pivoted base.
        base: Whether the outputs contain the state of the base.
        lifted: Whether a quaternion of any norm represents the angular momentum.
        lifted_balls: Whether the quaternions of balls have conjugate momenta.
        freed: Variable body parameters: inertias, joint placements and link placements.
    """

    zero_momentum: bool = True
    cyclic: tuple[int, ...] = ()
    gravity: tuple[int, ...] = ()
    base: bool = True
    lifted: bool = False
    lifted_balls: bool = False
    freed: Freed = NOTHING
    rotors: tuple[int, ...] = ()
    axial: tuple[int, ...] = ()


@dataclass(frozen=True)
class Layout:
    """The order of the entries in the reduced state y and in the parameters.

    Joints are given by the indices of their rates.  The reduced state is, in this order: positions
    and momenta of the active joints, positions of the cyclic joints, momenta and then quaternions
    of the balls, the base, and the time.  Lifted balls count as active: their quaternions follow
    the positions, and their conjugate momenta follow the momenta.  Constant momenta of balls, whose
    body is symmetric, are parameters, as are those of cyclic joints.

    Attributes:
        active: Hinges and slides whose positions and momenta are integrated.
        cyclic: Cyclic joints.
        prescribed: Prescribed joints, three rates for a ball.
        prescribed_x: Indices in x of the prescribed joints.
        balls: Integrated ball joints, each with the indices of its first coordinate and first rate.
        rotors: Indices of the first rates of the spherical rotors, which are balls, too.
        axial: Indices of the rates of balls along an axis of symmetry of their body.
        lifted_balls: Whether the quaternions of balls have conjugate momenta.
        coordinates: Index in x of the coordinate of each rate, (m,); −1 for rates of balls.
        base: Numbers of integrated and constant entries of the base.
        base_requested: Whether the outputs contain the state of the base.
        gravity_on_base: Whether gravity rotates a pivoted base.
        clock: 1 if the time is the last entry of y, else 0.
        gravity: Indices of the axes along which the gravity component is a parameter.
        freed: Variable body parameters.
        com_path: Number of parameters for the centre-of-mass path: 3k if forces depend on the
            path, else 0.
        numbers: Number of force parameters.
    """

    active: tuple[int, ...]
    cyclic: tuple[int, ...]
    prescribed: tuple[int, ...]
    prescribed_x: tuple[int, ...]
    balls: tuple[tuple[int, int], ...]
    rotors: tuple[int, ...]
    axial: tuple[int, ...]
    lifted_balls: bool
    coordinates: tuple[int, ...]
    base: BaseParts
    base_requested: bool
    gravity_on_base: bool
    clock: int
    gravity: tuple[int, ...]
    freed: Freed
    com_path: int
    numbers: int

    @cached_property
    def active_x(self) -> list[int]:
        """Indices in x of the active joints."""
        return [self.coordinates[k] for k in self.active]

    @cached_property
    def cyclic_x(self) -> list[int]:
        """Indices in x of the cyclic joints."""
        return [self.coordinates[k] for k in self.cyclic]

    @cached_property
    def ball_x(self) -> list[int]:
        """Indices in x of the quaternions of integrated balls, four for each."""
        return [x + k for x, _ in self.balls for k in range(4)]

    @cached_property
    def ball_v(self) -> list[int]:
        """Indices in ẋ of the rates of integrated balls, three for each."""
        return [v + k for _, v in self.balls for k in range(3)]

    @cached_property
    def ball_pi(self) -> list[int]:
        """Indices in π of the momenta of balls in y, which are not constant."""
        return [k for k in self.ball_v if k not in self.constant_pi]

    @cached_property
    def constant_pi(self) -> list[int]:
        """Indices in π of the constant momenta: of cyclic joints, rotors, axes of symmetry."""
        return [*self.cyclic, *(v + k for v in self.rotors for k in range(3)), *self.axial]

    @cached_property
    def pairs(self) -> int:
        """Number of positions in y that are followed by as many conjugate momenta."""
        return len(self.active) + (4 * len(self.balls) if self.lifted_balls else 0)

    @cached_property
    def balls_at(self) -> int:
        """Index in y of the first momentum of balls that are not lifted."""
        return 2 * self.pairs + len(self.cyclic)

    @cached_property
    def base_at(self) -> int:
        """Index in y of the first base entry."""
        return self.balls_at + (0 if self.lifted_balls else len(self.ball_pi) + len(self.ball_x))

    def shape_entries(self, x: Array, pi: Array) -> list[Array]:
        """Return the entries of y before the base.

        Args:
            x: Shapes, (..., nx), with quaternions of length one.
            pi: Canonical momenta, (..., m).
        Returns:
            Blocks (..., k), in the order of y.
        """
        active = list(self.active)
        positions, momenta = [x[..., self.active_x]], [pi[..., active]]
        if self.lifted_balls:
            positions += [x[..., at : at + 4] for at, _ in self.balls]
            momenta += [
                conjugate_momentum(x[..., at : at + 4], pi[..., v : v + 3]) for at, v in self.balls
            ]
        blocks = [*positions, *momenta, x[..., self.cyclic_x]]
        if self.balls and not self.lifted_balls:
            blocks += [pi[..., self.ball_pi], x[..., self.ball_x]]
        return blocks

    @cached_property
    def size(self) -> int:
        """Length of y."""
        return self.base_at + self.base.size + self.clock

    @cached_property
    def parameters(self) -> int:
        """Number of parameters."""
        return self.com_path_at + self.com_path + self.numbers

    @property
    def bodies_at(self) -> int:
        """Index in the parameters of the first body parameter."""
        return self.gravity_at + len(self.gravity)

    @property
    def gravity_at(self) -> int:
        """Index in the parameters of the first gravity component."""
        return self.base.spin + len(self.constant_pi)

    @property
    def com_path_at(self) -> int:
        """Index in the parameters of the first centre-of-mass path entry."""
        return self.bodies_at + self.freed.size

    @property
    def quaternions(self) -> tuple[int, int]:
        """Index in y of the first quaternion entry, and number of quaternions; (0, 0) for none.

        The quaternions of balls come directly before the base's.  Lifted ones are not counted,
        because they have no redundant entry.
        """
        balls = 0 if self.lifted_balls else len(self.balls)
        count = balls + (self.base.attitude == 4)
        return (self.base_at - 4 * balls, count) if count else (0, 0)


def conjugate_momentum(q: Array, pi: Array) -> Array:
    """Return the momentum p = 2 q ∘ (π, 0), (..., 4), of a unit quaternion q, with q · p = 0."""
    real = np.zeros((*pi.shape[:-1], 1))
    return 2.0 * quaternion_product(q, np.concatenate([pi, real], axis=-1))


def layout_of(system: System, structure: Structure, forces: ForceModel | None) -> Layout:
    """Compute the layout of the reduced state and of the parameters.

    Args:
        system: The system.
        structure: Structure of the kernel.
        forces: Forces on the system, or None.
    Returns:
        The layout.
    """
    prescribed = forces.joints if forces is not None else ()
    heavy = system.group.is_pivot and bool(structure.gravity)
    base_observed = forces is not None and (forces.sees_attitude or forces.sees_place)
    base = base_parts(
        system.group,
        wanted=structure.base or structure.lifted or base_observed,
        heavy=heavy,
        wrench=forces is not None and forces.has_wrench,
        zero_momentum=structure.zero_momentum,
    )
    coordinates = np.full(system.m, -1)
    coordinates[system.space.scalar_v] = system.space.scalar_x
    not_active = {*structure.cyclic, *prescribed, *system.space.ball_v.tolist()}
    return Layout(
        active=tuple(k for k in range(system.m) if k not in not_active),
        cyclic=structure.cyclic,
        prescribed=prescribed,
        prescribed_x=tuple(system.space.coordinates_of_joints(prescribed)),
        balls=tuple(
            (joint.x.start, joint.v.start)
            for joint in system.space.balls
            if joint.v.start not in prescribed
        ),
        rotors=structure.rotors,
        axial=structure.axial,
        lifted_balls=structure.lifted_balls,
        coordinates=tuple(coordinates.tolist()),
        base=base,
        base_requested=structure.base,
        gravity_on_base=heavy,
        clock=int(forces is not None and forces.needs_time),
        gravity=structure.gravity,
        freed=structure.freed,
        com_path=3 * system.group.linear if forces is not None and forces.sees_place else 0,
        numbers=len(forces.numbers) if forces is not None else 0,
    )


@dataclass(frozen=True)
class Outputs:
    """Slices of the outputs of a kernel.

    Attributes:
        xi: Body twist relative to the centre of mass, (r,).
        xdot: Shape rate, (m,).
        com: Centre of mass in the frame of the root body, (3,).
        mu: Body momentum about the centre of mass, (r,).
        weight: Gravity force that rotates a pivoted base, in the body frame, (3,) or empty.
        driven_x: Coordinates of the prescribed joints, (kx,).
        driven_pi: Canonical momenta of the prescribed joints, (k,).
        fields: All fields of State except the time; of ShapeState if the base is not requested.
        size: Number of outputs.
    """

    xi: slice
    xdot: slice
    com: slice
    mu: slice
    weight: slice
    driven_x: slice
    driven_pi: slice
    fields: Mapping[str, slice]
    size: int


def in_given_order(name: str, values: Array, system: System) -> Array:
    """Convert entries of the outputs to a field of State, with joints in the robot's order.

    Args:
        name: Name of the field, except "t".
        values: Its entries, (…, length of the field's axis), or (…, 1) for scalars.
        system: The system of the kernel.
    Returns:
        The field.
    """
    match FIELDS[name].axis:
        case "nq":
            return system.given_q(values)
        case "nv":
            return system.given_v(values)
        case None:
            return values[..., 0]
        case _:
            return values


def separate_fields(*, base: bool) -> list[str]:
    """Return the fields of State that have separate entries in the outputs, in order.

    The shape rate is always an output, and the body twist is the first part of the field v, so
    neither is among the separate fields.
    """
    shared = ("t", "xdot", "xi")
    return [f.name for f in FIELDS.values() if f.name not in shared and (base or not f.needs_base)]


def outputs_of(system: System, layout: Layout) -> Outputs:
    """Compute the slices of a kernel's outputs.

    Args:
        system: The system.
        layout: Layout of the kernel.
    Returns:
        The slices.
    """
    m, r, driven = system.m, system.r, (len(layout.prescribed_x), len(layout.prescribed))
    names, lengths = separate_fields(base=layout.base_requested), axis_lengths(system)
    relative = [r, m, 3, r, 3 * layout.gravity_on_base, *driven]
    ends = list(accumulate([*relative, *(lengths[FIELDS[name].axis] for name in names)], initial=0))
    xi, xdot, com, mu, weight, driven_x, driven_pi, *slices = starmap(slice, pairwise(ends))
    fields = {**dict(zip(names, slices, strict=True)), "xdot": xdot}
    if layout.base_requested:
        fields["xi"] = slice(fields["v"].start, fields["v"].start + r)
    return Outputs(xi, xdot, com, mu, weight, driven_x, driven_pi, fields, ends[-1])


_POINTER = ctypes.POINTER(ctypes.c_double)
_SIGNATURE = ctypes.CFUNCTYPE(None, _POINTER, _POINTER, _POINTER)


@dataclass(frozen=True)
class Kernel:
    """Machine code of a reduced vector field and of its outputs.

    Attributes:
        system: The system.
        structure: Structure of the reduced equations.
        forces: Forces on the system, or None.
        layout: Layout of the reduced state y and of the parameters.
        rate: Machine code (y, parameters) → dy/dt.
        outputs: Machine code ((y, t), (parameters, c0, v0, g)) → all fields of Outputs.
        instructions: Number of arithmetic operations of `rate`.
        closing: Machine code that closes loops at step ends, for methods with multipliers; the
            rates are then those of the open tree (see build.py).
    """

    system: System
    structure: Structure
    forces: ForceModel | None
    layout: Layout
    rate: NativeCode
    outputs: NativeCode
    instructions: int
    closing: NativeCode | None = None

    @property
    def canonical(self) -> Canonical:
        """Pairs of positions and momenta, constant angular momenta, and the closing of loops."""
        closing = 0 if self.closing is None else self.closing.address
        return Canonical(self.layout.pairs, self.layout.base.spin, closing)

    @cached_property
    def _rate(self) -> Callable[..., None]:
        return _SIGNATURE(self.rate.address)

    @cached_property
    def _outputs(self) -> Callable[..., None]:
        return _SIGNATURE(self.outputs.address)

    def random_parameters(self, rng: np.random.Generator) -> Array:
        """Draw random parameters for the comparison of derived code with this kernel.

        Args:
            rng: Random number generator.
        Returns:
            (p,): random spin, gravity and force parameters, with the body parameters of the robot.
        """
        layout = self.layout
        parameters = rng.normal(size=layout.parameters)
        bodies = free_numbers(self.system, layout.freed)
        parameters[layout.bodies_at : layout.bodies_at + len(bodies)] = bodies
        if self.forces is not None:
            parameters[layout.parameters - layout.numbers :] = self.forces.random_numbers(rng)
        return parameters

    def evaluate_rate(self, y: Array, parameters: Array) -> Array:
        """Evaluate the reduced vector field.

        Args:
            y: Reduced state, (size,).
            parameters: Parameters, (p,).
        Returns:
            (size,): dy/dt.
        """
        return self._call(self._rate, y, parameters, self.layout.size)

    def evaluate_outputs(self, t: float, y: Array, parameters: Array, com_path: Array) -> Array:
        """Evaluate the outputs at a time.

        Args:
            t: Time [s].
            y: Reduced state, (size,).
            parameters: Parameters, (p,).
            com_path: Centre-of-mass path (c0, v0, g), (3k,) [m, m/s, m/s²].
        Returns:
            (where.size,): all fields of Outputs.
        """
        y = y if self.layout.clock else np.append(y, t)
        return self._call(self._outputs, y, np.append(parameters, com_path), self.where.size)

    @cached_property
    def where(self) -> Outputs:
        """Slices of the kernel's outputs."""
        return outputs_of(self.system, self.layout)

    @staticmethod
    def _call(function: Callable[..., None], y: Array, parameters: Array, size: int) -> Array:
        y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
        values = np.empty(size)
        function(*(array.ctypes.data_as(_POINTER) for array in (y, parameters, values)))
        return values


def evaluate(
    address: int, parameters: Array, y: Array, size: int, out: Array | None = None
) -> Array:
    """Evaluate a kernel at several states, with common or separate parameters.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (p,) for all states, or (T, p) for each state.
        y: States, (T, k).
        size: Number of outputs of the kernel.
        out: Array (T, size) for the values; a new one if None.
    Returns:
        (T, size): the values.
    """
    values = np.empty((len(y), size)) if out is None else out
    rows = np.ascontiguousarray(np.atleast_2d(parameters))
    stride = 0 if parameters.ndim == 1 else 1  # rows between the parameters of successive states
    _evaluate_all(address, rows, np.ascontiguousarray(y), values, stride)
    return values


def evaluate_row(address: int, parameters: Array, y: Array, values: Array) -> None:
    """Evaluate a kernel at one state, without the checks and copies of `evaluate`.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (1, p).
        y: State, (1, k).
        values: Outputs, (1, size), filled.
    """
    _evaluate_all(address, parameters, y, values, 0)


def evaluate_runs(
    address: int, constants: Array, y: Array, times: Array, entries: int, values: Array
) -> None:
    """Evaluate the outputs of N runs at common times.

    Args:
        address: Address of the machine code.
        constants: Constants of each run, (N, p).
        y: States, (N, T, k).
        times: Times, (T,), the last input of the code [s]; empty if the states contain the time.
        entries: Number of entries of a state that are inputs of the code.
        values: Outputs, (N, T, size), filled.
    """
    row = np.zeros(entries + 1)
    _evaluate_runs(
        address, np.ascontiguousarray(constants), np.ascontiguousarray(y), times, entries, row,
        values,
    )  # fmt: skip


@compiled
def _evaluate_runs(
    address: int,
    constants: Array,
    y: Array,
    times: Array,
    entries: int,
    row: Array,
    values: Array,
) -> None:
    has_times = len(times) > 0
    for i in range(y.shape[0]):
        for j in range(y.shape[1]):
            for k in range(entries):
                row[k] = y[i, j, k]
            if has_times:
                row[entries] = times[j]
            call(address, row, constants[i], values[i, j])


def repeat(address: int, parameters: Array, y: Array, count: int) -> None:
    """Evaluate a kernel repeatedly at one state, for timing.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (p,).
        y: State, (k,).
        count: Number of evaluations.
    """
    _repeat(address, parameters, y, np.empty(len(y)), count)


@compiled
def _repeat(address: int, parameters: Array, y: Array, out: Array, count: int) -> None:
    for _ in range(count):
        call(address, y, parameters, out)


@compiled
def _evaluate_all(address: int, parameters: Array, y: Array, out: Array, stride: int) -> None:
    for k in range(len(y)):
        call(address, y[k], parameters[k * stride], out[k])


@compiled
def call_value(address: int, a: Array, b: Array, out: Array) -> None:
    """Evaluate machine code (a, b, result) into `out`.

    Args:
        address: Address of the machine code.
        a: First column.
        b: Second column.
        out: Receives the result.
    """
    call(address, a, b, out)


@compiled
def repeat_adjoint(
    address: int, a: Array, b: Array, covector: Array, out: Array, count: int
) -> None:
    """Evaluate an adjoint repeatedly, for timing.

    Args:
        address: Address of the machine code.
        a: First column.
        b: Second column.
        covector: λ.
        out: Receives the derivatives.
        count: Number of evaluations.
    """
    for _ in range(count):
        call_adjoint(address, a, b, covector, out)


@compiled
def call_forward(address: int, a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
    """Evaluate a tangent (a, b, δa, δb, result) into `out`."""
    call_slopes(address, a, b, da, db, out)


@compiled
def call_at_each(address: int, a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
    """Compute derivatives along batches of SEEDS directions at each of several points.

    Args:
        address: Address of the machine code.
        a: First columns, (N, …).
        b: Second columns, (N, …).
        da: Directions of a, (N or 1, batches, … SEEDS).
        db: Directions of b, (N or 1, batches, … SEEDS).
        out: Receives the derivatives, (N, batches, size SEEDS).
    """
    for i in range(out.shape[0]):
        row_a, row_b = i % da.shape[0], i % db.shape[0]
        for j in range(out.shape[1]):
            call_slopes(address, a[i], b[i], da[row_a, j], db[row_b, j], out[i, j])


@compiled
def call_in_batches(
    address: int,
    a: Array,
    b: Array,
    da: Array,
    db: Array,
    seeds_a: Array,
    seeds_b: Array,
    lanes: Array,
    out: Array,
) -> None:
    """Compute derivatives (size, N) along directions (…, N), SEEDS directions at once."""
    to_lanes(da, seeds_a)
    to_lanes(db, seeds_b)
    for k in range(lanes.shape[0]):
        call_slopes(address, a, b, seeds_a[k], seeds_b[k], lanes[k])
    from_lanes(lanes, out)


@compiled
def call_reverse(address: int, a: Array, b: Array, covector: Array, out: Array) -> None:
    """Evaluate an adjoint (a, b, covector, result) into `out`."""
    call_adjoint(address, a, b, covector, out)


WIDTH = SEEDS  # number of directions that one call evaluates
_ENTRIES = 2**15  # numbers per block, few enough to fit into the CPU's cache


def columns_at(address: int, x: Array, size: int, m: int) -> Iterator[tuple[slice, Array]]:
    """Yield, block by block, the outputs at shapes x, (N, nx), for all unit joint rates u.

    Args:
        address: Address of machine code (x, none, u) → outputs (size,), compiled for WIDTH
            directions.
        x: Shapes, (N, nx) [rad | m].
        size: Number of outputs.
        m: Number of joint rates.
    Yields:
        The slice of x in this block, and its outputs, (count, max(m, 1), size).  Row k of the
        second axis belongs to the unit rate k.  Without joints, its only row belongs
        to the empty rate u = ().
    """
    N, columns = len(x), max(m, 1)
    count = max(1, _ENTRIES // (columns * size))
    none, rates, lanes = np.zeros(1), np.zeros((m, WIDTH)), np.empty((size, WIDTH))
    for start in range(0, N, count):
        chunk = slice(start, start + count)
        shapes = np.ascontiguousarray(x[chunk])
        outputs = np.empty((len(shapes), columns, size))
        _evaluate(address, none, shapes, rates, lanes, outputs)
        yield chunk, outputs


@compiled
def _evaluate(
    address: int, none: Array, x: Array, rates: Array, lanes: Array, outputs: Array
) -> None:
    joints, columns = len(rates), outputs.shape[1]
    for first in range(0, columns, WIDTH):
        width = min(WIDTH, columns - first)
        rates[:] = 0.0
        for lane in range(min(width, joints - first)):
            rates[first + lane, lane] = 1.0
        for k in range(len(x)):
            call_tangent(address, x[k], none, rates, lanes)
            for lane in range(width):
                for i in range(outputs.shape[2]):
                    outputs[k, first + lane, i] = lanes[i, lane]

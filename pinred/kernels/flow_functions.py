"""Functions that a flow map is composed of, with derivatives: initial conditions, rate, outcome.

The initial conditions map an initial state to the reduced state and to the constants of the
motion.  The outcome maps a reduced state to rows of the full state.  The row "pose" contains body
coordinates relative to a reference pose, which is an input.  At the reference pose, these
coordinates are zero, and their derivatives are the body-frame derivatives of the pose.  With balls,
a reference shape is an input, too, and the row "x" contains coordinates relative to it along the
frame.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.machine_code import NativeCode
from ..common.memo import once
from ..reduction.base_parts import into_body
from ..reduction.tree.scalars import quaternion_rate
from ..system.coordinates import ShapeSpace
from ..system.state_fields import Outcome, derivative_rows
from ..system.system import System
from .build import round_off_near
from .differentiable import Differentiable, Sample, values_near
from .initial_conditions import TwistOrMomentum, initial_conditions_graph, initial_conditions_kernel
from .kernel import Kernel, Layout, outputs_of
from .reduced_graph import ReducedGraph, rotated
from .reference_state import ReferenceState, random_state
from .validation import ROUND_OFF, require_agreement

_REACH = 0.5  # size of random states, relative to those at which the kernel itself is compared

# "pose" and "x" are tangent vectors at a reference, "…_numbers" the coordinates themselves.
Row = Outcome | Literal["pose_numbers", "x_numbers"]


def rate_of(kernel: Kernel) -> Differentiable:
    """Return the vector field (y, parameters) → dy/dt with its derivatives.

    Args:
        kernel: The kernel.
    Returns:
        The function, created once for each kernel.
    """
    sample = partial(_sample, kernel)
    return once(
        kernel,
        rate_of,
        lambda: Differentiable(kernel, "rate", ReducedGraph.rate, sample, _accept, limbs=True),
    )


def initial_conditions_of(kernel: Kernel, given: TwistOrMomentum) -> Differentiable:
    """Return the map from an initial state to the reduced initial conditions.

    The map takes ((pose, x, ẋ, ξ or μ), constants) to (y₀, constant momenta, c₀, v₀), with the
    momenta of the base, the cyclic joints and the rotors.  The constants are the kernel's other
    parameters (see ReducedGraph).
    Positions and rates of prescribed joints are replaced by their prescribed values at time zero.

    Args:
        kernel: The kernel.
        given: Whether the initial state contains a body twist ("xi") or a body momentum ("mu").
    Returns:
        The function, created once for each kernel.
    """
    write = partial(_initial_graph, given=given)
    sample = partial(_sample_initial_state, kernel, given)
    validate = partial(_validate_initial_conditions, kernel, given)
    return once(
        kernel,
        (initial_conditions_of, given),
        lambda: Differentiable(kernel, f"initial_{given}", write, sample, validate),
    )


def outcome_of(kernel: Kernel, rows: tuple[Row, ...]) -> Differentiable:
    """Return the map from a reduced state to rows of the full state.

    The map takes ((y, t, reference), (parameters, c₀, v₀, g)) to the rows.  The input t always
    exists, but it is ignored if y ends with the time.  The reference is (x, pose) with balls, else
    the pose.

    Args:
        kernel: The kernel.
        rows: Names of the rows, in order.
    Returns:
        The function, created once for each kernel.
    """
    name, write = f"outcome_{'_'.join(rows)}", partial(_outcome_graph, rows=rows)
    sample = partial(_sample_outcome, kernel, rows)
    return once(
        kernel,
        (outcome_of, rows),
        lambda: Differentiable(kernel, name, write, sample, _accept),
    )


def sizes_of(system: System) -> dict[str, int]:
    """Return the number of entries of each row of an outcome.

    Args:
        system: The system.
    Returns:
        The sizes by name.
    """
    coordinates = {"pose_numbers": system.group.size, "x_numbers": system.nx}
    return derivative_rows(system) | coordinates


def reference_size(system: System) -> int:
    """Return the number of entries of the reference of an outcome.

    Args:
        system: The system.
    Returns:
        The length of (x, pose) with balls, else of the pose.
    """
    return system.group.size + (system.nx if system.space.balls else 0)


def reference_in(kernel: Kernel, outputs: Array) -> Array:
    """Return the references of an outcome, which are parts of a kernel's outputs.

    Args:
        kernel: The kernel.
        outputs: Outputs of the kernel, (…, where.size).
    Returns:
        (…, reference_size); the pose is zero if the outputs leave out the base.
    """
    fields, system = kernel.where.fields, kernel.system
    reference = np.zeros((*outputs.shape[:-1], reference_size(system)))
    if system.space.balls:
        reference[..., : system.nx] = outputs[..., fields["x"]]
    if "pose" in fields:
        reference[..., -system.group.size :] = outputs[..., fields["pose"]]
    return reference


def _initial_graph(graph: ReducedGraph, given: TwistOrMomentum) -> ca.Function:
    system, layout, forces = graph.system, graph.layout, graph.forces
    group, m, r, k = system.group, system.m, system.r, system.group.linear
    cuts = np.cumsum([0, group.size, system.nx, m, r]).tolist()
    state = ca.SX.sym("state", cuts[-1])
    constants = ca.SX.sym("constants", layout.parameters - layout.gravity_at)
    pose, x, xdot, motion = ca.vertsplit(state, cuts)
    if layout.prescribed and forces is not None:
        numbers = ca.vertcat(
            ca.SX(0, 1), *_entries(constants)[constants.numel() - layout.numbers :]
        )
        planned, rates, _ = forces.prescribed_function(0.0, numbers)
        x, xdot = ca.SX(x), ca.SX(xdot)
        for i, at in enumerate(layout.prescribed_x):
            x[at] = planned[i]
        for i, j in enumerate(layout.prescribed):
            xdot[j] = rates[i]
    gravity = len(layout.gravity)
    inertias = _entries(constants)[gravity : gravity + layout.freed.size]
    body_numbers = ca.vertcat(ca.SX(0, 1), *inertias) if inertias else 0.0
    conditions = initial_conditions_graph(system, given, layout.freed)(
        ca.vertcat(pose, x, xdot, motion), body_numbers
    )
    turns = r - k
    pi, about, fixed, c0, v0 = ca.vertsplit(
        conditions, [0, m, m + turns, m + 2 * turns, m + 2 * turns + k, m + 2 * turns + 2 * k]
    )
    counts, attitude = layout.base, _entries(pose)[k:]
    down: list[ca.SX] = []
    if counts.down:
        weight = [ca.SX(0), ca.SX(0), ca.SX(0)]
        for i, axis in enumerate(layout.gravity):
            weight[axis] = constants[i]
        size = ca.sqrt(sum(w * w for w in weight))
        down = rotated(attitude, [w / size for w in weight], -1.0)
    xs, momenta = _entries(x), _entries(pi)
    reduced: list[Any] = [
        *_shape_entries(layout, xs, momenta), *attitude[: counts.attitude], *down,
        *_entries(about)[: counts.momentum], *[0.0] * (counts.push + layout.clock),
        *_entries(fixed)[: counts.spin], *(momenta[i] for i in layout.constant_pi),
        *_entries(c0), *_entries(v0),
    ]  # fmt: skip
    return ca.Function(
        "initial", [state, constants], [ca.densify(ca.vertcat(ca.SX(0, 1), *reduced))]
    )


def _shape_entries(layout: Layout, x: list[ca.SX], pi: list[ca.SX]) -> list[ca.SX]:
    """Return the entries of y before the base, as Layout.shape_entries does."""
    attitudes = [x[at : at + 4] for at, _ in layout.balls]
    positions, momenta = [x[k] for k in layout.active_x], [pi[k] for k in layout.active]
    cyclic = [x[k] for k in layout.cyclic_x]
    if layout.lifted_balls:
        for q, (_, v) in zip(attitudes, layout.balls, strict=True):
            positions += q
            momenta += [4.0 * p for p in quaternion_rate(q, pi[v : v + 3])]
        return [*positions, *momenta, *cyclic]
    balls = [*(pi[k] for k in layout.ball_pi), *(c for q in attitudes for c in q)]
    return [*positions, *momenta, *cyclic, *balls]


def _entries(column: ca.SX) -> list[ca.SX]:
    """Return the entries of a column; for an empty column, ca.vertsplit would return one entry."""
    return [column[i] for i in range(column.numel())]


def _outcome_graph(graph: ReducedGraph, rows: tuple[Row, ...]) -> ca.Function:
    system, layout = graph.system, graph.layout
    group, k, where = system.group, system.group.linear, outputs_of(system, layout)
    y, t = ca.SX.sym("y", layout.size), ca.SX.sym("t")
    reference = ca.SX.sym("reference", reference_size(system))
    constants = ca.SX.sym("constants", layout.parameters + 3 * k)
    outputs = graph.outputs()(y if layout.clock else ca.vertcat(y, t), constants)
    values = {name: outputs[entries] for name, entries in where.fields.items()}
    values["x_numbers"] = values["x"]
    if system.space.balls:
        values["x"] = _shape_coordinates(system.space, reference[: system.nx], values["x"])
    if layout.base_requested:
        pose = reference[reference.numel() - group.size :]
        values["pose_numbers"] = values["pose"]
        values["pose"] = _tangent_coordinates(graph, pose, values["pose"])
    column = ca.vertcat(ca.SX(0, 1), *(values[row] for row in rows))
    return ca.Function("outcome", [ca.vertcat(y, t, reference), constants], [ca.densify(column)])


def _shape_coordinates(space: ShapeSpace, reference: ca.SX, x: ca.SX) -> ca.SX:
    """Return first-order frame coordinates, (m,), of a shape relative to a nearby reference."""
    ref, now, rows = _entries(reference), _entries(x), []
    for joint in space.joints:
        if joint.kind.is_ball:
            rows += _turn_between(ref[joint.x], now[joint.x])
        else:
            rows += [b - a for a, b in zip(ref[joint.x], now[joint.x], strict=True)]
    return ca.vertcat(ca.SX(0, 1), *rows)


def _turn_between(q: list[ca.SX], other: list[ca.SX]) -> list[ca.SX]:
    """Return the first-order rotation vector, (3,), from a quaternion to a nearby one."""
    x, y, z, w = other
    a, b, c, d = -q[0], -q[1], -q[2], q[3]
    return [
        2.0 * (d * x + a * w + b * z - c * y),
        2.0 * (d * y + b * w + c * x - a * z),
        2.0 * (d * z + c * w + a * y - b * x),
    ]


def _tangent_coordinates(graph: ReducedGraph, reference: ca.SX, pose: ca.SX) -> ca.SX:
    """Return first-order body coordinates, (r,), of a pose relative to a nearby reference."""
    group, k = graph.system.group, graph.system.group.linear
    ref, now = _entries(reference), _entries(pose)
    shift = [a - b for a, b in zip(now[:k], ref[:k], strict=True)]
    if group.turns == 3:
        shift = rotated(ref[k:], shift, -1.0) if k else []
        return ca.vertcat(ca.SX(0, 1), *shift, *_turn_between(ref[k:], now[k:]))
    rotation = [a - b for a, b in zip(now[k:], ref[k:], strict=True)]
    if group.plane:
        *normal, x, y = shift
        cosine, sine = ca.cos(ref[k]), ca.sin(ref[k])
        shift = [*normal, cosine * x + sine * y, cosine * y - sine * x]
    return ca.vertcat(ca.SX(0, 1), *shift, *rotation)


def _sample(kernel: Kernel, rng: np.random.Generator) -> Sample | None:
    at = random_state(kernel, rng, _REACH)
    return None if at is None else _sample_at(kernel, at)


def _sample_at(kernel: Kernel, at: ReferenceState) -> Sample:
    layout, r = kernel.layout, kernel.system.r
    sizes = at.sizes.of_state(layout, r)
    parameters = at.sizes.of_parameters(layout, r, at.parameters)
    return Sample(at.y, at.parameters, sizes, parameters, sizes / at.sizes.time)


def _sample_initial_state(
    kernel: Kernel, given: TwistOrMomentum, rng: np.random.Generator
) -> Sample | None:
    at = random_state(kernel, rng, _REACH)
    if at is None:
        return None
    system, layout, sizes = kernel.system, kernel.layout, at.sizes
    r, k, rates = system.r, system.group.linear, sizes.steps / sizes.time
    v = at.v.copy()
    v[:k] += rates[:k] * rng.normal(size=k)
    motion, motions = (v[:r], rates[:r]) if given == "xi" else (at.H[:r] @ v, sizes.momenta[:r])
    shape, pose = sizes.of_shape(system), sizes.of_pose(system.group)
    parameters = sizes.of_parameters(layout, r, at.parameters)
    constants = slice(layout.gravity_at, None)
    return Sample(
        np.concatenate([at.pose, at.x, v[r:], motion]),
        at.parameters[constants],
        np.concatenate([pose, shape, rates[r:], motions]),
        parameters[constants],
        np.concatenate([
            sizes.of_state(layout, r), parameters[: layout.gravity_at], sizes.of_path(k)[: 2 * k],
        ]),
    )  # fmt: skip


def _sample_outcome(
    kernel: Kernel, rows: tuple[Row, ...], rng: np.random.Generator
) -> Sample | None:
    at = random_state(kernel, rng, _REACH)
    if at is None:
        return None
    inputs, system, sizes = _sample_at(kernel, at), kernel.system, at.sizes
    r, k, rates = system.r, system.group.linear, sizes.steps / sizes.time
    momentum = sizes.mass * sizes.length / sizes.time
    momenta = np.repeat([momentum, momentum * sizes.length], [k, r - k])
    size_of_row = {
        "x": sizes.steps[r:],
        "x_numbers": sizes.of_shape(system),
        "xdot": rates[r:],
        "pose": sizes.steps[:r],
        "pose_numbers": sizes.of_pose(system.group),
        "xi": rates[:r],
        "body_momentum": momenta,
        "spatial_momentum": momenta,
        "energy": np.array([momentum * sizes.length / sizes.time]),
    }
    reference, shape = (at.pose, at.x) if system.space.balls else (at.pose, np.empty(0))
    return Sample(
        np.concatenate([inputs.a, [at.time], shape, reference]),
        np.concatenate([inputs.b, at.com_path]),
        np.concatenate([
            inputs.sizes_a, [sizes.time], sizes.of_shape(system)[: len(shape)],
            sizes.of_pose(system.group),
        ]),
        np.concatenate([inputs.sizes_b, sizes.of_path(k)]),
        np.concatenate([np.empty(0), *(size_of_row[row] for row in rows)]),
    )  # fmt: skip


def _validate_initial_conditions(
    kernel: Kernel, given: TwistOrMomentum, native: NativeCode
) -> None:
    """Compare with the InitialConditionsKernel, which is validated against Pinocchio."""
    system, layout, forces = kernel.system, kernel.layout, kernel.forces
    group, m, k = system.group, system.m, system.group.linear
    at = _sample_initial_state(kernel, given, np.random.default_rng(0))
    if at is None:
        return
    state, constants = at.a, at.b
    pose, x, xdot, motion = np.split(state, np.cumsum([group.size, system.nx, m]))
    if layout.prescribed and forces is not None:
        planned = forces.prescribed(0.0, constants[len(constants) - layout.numbers :])
        if not np.isfinite([*planned.x, *planned.xdot]).all():
            return
        x, xdot = x.copy(), xdot.copy()
        x[list(layout.prescribed_x)], xdot[list(layout.prescribed)] = planned.x, planned.xdot
    start = initial_conditions_kernel(system, given, layout.freed)(
        pose[None], x[None], xdot[None], motion[None]
    )
    counts = layout.base
    gravity = np.zeros(3)
    gravity[list(layout.gravity)] = constants[: len(layout.gravity)]
    down = np.zeros(0)
    if counts.down:
        down = into_body(pose[None, k:], gravity / np.linalg.norm(gravity))[0]
    expected = np.concatenate([
        *layout.shape_entries(x, start.pi[0]), pose[k:][: counts.attitude], down,
        start.about[0, : counts.momentum], np.zeros(counts.push + layout.clock),
        start.fixed[0, : counts.spin], start.pi[0, layout.constant_pi], start.c0[0], start.v0[0],
    ])  # fmt: skip
    values = partial(values_near, native.address, at)
    noise = round_off_near(lambda step: values(step) / at.sizes, len(state))
    require_agreement(
        f"the initial conditions of a flow of '{system.name}'", "the result",
        values(np.zeros(len(state))) / at.sizes, expected / at.sizes, noise / ROUND_OFF,
        reference="the initial conditions of a simulation",
    )  # fmt: skip


def _accept(_: NativeCode) -> None:
    """Accept code without validation, because the kernel itself is validated."""

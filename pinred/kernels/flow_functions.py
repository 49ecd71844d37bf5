"""Functions that a flow map is composed of, with derivatives: initial conditions, rate, outcome.

The initial conditions map an initial state to the reduced state and to the constants of the
motion.  The outcome maps a reduced state to rows of the full state.  The row "pose" contains body
coordinates relative to a reference pose, which is an input.  At the reference pose, these
coordinates are zero, and their derivatives are the body-frame derivatives of the pose.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.memo import once
from ..reduction.base_parts import into_body
from ..system.state_fields import Outcome, derivative_rows
from ..system.system import System
from .base_graph import rotated
from .differentiable import Differentiable, call_value
from .initial_conditions import TwistOrMomentum, initial_conditions_graph, initial_conditions_kernel
from .kernel import Kernel, outputs_of
from .machine.native import NativeCode
from .reduced_graph import ReducedGraph
from .validation import require_agreement

# "pose" is a tangent vector at a reference pose, "pose_numbers" the pose coordinates themselves.
Row = Outcome | Literal["pose_numbers"]


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

    The map takes ((pose, x, ẋ, ξ or μ), constants) to (y₀, spin and cyclic momenta, c₀, v₀).  The
    constants are the kernel's parameters without spin and cyclic momenta (see ReducedGraph).
    Positions and rates of prescribed joints are replaced by their prescribed values at time zero.

    Args:
        kernel: The kernel.
        given: Whether the initial state contains a body twist ("xi") or a body momentum ("mu").
    Returns:
        The function, created once for each kernel.
    """
    write, sample = partial(_initial_graph, given=given), partial(_sample_initial_state, kernel)
    validate = partial(_validate_initial_conditions, kernel, given)
    return once(
        kernel,
        (initial_conditions_of, given),
        lambda: Differentiable(kernel, f"initial_{given}", write, sample, validate),
    )


def outcome_of(kernel: Kernel, rows: tuple[Row, ...]) -> Differentiable:
    """Return the map from a reduced state to rows of the full state.

    The map takes ((y, t, pose), (parameters, c₀, v₀, g)) to the rows.  The input t always
    exists, but it is ignored if y ends with the time.

    Args:
        kernel: The kernel.
        rows: Names of the rows, in order.
    Returns:
        The function, created once for each kernel.
    """
    name, write = f"outcome_{'_'.join(rows)}", partial(_outcome_graph, rows=rows)
    sample = partial(_sample_outcome, kernel)
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
    return derivative_rows(system) | {"pose_numbers": system.group.size}


def _initial_graph(graph: ReducedGraph, given: TwistOrMomentum) -> ca.Function:
    system, layout, forces = graph.system, graph.layout, graph.forces
    group, m, r, k = system.group, system.m, system.r, system.group.linear
    state = ca.SX.sym("state", group.size + 2 * m + r)
    constants = ca.SX.sym("constants", layout.parameters - layout.gravity_at)
    pose, x, xdot, motion = ca.vertsplit(
        state, [0, group.size, group.size + m, group.size + 2 * m, group.size + 2 * m + r]
    )
    if layout.prescribed and forces is not None:
        numbers = ca.vertcat(
            ca.SX(0, 1), *_entries(constants)[constants.numel() - layout.numbers :]
        )
        planned, rates, _ = forces.prescribed_function(0.0, numbers)
        x, xdot = ca.SX(x), ca.SX(xdot)
        for i, j in enumerate(layout.prescribed):
            x[j], xdot[j] = planned[i], rates[i]
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
        *(xs[i] for i in layout.active), *(momenta[i] for i in layout.active),
        *(xs[i] for i in layout.cyclic), *attitude[: counts.attitude], *down,
        *_entries(about)[: counts.momentum], *[0.0] * (counts.push + layout.clock),
        *_entries(fixed)[: counts.spin], *(momenta[i] for i in layout.cyclic),
        *_entries(c0), *_entries(v0),
    ]  # fmt: skip
    return ca.Function(
        "initial", [state, constants], [ca.densify(ca.vertcat(ca.SX(0, 1), *reduced))]
    )


def _entries(column: ca.SX) -> list[ca.SX]:
    """Return the entries of a column; for an empty column, ca.vertsplit would return one entry."""
    return [column[i] for i in range(column.numel())]


def _outcome_graph(graph: ReducedGraph, rows: tuple[Row, ...]) -> ca.Function:
    system, layout = graph.system, graph.layout
    group, k, where = system.group, system.group.linear, outputs_of(system, layout)
    y, t = ca.SX.sym("y", layout.size), ca.SX.sym("t")
    reference = ca.SX.sym("pose", group.size)
    constants = ca.SX.sym("constants", layout.parameters + 3 * k)
    outputs = graph.outputs()(y if layout.clock else ca.vertcat(y, t), constants)
    values = {name: outputs[entries] for name, entries in where.fields.items()}
    if layout.base_requested:
        values["pose_numbers"] = values["pose"]
        values["pose"] = _tangent_coordinates(graph, reference, values["pose"])
    column = ca.vertcat(ca.SX(0, 1), *(values[row] for row in rows))
    return ca.Function("outcome", [ca.vertcat(y, t, reference), constants], [ca.densify(column)])


def _tangent_coordinates(graph: ReducedGraph, reference: ca.SX, pose: ca.SX) -> ca.SX:
    """Return first-order body coordinates, (r,), of a pose relative to a nearby reference."""
    group, k = graph.system.group, graph.system.group.linear
    ref, now = _entries(reference), _entries(pose)
    shift = [a - b for a, b in zip(now[:k], ref[:k], strict=True)]
    if group.turns == 3:
        q, (x, y, z, w) = ref[k:], now[k:]
        a, b, c, d = -q[0], -q[1], -q[2], q[3]
        rotation = [
            2.0 * (d * x + a * w + b * z - c * y),
            2.0 * (d * y + b * w + c * x - a * z),
            2.0 * (d * z + c * w + a * y - b * x),
        ]
        shift = rotated(q, shift, -1.0) if k else []
        return ca.vertcat(ca.SX(0, 1), *shift, *rotation)
    rotation = [a - b for a, b in zip(now[k:], ref[k:], strict=True)]
    if group.plane:
        *normal, x, y = shift
        cosine, sine = ca.cos(ref[k]), ca.sin(ref[k])
        shift = [*normal, cosine * x + sine * y, cosine * y - sine * x]
    return ca.vertcat(ca.SX(0, 1), *shift, *rotation)


def _sample(kernel: Kernel, rng: np.random.Generator) -> tuple[Array, Array]:
    return 0.5 * rng.normal(size=kernel.layout.size), kernel.random_parameters(rng)


def _sample_initial_state(kernel: Kernel, rng: np.random.Generator) -> tuple[Array, Array]:
    system, layout = kernel.system, kernel.layout
    pose = system.group.exp(rng.uniform(-1.0, 1.0, system.r))
    others = rng.normal(size=2 * system.m + system.r)
    return np.concatenate([pose, others]), kernel.random_parameters(rng)[layout.gravity_at :]


def _sample_outcome(kernel: Kernel, rng: np.random.Generator) -> tuple[Array, Array]:
    system = kernel.system
    y, parameters = _sample(kernel, rng)
    pose = system.group.exp(rng.uniform(-1.0, 1.0, system.r))
    com_path = rng.normal(size=3 * system.group.linear)
    return np.concatenate([y, [rng.uniform()], pose]), np.concatenate([parameters, com_path])


def _validate_initial_conditions(
    kernel: Kernel, given: TwistOrMomentum, native: NativeCode
) -> None:
    """Compare with the InitialConditionsKernel, which is validated against Pinocchio."""
    system, layout, forces = kernel.system, kernel.layout, kernel.forces
    group, m, k = system.group, system.m, system.group.linear
    state, constants = _sample_initial_state(kernel, np.random.default_rng(0))
    pose, x, xdot, motion = np.split(state, np.cumsum([group.size, m, m]))
    if layout.prescribed and forces is not None:
        planned = forces.prescribed(0.0, constants[len(constants) - layout.numbers :])
        if not np.isfinite([planned.x, planned.xdot]).all():
            return
        x, xdot, driven = x.copy(), xdot.copy(), list(layout.prescribed)
        x[driven], xdot[driven] = planned.x, planned.xdot
    start = initial_conditions_kernel(system, given, layout.freed)(
        pose[None], x[None], xdot[None], motion[None]
    )
    active, cyclic, counts = list(layout.active), list(layout.cyclic), layout.base
    gravity = np.zeros(3)
    gravity[list(layout.gravity)] = constants[: len(layout.gravity)]
    down = np.zeros(0)
    if counts.down:
        down = into_body(pose[None, k:], gravity / np.linalg.norm(gravity))[0]
    expected = np.concatenate([
        x[active], start.pi[0, active], x[cyclic], pose[k:][: counts.attitude], down,
        start.about[0, : counts.momentum], np.zeros(counts.push + layout.clock),
        start.fixed[0, : counts.spin], start.pi[0, cyclic], start.c0[0], start.v0[0],
    ])  # fmt: skip
    values = np.empty(len(expected))
    call_value(native.address, state, constants, values)
    terms = np.abs(expected).max(initial=1.0) * np.ones(len(expected))
    require_agreement(
        f"the initial conditions of '{system.name}'", "the result", values, expected, terms
    )


def _accept(_: NativeCode) -> None:
    """Accept code without validation, because the kernel itself is validated."""

"""Both ends of a flow as functions with derivatives: its begin, its rate, and its outcome.

The begin takes an initial state as it is given to the reduced state and what is constant along
the motion; the outcome takes a reduced state to rows of the full one.  Poses among these rows are
in the body's coordinates of their tangent, about a pose that is given beside the state: their
values are zero there, and their derivatives those of the pose.
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
from .kernel import Kernel
from .layout import outputs_of
from .machine.native import NativeCode
from .reduced_graph import ReducedGraph
from .validation import require_agreement

# The numbers of a pose are as good as its tangent where a function's values are such numbers, too.
Row = Outcome | Literal["pose_numbers"]


def rate_of(kernel: Kernel) -> Differentiable:
    """Return the vector field (y, parameters) → dy/dt."""

    def make() -> Differentiable:
        sample = partial(_sample, kernel)
        return Differentiable(kernel, "rate", ReducedGraph.rate, sample, _unjudged, limbs=True)

    return once(kernel, rate_of, make)


def initial_conditions_of(kernel: Kernel, given: TwistOrMomentum) -> Differentiable:
    """Return the begin ((pose, x, ẋ, ξ or μ), constants) → (y₀, spin and momenta, c₀, v₀).

    constants: the parameters from gravity on.  x and ẋ of prescribed joints are those of their
    plans at time zero, whatever is given.
    """

    def make() -> Differentiable:
        write = partial(_begin_graph, given=given)
        return Differentiable(
            kernel,
            f"begin_{given}",
            write,
            partial(_sample_given, kernel),
            partial(_judge_begin, kernel, given),
        )

    return once(kernel, (initial_conditions_of, given), make)


def outcome_of(kernel: Kernel, rows: tuple[Row, ...]) -> Differentiable:
    """Return the outcome ((y, t, pose), (parameters, c₀, v₀, g)) → rows of the full state.

    Here t is there even if it is the last number of y, which then counts.
    """

    def make() -> Differentiable:
        write = partial(_outcome_graph, rows=rows)
        return Differentiable(
            kernel, f"outcome_{'_'.join(rows)}", write, partial(_sample_end, kernel), _unjudged
        )

    return once(kernel, (outcome_of, rows), make)


def sizes_of(system: System) -> dict[str, int]:
    """Return how many rows each part of an outcome has."""
    return derivative_rows(system) | {"pose_numbers": system.group.size}


def _begin_graph(graph: ReducedGraph, given: TwistOrMomentum) -> ca.Function:
    system, layout, forces = graph.system, graph.layout, graph.forces
    group, m, r, k = system.group, system.m, system.r, system.group.linear
    whole = ca.SX.sym("given", group.size + 2 * m + r)
    constants = ca.SX.sym("constants", layout.parameters - layout.gravity_at)
    pose, x, xdot, motion = ca.vertsplit(
        whole, [0, group.size, group.size + m, group.size + 2 * m, group.size + 2 * m + r]
    )
    if layout.prescribed and forces is not None:
        numbers = ca.vertcat(
            ca.SX(0, 1), *_entries(constants)[constants.numel() - layout.numbers :]
        )
        planned, rates, _ = forces.prescribed_function(0.0, numbers)
        x, xdot = ca.SX(x), ca.SX(xdot)
        for i, j in enumerate(layout.prescribed):
            x[j], xdot[j] = planned[i], rates[i]
    first = len(layout.gravity)
    inertias = _entries(constants)[first : first + layout.freed.size]
    state, rest = ca.vertcat(pose, x, xdot, motion), ca.vertcat(ca.SX(0, 1), *inertias)
    found = initial_conditions_graph(system, given, layout.freed)(state, rest if inertias else 0.0)
    turns = r - k
    pi, about, fixed, c0, v0 = ca.vertsplit(
        found, [0, m, m + turns, m + 2 * turns, m + 2 * turns + k, m + 2 * turns + 2 * k]
    )
    parts, attitude = layout.base, _entries(pose)[k:]
    down: list[ca.SX] = []
    if parts.down:
        weight = [ca.SX(0), ca.SX(0), ca.SX(0)]
        for i, axis in enumerate(layout.gravity):
            weight[axis] = constants[i]
        size = ca.sqrt(sum(w * w for w in weight))
        down = rotated(attitude, [w / size for w in weight], -1.0)
    xs, momenta = _entries(x), _entries(pi)
    out: list[Any] = [
        *(xs[i] for i in layout.active), *(momenta[i] for i in layout.active),
        *(xs[i] for i in layout.cyclic), *attitude[: parts.attitude], *down,
        *_entries(about)[: parts.momentum], *[0.0] * (parts.push + layout.clock),
        *_entries(fixed)[: parts.spin], *(momenta[i] for i in layout.cyclic),
        *_entries(c0), *_entries(v0),
    ]  # fmt: skip
    return ca.Function("begin", [whole, constants], [ca.densify(ca.vertcat(ca.SX(0, 1), *out))])


def _entries(column: ca.SX) -> list[ca.SX]:
    """Return the entries of a column; slices of one entry to none have a row too many."""
    return [column[i] for i in range(column.numel())]


def _outcome_graph(graph: ReducedGraph, rows: tuple[Row, ...]) -> ca.Function:
    system, layout = graph.system, graph.layout
    group, k, where = system.group, system.group.linear, outputs_of(system, layout)
    y, t = ca.SX.sym("y", layout.size), ca.SX.sym("t")
    reference = ca.SX.sym("pose", group.size)
    constants = ca.SX.sym("constants", layout.parameters + 3 * k)
    out = graph.outputs()(y if layout.clock else ca.vertcat(y, t), constants)
    parts = {name: out[place] for name, place in where.fields.items()}
    if layout.wanted:
        parts["pose_numbers"] = parts["pose"]
        parts["pose"] = _tangent_coordinates(graph, reference, parts["pose"])
    column = ca.vertcat(ca.SX(0, 1), *(parts[row] for row in rows))
    return ca.Function("outcome", [ca.vertcat(y, t, reference), constants], [ca.densify(column)])


def _tangent_coordinates(graph: ReducedGraph, reference: ca.SX, pose: ca.SX) -> ca.SX:
    """Return the body's coordinates, (r,), of a pose close to a reference, to first order."""
    group, k = graph.system.group, graph.system.group.linear
    ref, now = _entries(reference), _entries(pose)
    moved = [a - b for a, b in zip(now[:k], ref[:k], strict=True)]
    if group.turns == 3:
        q, (x, y, z, w) = ref[k:], now[k:]
        a, b, c, d = -q[0], -q[1], -q[2], q[3]
        turned = [
            2.0 * (d * x + a * w + b * z - c * y),
            2.0 * (d * y + b * w + c * x - a * z),
            2.0 * (d * z + c * w + a * y - b * x),
        ]
        moved = rotated(q, moved, -1.0) if k else []
        return ca.vertcat(ca.SX(0, 1), *moved, *turned)
    turned = [a - b for a, b in zip(now[k:], ref[k:], strict=True)]
    if group.plane:
        *rest, x, y = moved
        cosine, sine = ca.cos(ref[k]), ca.sin(ref[k])
        moved = [*rest, cosine * x + sine * y, cosine * y - sine * x]
    return ca.vertcat(ca.SX(0, 1), *moved, *turned)


def _sample(kernel: Kernel, rng: np.random.Generator) -> tuple[Array, Array]:
    return 0.5 * rng.normal(size=kernel.layout.size), kernel.random_parameters(rng)


def _sample_given(kernel: Kernel, rng: np.random.Generator) -> tuple[Array, Array]:
    system, layout = kernel.system, kernel.layout
    pose = system.group.exp(rng.uniform(-1.0, 1.0, system.r))
    rest = rng.normal(size=2 * system.m + system.r)
    return np.concatenate([pose, rest]), kernel.random_parameters(rng)[layout.gravity_at :]


def _sample_end(kernel: Kernel, rng: np.random.Generator) -> tuple[Array, Array]:
    system = kernel.system
    y, parameters = _sample(kernel, rng)
    pose = system.group.exp(rng.uniform(-1.0, 1.0, system.r))
    line = rng.normal(size=3 * system.group.linear)
    return np.concatenate([y, [rng.uniform()], pose]), np.concatenate([parameters, line])


def _judge_begin(kernel: Kernel, given: TwistOrMomentum, native: NativeCode) -> None:
    """Compare a begin with the start kernel, which Pinocchio has judged."""
    system, layout, forces = kernel.system, kernel.layout, kernel.forces
    group, m, k = system.group, system.m, system.group.linear
    whole, constants = _sample_given(kernel, np.random.default_rng(0))
    pose, x, xdot, motion = np.split(whole, np.cumsum([group.size, m, m]))
    if layout.prescribed and forces is not None:
        planned = forces.prescribed(0.0, constants[len(constants) - layout.numbers :])
        if not np.isfinite([planned.x, planned.xdot]).all():
            return
        x, xdot, driven = x.copy(), xdot.copy(), list(layout.prescribed)
        x[driven], xdot[driven] = planned.x, planned.xdot
    start = initial_conditions_kernel(system, given, layout.freed)(
        pose[None], x[None], xdot[None], motion[None]
    )
    active, cyclic, parts = list(layout.active), list(layout.cyclic), layout.base
    gravity = np.zeros(3)
    gravity[list(layout.gravity)] = constants[: len(layout.gravity)]
    down = np.zeros(0)
    if parts.down:
        down = into_body(pose[None, k:], gravity / np.linalg.norm(gravity))[0]
    expected = np.concatenate([
        x[active], start.pi[0, active], x[cyclic], pose[k:][: parts.attitude], down,
        start.about[0, : parts.momentum], np.zeros(parts.push + layout.clock),
        start.fixed[0, : parts.spin], start.pi[0, cyclic], start.c0[0], start.v0[0],
    ])  # fmt: skip
    found = np.empty(len(expected))
    call_value(native.address, whole, constants, found)
    terms = np.abs(expected).max(initial=1.0) * np.ones(len(expected))
    require_agreement(f"the begin of '{system.name}'", "what it gives", found, expected, terms)


def _unjudged(_: NativeCode) -> None:
    """Judge nothing: the rate is a kernel, judged by itself."""

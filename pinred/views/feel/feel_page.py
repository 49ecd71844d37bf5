"""The page on which joints are moved by hand.

It consists of CasADi functions as JavaScript, of the robot with its connection and its sliders, and
of the page with its numbers, scripts and options.

The page uses coordinates w of the open tree, (m,), in which a ball is a rotation vector
(`Connection.in_chart`).  Sliders move the independent coordinates u, (d,).  Without closed loops,
u = w.  Twists and momenta are those of Pinocchio's root joint in space, (6,) [linear; angular].
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import pairwise, product
from pathlib import Path
from string import ascii_letters
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ...analysis.connections.connection import Connection
from ...analysis.connections.loop_connection import LoopConnectionCode
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, PinredError, UnsupportedOperationError
from ...common.files import check_path, write_atomic
from ...common.names import joint_index
from ...common.waiting import Wait
from ...kernels.connection.connection_form import momentum_velocity_graph, velocity_graph
from ...reduction.tree.all_joints import (
    Placement,
    all_joint_values,
    compose,
    fixed_placement,
    inverse,
    joint_frames,
    rotate,
)
from ...reduction.tree.momenta import bracket
from ...system.joints import axes_of
from ...system.loops.independent_joints import LoopChart
from ...system.loops.kinematics import JointLaw, loop_ends, loop_kinematics, rotation_axes
from ...system.loops.loop import BallSurface, Constraint, JointPolynomial
from ...system.loops.loop_assembly import rate_units
from ...system.system import System
from ..playback.drawn_bodies import Bodies, drawn_bodies
from ..playback.page import STAGE, Blob, assemble, plain_fields, resource, robot_head
from ..playback.playback import Momentum, Playback, conserved_momentum, motion_words
from ..playback.scene_nodes import frame

# {operation: JavaScript of its arguments}.  Comparisons are numbers, as in CasADi.
_OPERATIONS = {
    ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0}+{1}", ca.OP_SUB: "{0}-{1}", ca.OP_MUL: "{0}*{1}",
    ca.OP_DIV: "{0}/{1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0}*{0}", ca.OP_TWICE: "2*{0}",
    ca.OP_INV: "1/{0}", ca.OP_SQRT: "Math.sqrt({0})", ca.OP_SIN: "Math.sin({0})",
    ca.OP_COS: "Math.cos({0})", ca.OP_TAN: "Math.tan({0})", ca.OP_ASIN: "Math.asin({0})",
    ca.OP_ACOS: "Math.acos({0})", ca.OP_ATAN: "Math.atan({0})",
    ca.OP_ATAN2: "Math.atan2({0},{1})", ca.OP_FABS: "Math.abs({0})", ca.OP_EXP: "Math.exp({0})",
    ca.OP_LOG: "Math.log({0})", ca.OP_POW: "Math.pow({0},{1})", ca.OP_SIGN: "Math.sign({0})",
    ca.OP_CONSTPOW: "Math.pow({0},{1})", ca.OP_FMIN: "Math.min({0},{1})",
    ca.OP_FMAX: "Math.max({0},{1})", ca.OP_LT: "+({0}<{1})", ca.OP_LE: "+({0}<={1})",
    ca.OP_EQ: "+({0}==={1})", ca.OP_NE: "+({0}!=={1})", ca.OP_NOT: "+!{0}",
    ca.OP_AND: "+({0}&&{1})", ca.OP_OR: "+({0}||{1})", ca.OP_IF_ELSE_ZERO: "({0}?{1}:0)",
}  # fmt: skip


_RESERVED = {"y", "do", "if", "in", "for", "let", "new", "out", "try", "var"}
_LONGEST = 300  # largest number of characters of an expression that becomes part of another one


@dataclass
class _Value:
    """A value of a function.

    Attributes:
        text: Its JavaScript: an expression, or the name of its variable.
        atom: Whether the text needs no parentheses inside other expressions.
        names: Variables in the text, as often as they appear.
        uses: Number of appearances of the value in other texts.
    """

    text: str = ""
    atom: bool = False
    names: list[str] = field(default_factory=list)
    uses: int = 0


def to_javascript(name: str, function: ca.Function) -> str:
    """Write a function of one dense vector as JavaScript `name(y, out)`, which fills `out`.

    Constants, entries of y, and values that are used once become parts of other expressions, so
    the operations and their results stay the same.

    Args:
        name: Name of the JavaScript function.
        function: Function of SX expressions, y → out.
    Returns:
        The JavaScript function.
    Raises:
        UnsupportedOperationError: The function contains an operation without translation.
    """
    lines: list[str] = []
    variables = _Variables()
    for template, value, operands in _instructions(function):
        texts = [one.text if one.atom else f"({one.text})" for one in operands]
        value.text = template.format(*texts)
        value.names = [n for k, one in enumerate(operands) for n in one.names * _count(template, k)]
        if not operands and value.uses * (len(template) - 2) <= len(template) + 4:
            value.atom = not template.startswith("-")  # a constant or an entry of y
        elif not value.uses:  # an output
            lines.append(value.text)
            variables.release(value.names)
        elif value.uses > 1 or not operands or len(value.text) > _LONGEST:
            variables.release(value.names)
            new = variables.take(value.uses)
            lines.append(f"{new}={value.text}")
            value.text, value.atom, value.names = new, True, [new]
    let = f"let {','.join(variables.all)};\n" if variables.all else ""
    return f"function {name}(y,out){{\n{let}{';'.join(lines)};\n}}\n"


def _instructions(function: ca.Function) -> list[tuple[str, _Value, list[_Value]]]:
    """Return the template, the value and the operands of each instruction, with counted uses."""
    registers: dict[int, _Value] = {}
    steps = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        operands: list[_Value] = []
        if operation == ca.OP_CONST:
            template = _number(function.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            template = f"y[{inputs[1]}]"
        elif operation == ca.OP_OUTPUT:
            template, operands = f"out[{outputs[1]}]={{0}}", [registers[inputs[0]]]
        elif operation in _OPERATIONS:
            template = _OPERATIONS[operation]
            operands = [registers[index] for index in inputs[: 1 + ("{1}" in template)]]
        else:
            raise UnsupportedOperationError(
                f"JavaScript: expected elementary operations, got CasADi's operation {operation}"
            )
        for place, operand in enumerate(operands):
            operand.uses += _count(template, place)
        value = _Value()
        if operation != ca.OP_OUTPUT:
            registers[outputs[0]] = value
        steps.append((template, value, operands))
    return [step for step in steps if step[1].uses or step[0].startswith("out[")]


def _count(template: str, place: int) -> int:
    """Return how often an operand appears in a template."""
    return template.count(f"{{{place}}}")


class _Variables:
    """Names of variables, which are used again after the last appearance of their values."""

    def __init__(self) -> None:
        self.all: list[str] = []
        self._free: list[str] = []
        self._left: dict[str, int] = {}
        self._new = (
            name
            for size in (1, 2, 3)
            for name in map("".join, product(ascii_letters, repeat=size))
            if name not in _RESERVED
        )

    def take(self, uses: int) -> str:
        """Return a variable for a value that appears `uses` times."""
        if not self._free:
            self.all.append(next(self._new))
            self._free.append(self.all[-1])
        name = self._free.pop()
        self._left[name] = uses
        return name

    def release(self, names: list[str]) -> None:
        """Count appearances of variables."""
        for name in names:
            self._left[name] -= 1
            if not self._left[name]:
                self._free.append(name)


def _number(value: float) -> str:
    """Write a number as JavaScript, which reads the same bits."""
    names = {"inf": "Infinity", "-inf": "-Infinity", "nan": "NaN"}
    return names.get(repr(float(value)), repr(float(value)))


@dataclass(frozen=True, eq=False)
class FeelGraphs:
    """The functions that the page evaluates; each takes one vector.

    Attributes:
        twist: (w, ẇ, momentum) → twist −A ẇ + P_b⁻¹ μ, (6,).
        curvature: (w, u, v) → B(u, v), (r,), for constant vectors u and v, (m,).
        placements: w → position and quaternion of the joints after the root, relative to the root
            body, 7 numbers each, then the centre of mass, (3,).
        loops: w → equations of the closed loops and their Jacobian (see `loop_graph`); empty
            without loops.
    """

    twist: ca.Function
    curvature: ca.Function
    placements: ca.Function
    loops: ca.Function


def feel_graphs(connection: Connection, system: System) -> FeelGraphs:
    """Return the functions of a robot.

    Args:
        connection: Connection of the open tree, in the chart.
        system: The system, perhaps with closed loops.
    Returns:
        The functions.
    """
    m = connection.m
    w, u, v = (ca.SX.sym(name, m) for name in ("w", "u", "v"))
    x = w if connection.chart is None else connection.chart.shape_graph(w)
    values = all_joint_values(system, x)
    frames = joint_frames(system, values)
    closing = loop_graph(system, w, values, frames) if system.loops else ca.SX.zeros(0, 1)
    return FeelGraphs(
        twist=_twist(connection, root_axes(system)),
        curvature=_function("curvature", [w, u, v], _curvature(connection, w, u, v)),
        placements=_function("placements", [w], _placements(system, frames)),
        loops=_function("loops", [w], closing),
    )


def root_axes(system: System) -> Array:
    """Return the twists of the root joint in its body's frame, (6, r)."""
    return axes_of(system.model.joints[1])


def _twist(connection: Connection, S: Array) -> ca.Function:
    m, r = connection.m, connection.r
    w, wdot, momentum = ca.SX.sym("w", m), ca.SX.sym("wdot", m), ca.SX.sym("momentum", 6)
    mu = ca.DM(S.T) @ momentum if connection.form.momentum else ca.SX.zeros(r, 1)
    graph = momentum_velocity_graph(connection.form)
    xi = graph(ca.vertcat(w, wdot, mu), ca.SX.sym("none"))
    return _function("twist", [w, wdot, momentum], ca.DM(S) @ xi)


def _horizontal(connection: Connection, w: ca.SX, wdot: ca.SX) -> ca.SX:
    values = velocity_graph(connection.form)(ca.vertcat(w, wdot), ca.SX.sym("none"))
    return values[: connection.r]


def _curvature(connection: Connection, w: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
    """Return ∂_u(A v) − ∂_v(A u) − [A u, A v], (r,)."""
    Au, Av = -_horizontal(connection, w, u), -_horizontal(connection, w, v)
    exterior = ca.jtimes(Av, w, u) - ca.jtimes(Au, w, v)
    return exterior - bracket(connection.group, Au, Av)


def _placements(system: System, frames: list[Placement]) -> ca.SX:
    """Return the placements of the joints after the root, and the centre of mass."""
    bodies = list(zip(system.sorted_model.inertias, frames, strict=True))[1:]
    moment = sum(
        (body.mass * (p + rotate(q, ca.SX(body.lever))) for body, (p, q) in bodies), ca.SX.zeros(3)
    )
    entries = [entry for placement in frames[2:] for entry in placement]
    return ca.vertcat(*entries, moment / sum(body.mass for body, _ in bodies))


def _function(name: str, inputs: list[ca.SX], output: ca.SX) -> ca.Function:
    """Return a Function of all inputs in one column."""
    y = ca.SX.sym("y", sum(entry.numel() for entry in inputs))
    ends = np.cumsum([0, *(entry.numel() for entry in inputs)])
    outputs = [y[int(a) : int(b)] for a, b in pairwise(ends)]
    inner = ca.Function(name, inputs, [ca.densify(output)], {"cse": True})
    return ca.Function(name, [y], [inner(*outputs)], {"cse": True})


def loop_graph(
    system: System, w: ca.SX, values: Sequence[ca.SX], frames: Sequence[Placement]
) -> ca.SX:
    """Return the independent equations φ and their Jacobian ∂φ/∂w, column by column, (k + k m,).

    Args:
        system: The system, with loops.
        w: Coordinates of the open tree, (m,).
        values: Coordinates of all joints of the tree, as functions of w.
        frames: Placements of the joints relative to the root body, by Pinocchio's index.
    Returns:
        The expressions.
    """
    closure = system.closure
    assert closure is not None
    rows = [row for loop in system.loops for row in _equations(system, loop, values, frames)]
    lengths = loop_kinematics(system).is_length
    scaled = [row / closure.length if lengths[k] else row for k, row in enumerate(rows)]
    phi = ca.vertcat(*(scaled[k] for k in closure.rows.tolist()))
    return ca.vertcat(phi, ca.vec(ca.densify(ca.jacobian(phi, w))))


def _equations(
    system: System,
    loop: Constraint,
    values: Sequence[ca.SX],
    frames: Sequence[Placement],
) -> list[ca.SX]:
    """Return the equations of one loop, in the order of LoopKinematics."""
    assert not isinstance(loop, BallSurface), "loaded robots have no balls at rest"
    if isinstance(loop, JointPolynomial):
        follower, leader = (
            values[system.tree.joints[i - 2].x.start]
            for i in JointLaw(system.sorted_model, loop).joints
        )
        by = leader - loop.leader_zero
        law = sum(c * by**k for k, c in enumerate(loop.coefficients))
        return [follower - loop.follower_zero - law]
    a, b = (
        compose(frames[end.joint], fixed_placement(pin.SE3(end.placement)))
        for end in loop_ends(system.sorted_model, loop)
    )
    p, q = compose(inverse(a), b)
    position = [p[0], p[1], p[2]]
    if loop.kind == "3d":
        return position
    columns: list[Array] = [np.eye(3)[k] for k in range(3)]
    R = ca.horzcat(*(rotate(q, ca.SX(column)) for column in columns))
    if loop.kind == "6d":
        turn = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
        return [*position, *(0.5 * entry for entry in turn)]
    return [*position, *(R[i, k] for i, k in rotation_axes(loop.kind))]


_FARTHEST = np.pi  # largest range of a joint without narrower limits [rad | m]
_SHRINKING = (1.0, 0.5, 0.25, 0.1, 0.0)  # fractions of the way to a shape that may be out of reach


@dataclass(frozen=True, eq=False)
class FeltRobot(FrozenArrays):
    """A robot that is moved by hand; arrays are read-only.

    Attributes:
        connection: Connection of the open tree, in rotation vectors of balls.
        moved: Connection over the independent coordinates.
        system: The system.
        chart: Independent joints of a robot with closed loops, or None.
        independent: Indices of the independent coordinates, (d,).
        names: Names of the independent coordinates, (d,).
        units: Their units, (d,).
        rest: Coordinates w of the first shape, (m,).
        low: Lower limits of all coordinates, (m,) [rad | m].
        high: Upper limits, (m,) [rad | m].
    """

    connection: Connection
    moved: Connection
    system: System
    chart: LoopChart | None
    independent: NDArray[np.intp]
    names: tuple[str, ...]
    units: tuple[str, ...]
    rest: Array
    low: Array
    high: Array

    @property
    def dim(self) -> int:
        """Number of independent coordinates, d."""
        return len(self.independent)

    def shape(self, u: Array) -> Array:
        """Return the shape of the system at independent coordinates u (d,), (nx,).

        Raises:
            SingularInertiaError: The loops do not close there.
        """
        if self.chart is not None:
            return np.asarray(self.chart.shapes(u[None])[0])
        return u if self.moved.chart is None else self.moved.chart.shapes(u)

    def random(self, count: int) -> list[Array]:
        """Return independent coordinates within the limits, of which the first are at rest.

        Args:
            count: Number of shapes.
        Returns:
            Coordinates, (d,) each, at which the loops close.
        """
        rng, start = np.random.default_rng(0), self.rest[self.independent]
        low, high = self.low[self.independent], self.high[self.independent]
        shapes = [start]
        for u in rng.uniform(low, high, (count - 1, self.dim)):
            for fraction in _SHRINKING:
                with suppress(PinredError):  # the loops do not close there
                    self.shape(start + fraction * (u - start))
                    shapes.append(start + fraction * (u - start))
                    break
        return shapes


def felt_robot(source: System | Connection) -> FeltRobot:
    """Return the robot of a system, or of a connection of a system.

    Args:
        source: A system, whose mechanical connection is used, or a connection of a system.
    Returns:
        The robot.
    Raises:
        InputError: There are no joints, or the connection has no system.
        SymmetryError: Gravity changes the momenta.
    """
    connection = source if isinstance(source, Connection) else Connection.mechanical(source)
    connection.refuse_gravity()
    code = connection.code
    chart = code.chart if isinstance(code, LoopConnectionCode) else None
    system = code.chart_system if isinstance(code, LoopConnectionCode) else connection.system
    if system is None:
        raise InputError("feel: expected a System, or a Connection of a System as loaded")
    if not connection.m:
        raise InputError(f"feel: '{system.name}' has no joints to move")
    if chart is None:
        connection_of_moves = tree = connection.in_chart()
        rest_shape, independent = np.zeros(system.m), np.arange(system.m, dtype=np.intp)
    else:
        connection_of_moves, (tree, rest_shape) = connection, _open_tree(system)
        independent = chart.independent.copy()
    low, high = _limits(tree, system)
    if chart is None:
        rest_shape = np.clip(rest_shape, low, high)
    else:  # the assembled shape may be beyond the limits
        low, high = np.minimum(low, rest_shape), np.maximum(high, rest_shape)
    return FeltRobot(
        connection=tree,
        moved=connection_of_moves,
        system=system,
        chart=chart,
        independent=independent,
        names=tuple(system.space.names[k] for k in independent),
        units=tuple(system.units[k] for k in independent),
        rest=rest_shape,
        low=low,
        high=high,
    )


def _open_tree(system: System) -> tuple[Connection, Array]:
    """Return the connection of the tree of a robot with loops, and a closed shape, (m,)."""
    assert system.closure is not None
    tree, closed = system.open_tree(), np.asarray(system.closure.x)
    centre, rest_shape = np.array(system.space.neutral), np.zeros(system.m)
    for joint in system.space.joints:
        if joint.kind.is_ball:
            centre[joint.x] = closed[joint.x]
        else:
            rest_shape[joint.v] = closed[joint.x]
    connection = Connection.mechanical(tree)
    return connection.in_chart(centre if system.space.balls else None), rest_shape


def _limits(connection: Connection, system: System) -> tuple[Array, Array]:
    """Return the limits of all coordinates, (m,) [rad | m]."""
    model, space = system.sorted_model, system.space
    low, high = np.full(system.m, -_FARTHEST), np.full(system.m, _FARTHEST)
    for joint in space.joints:
        number = model.joints[model.getJointId(joint.name)]
        if joint.kind.m == 1 and number.nq == 1:
            least, most = (
                float(limit[number.idx_q])
                for limit in (model.lowerPositionLimit, model.upperPositionLimit)
            )
            centre = 0.0 if connection.chart is None else float(connection.chart.centre[joint.x][0])
            if least < most:
                low[joint.v] = max(least - centre, -_FARTHEST)
                high[joint.v] = min(most - centre, _FARTHEST)
    wrong = ~(low < high)
    low[wrong], high[wrong] = -_FARTHEST, _FARTHEST
    return low, high


_SCRIPTS = ("lift.js", "closed_shapes.js", "loops.js", "plane.js", "feel.js")
_SPIN, _DRIFT = (
    0.6,
    0.3,
)  # angular [rad/s] or linear [m/s] velocity that the momentum causes at rest
_PERIOD = 4.0  # duration of one cycle of a loop [s]
_CROSSING = 2.0  # time in which a joint moves through its range [s]
_SAMPLES, _PAIR_SAMPLES = 60, 6  # random shapes for the size of the picture, and for the joint pair


@Wait("prepares the page of feel")
def feel_page(
    source: System | Connection,
    *,
    pair: Sequence[str] | None = None,
    meshes: bool | str | Path | Sequence[str | Path] = True,
) -> bytes:
    """Build the HTML page on which joints are moved and the base follows by the connection.

    Args:
        source: A system, whose mechanical connection is used, or a connection of a system.
        pair: Names of the joints on the axes of the shape plane. If None, the two whose curvature
            is largest.
        meshes: Options of the drawing, as in `View`.
    Returns:
        The page.
    Raises:
        InputError: There are no joints, a joint is unknown, or the connection has no system.
        SymmetryError: Gravity changes the momenta.
    """
    robot = felt_robot(source)
    connection, system, free = robot.connection, robot.system, robot.independent
    graphs = feel_graphs(connection, system)
    bodies, blob = drawn_bodies(system, meshes=meshes), Blob()
    head = {
        **_picture(robot, bodies),
        **robot_head(system, bodies, blob),
        "labels": [f"{name} [{unit}]" for name, unit in zip(robot.names, robot.units, strict=True)],
        "angles": [unit == "rad" for unit in robot.units],
        "low": robot.low[free].tolist(),
        "high": robot.high[free].tolist(),
        "start": robot.rest[free].tolist(),
        "size": connection.m,
        "loops": None if robot.chart is None else loop_numbers(robot),
        "pair": _pair(robot, pair),
        "components": motion_words(connection.group),
        "linear": connection.group.linear,
        "turns": connection.group.turns,
        "period": _PERIOD,
        "crossing": _CROSSING,
        "still": "zero momentum" if connection.is_mechanical else connection.form.what,
    }
    scripts = [
        *(to_javascript(name, function) for name, function in vars(graphs).items()),
        *map(resource, STAGE),
        *map(_resource, _SCRIPTS),
    ]
    return assemble(_resource("feel.html"), head, blob, scripts)


def save_feel(
    source: System | Connection,
    path: str | Path,
    *,
    pair: Sequence[str] | None = None,
    meshes: bool | str | Path | Sequence[str | Path] = True,
) -> int:
    """Write the page of `feel_page` to a .html file; if this fails, an existing file is kept.

    Args:
        source: A system or a connection.
        path: The file.
        pair: Names of the joints on the axes of the shape plane.
        meshes: Options of the drawing, as in `View`.
    Returns:
        Size of the file in bytes.
    """
    path = check_path(path, (".html",))
    content = feel_page(source, pair=pair, meshes=meshes)
    write_atomic(path, lambda file: file.write(content))
    return len(content)


def _pair(robot: FeltRobot, names: Sequence[str] | None) -> list[int]:
    """Return the indices of the independent joints on the axes of the shape plane."""
    if names is not None:
        return [joint_index(name, list(robot.names), "pair") for name in names]
    if robot.dim == 1:
        return [0, 0]
    group, strengths = robot.connection.group, np.zeros((robot.dim, robot.dim))
    first = group.linear % robot.connection.r  # rotations, if there are any
    for u in robot.random(_PAIR_SAMPLES):
        field = robot.moved.curvature(u)[first:]
        strengths += np.einsum("rab,rab->ab", field, field)
    pairs = [(a, b) for b in range(robot.dim) for a in range(b)]
    a, b = max(sorted(pairs), key=lambda pair: round(float(np.sqrt(strengths[pair])), 9))
    return [a, b]


def loop_numbers(robot: FeltRobot) -> dict[str, Any]:
    """Return the numbers by which the page closes the loops of a robot, see closed_shapes.js."""
    closure = robot.system.closure
    assert closure is not None
    assert robot.chart is not None
    dependent = robot.chart.dependent
    return {
        "independent": robot.independent.tolist(),
        "dependent": dependent.tolist(),
        "start": robot.rest.tolist(),
        "units": rate_units(robot.system, closure.length).tolist(),
        "low": robot.low[dependent].tolist(),
        "high": robot.high[dependent].tolist(),
        "names": [robot.system.space.names[k] for k in dependent],
    }


def _picture(robot: FeltRobot, bodies: Bodies) -> dict[str, Any]:
    """Return the framing, the placement of the root, and the momentum."""
    connection, system = robot.connection, robot.system
    model, data, group = system.sorted_model, system.sorted_model.createData(), system.group
    shapes = np.array([robot.shape(u) for u in robot.random(_SAMPLES)])
    q = np.array([system.sorted_q(group.identity(), x) for x in shapes])
    root, S = model.jointPlacements[1], root_axes(system)
    com, placements = np.empty((len(q), 3)), np.empty((len(q), model.njoints, 7))
    for k, configuration in enumerate(q):
        com[k] = pin.centerOfMass(model, data, configuration)
        placements[k] = [pin.SE3ToXYZQUAT(place) for place in data.oMi]
    # The centre of mass starts at the origin, so momenta about both are equal.
    axes = S[:3, : group.linear]
    shift = -axes @ axes.T @ root.actInv(com[0])
    spatial = _momentum(robot) if connection.form.momentum else None
    momentum = conserved_momentum(system, q[:1], np.zeros((1, model.nv)))
    twist = np.zeros(6) if spatial is None else S @ spatial
    vector = root.rotation @ (twist[3:] if group.turns else twist[:3])
    film = Playback(
        system=system, t=np.arange(len(q), dtype=float), x=shapes, xdot=shapes[:, : system.m] * 0.0,
        placements=placements - np.pad(com[:, None], ((0, 0), (0, 0), (0, 4))), com=0.0 * com,
        ellipsoid=np.zeros((len(q), 3, 3)), energy=np.zeros(len(q)), sphere=None, ghost=None,
        momentum=Momentum(np.tile(vector, (len(q), 1)), 0.0 * com, momentum.words, momentum.unit),
    )  # fmt: skip
    return {
        **plain_fields(frame(film, bodies)),
        "root": pin.SE3ToXYZQUAT(root).tolist(),
        "base": [*shift.tolist(), 0.0, 0.0, 0.0, 1.0],
        "momentum": {
            "spatial": None if spatial is None else twist.tolist(),
            "vector": vector.tolist(),
            "words": f"{np.linalg.norm(vector):.3g} {momentum.unit}, {momentum.words}",
            "pivoted": bool(group.turns) and not group.turns_about_com,
        },
    }


def _momentum(robot: FeltRobot) -> Array:
    """Return a spatial momentum, (r,), about the origin, for a pose with the CoM in the origin."""
    group, J = robot.connection.group, np.zeros(robot.connection.r)
    P = robot.connection.locked(robot.rest)
    if not group.turns:
        J[0] = _DRIFT * P[0, 0]
        return J
    about_com = np.linalg.inv(np.linalg.inv(P)[group.linear :, group.linear :])
    J[-1] = _SPIN * np.trace(about_com) / group.turns
    return J


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")

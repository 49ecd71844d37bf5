"""CasADi expressions of closed loops, and velocities that keep loops closed.

The impetus–striction form of the equations has no chart and no projection.  With independent
constraints φ(x) = 0, J = ∂φ/∂x and an impetus p in place of the canonical momentum,

    [H Jᵀ; J 0] [v; ν] = [(μ, p); 0],   ẋ = v_s,   ṗ = π̇ + J̇ᵀν,

where π̇ are the rates of the open tree at this velocity, and the classes of rows below compute J
and J̇ᵀν.  φ is an invariant of these equations, so nothing drifts but round-off.  The canonical
momenta are π = p − Jᵀν.  A change of p by Jᵀ times any function changes neither v nor π (gauge),
and the force of the loops is Jᵀλ with λ = −ν̇. Source: J. H. Maddocks and R. L. Pego, "An
unconstrained Hamiltonian formulation for incompressible fluid flow", 1995; O. Gonzalez, J. H.
Maddocks and R. L. Pego, 1999.

Rows of J, and their time derivatives along given multipliers, are computed as follows. The joints
between the two frames of a loop are a chain from frame a to frame b.  In the axes of frame a, with
the axis z and the origin o of a joint, r = p_b − o, and the relative attitude R of frame b, a rate
σ q̇ of the chain (σ = −1 on the side of frame a) moves frame b by

    ṗ_b = σ q̇ z × r,   Ṙ = σ q̇ ẑ R,

so a row of J has entries σ z · m with m = r × f + Σ g_ik R e_k × e_i, where f are the coefficients
of p_b in the equation, and g_ik those of R_ik.  With multipliers as coefficients, Jᵀν has these
entries, and J̇ᵀν has

    σ z · (ṁ + m × ω),

where ω is the velocity relative to frame a of a body in which z is fixed.  A slide has σ z · f and
σ z · (f × ω).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.memo import once
from ...system.coordinates import PlacedJoint, ShapeSpace
from ...system.loops.kinematics import LoopEnd, loop_ends, rotation_axes
from ...system.loops.loop import BallSurface, JointPolynomial, Loop, quaternion_parts
from ...system.loops.loop_assembly import rate_units, scaled_jacobian
from ...system.system import System, nominal
from .all_joints import joint_rates, joint_values, on_shape
from .articulated_sweep import Swept, step_of
from .body_frames import Body, bodies_of
from .scalars import (
    Mat,
    Scalar,
    Vec,
    add,
    as_column,
    cross,
    dot,
    factor_ldl,
    mul,
    plus,
    quaternion_rate,
    solve_factored,
    sub,
    total,
)

_UNITS: Mat = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass
class _Crossing:
    """A joint of the chain, in the axes of frame a.

    Attributes:
        body: Body that the joint moves.
        sign: −1 on the side of frame a, else 1.
        axes: Axis of each rate.
        origin: Point on the axes.
        before: Displacement from the previous origin, (3,), fixed in the body before the joint.
        after: Displacement behind the joint, (3,), fixed in the body behind it.
    """

    body: Body
    sign: float
    axes: Mat
    origin: Vec
    before: Vec
    after: Vec


@dataclass
class LoopRows:
    """The chain of a loop at a shape.

    Attributes:
        loop: The loop.
        crossings: Joints from frame a to frame b.
        tip: Origin of frame b, (3,).
        last: Displacement from the last joint to it.
        attitude: Columns R e_k of the attitude of frame b.
    """

    loop: Loop
    crossings: list[_Crossing]
    tip: Vec
    last: Vec
    attitude: Mat

    @classmethod
    def at(
        cls, model: pin.Model, bodies: Sequence[Body], loop: Loop, joints: Sequence[Scalar]
    ) -> LoopRows:
        """Return the chain for values of all tree joints."""
        a, b = loop_ends(model, loop)
        chains = [chain_to_root(bodies, end) for end in (a, b)]
        common = set(chains[0]) & set(chains[1])
        up, down = ([i for i in chain if i not in common] for chain in chains)
        places = [bodies[end.joint - 1].frame.actInv(end.placement) for end in (a, b)]
        # The rows of R are e_i of frame a in the axes of the current body.
        R: Mat = [[float(c) for c in row] for row in places[0].rotation.T]
        position: Vec = [-dot(axis, [float(c) for c in places[0].translation]) for axis in R]
        pending, crossings = list(position), list[_Crossing]()
        for i in up:
            body, step = bodies[i], step_of(bodies[i], joints)
            axes = _axes(body, R)
            for turn in reversed(step.turns):
                if not turn.is_none:
                    R = [turn.vector(axis) for axis in R]
            back = [mul(-1.0, dot(axis, step.shift)) for axis in R]
            after = plus(back, [mul(-1.0, mul(z, step.slide)) for z in axes[0]])
            if body.is_ball:
                after = back
            crossings.append(_Crossing(body, -1.0, axes, position, pending, after))
            position, pending = plus(position, after), [0.0, 0.0, 0.0]
        for i in reversed(down):
            body, step = bodies[i], step_of(bodies[i], joints)
            before = plus(pending, [dot(axis, step.shift) for axis in R])
            at = plus(position, [dot(axis, step.shift) for axis in R])
            for turn in step.turns:
                if not turn.is_none:
                    R = [turn.back(axis) for axis in R]
            axes = _axes(body, R)
            slide = [0.0] * 3 if body.is_ball else [mul(z, step.slide) for z in axes[0]]
            crossings.append(_Crossing(body, 1.0, axes, at, before, slide))
            position, pending = plus(at, slide), [0.0, 0.0, 0.0]
        last = plus(pending, [dot(axis, [float(c) for c in places[1].translation]) for axis in R])
        tip = plus(position, [sub(c, p) for c, p in zip(last, pending, strict=True)])
        turned = [[float(c) for c in column] for column in places[1].rotation.T]
        attitude = [[dot(axis, column) for axis in R] for column in turned]
        return cls(loop, crossings, tip, last, attitude)

    def row(self, n: int) -> dict[int, Scalar]:
        """Return row n of J: {tree rate: entry}."""
        f, turning = _coefficients(self.loop, {n: 1.0})
        entries: dict[int, Scalar] = {}
        for crossing, m in self._moments(f, turning):
            for k, axis in enumerate(crossing.axes):
                moment = f if crossing.body.prismatic else m
                entries[crossing.body.v_at + k] = mul(crossing.sign, dot(axis, moment))
        return entries

    def turning(self, nu: Mapping[int, Scalar], rates: Sequence[Scalar]) -> dict[int, Scalar]:
        """Return J̇ᵀν for multipliers {row: value} and rates of the tree: {tree rate: entry}."""
        f, turning = _coefficients(self.loop, nu)
        omega: Vec = [0.0, 0.0, 0.0]
        velocity: Vec = [0.0, 0.0, 0.0]
        spins: list[tuple[Vec, Vec]] = []
        for crossing in self.crossings:
            body = crossing.body
            velocity = plus(velocity, cross(omega, crossing.before))
            at, near = velocity, omega
            relative: Vec = [0.0, 0.0, 0.0]
            for k, axis in enumerate(crossing.axes):
                rate = mul(crossing.sign, rates[body.v_at + k])
                relative = plus(relative, [mul(rate, z) for z in axis])
            if body.prismatic:
                velocity = plus(velocity, relative)
            else:
                omega = plus(omega, relative)
            velocity = plus(velocity, cross(omega, crossing.after))
            # The axes of a ball are fixed in the body that it moves.
            fixed = omega if body.is_ball and crossing.sign > 0.0 else near
            spins.append((at, fixed))
        tip = plus(velocity, cross(omega, self.last))
        columns = {k: cross(omega, self.attitude[k]) for _, k in turning}
        rate_of_turn = _turn(turning, columns)
        entries: dict[int, Scalar] = {}
        for (crossing, m), (at, spin) in zip(self._moments(f, turning), spins, strict=True):
            if crossing.body.prismatic:
                load = cross(f, spin)
            else:
                arm = [sub(p, q) for p, q in zip(tip, at, strict=True)]
                load = plus(plus(cross(arm, f), rate_of_turn), cross(m, spin))
            for k, axis in enumerate(crossing.axes):
                entries[crossing.body.v_at + k] = mul(crossing.sign, dot(axis, load))
        return entries

    def _moments(
        self, f: Vec, turning: Mapping[tuple[int, int], Scalar]
    ) -> Iterator[tuple[_Crossing, Vec]]:
        """Yield each joint with its moment m."""
        turn = _turn(turning, dict(enumerate(self.attitude)))
        for crossing in self.crossings:
            arm = [sub(p, q) for p, q in zip(self.tip, crossing.origin, strict=True)]
            yield crossing, plus(cross(arm, f), turn)


@dataclass
class PolynomialRow:
    """The row of a polynomial between two joints."""

    tree: ShapeSpace
    law: JointPolynomial
    joints: Sequence[Scalar]

    def row(self, n: int) -> dict[int, Scalar]:  # noqa: ARG002
        """Return the row of J: {tree rate: entry}."""
        follower, leader = self._rates
        return {follower: 1.0, leader: mul(-1.0, self._polynomial(1))}

    def turning(self, nu: Mapping[int, Scalar], rates: Sequence[Scalar]) -> dict[int, Scalar]:
        """Return J̇ᵀν, as LoopRows.turning does."""
        leader = self._rates[1]
        return {leader: mul(-1.0, mul(mul(self._polynomial(2), rates[leader]), nu[0]))}

    @property
    def _rates(self) -> tuple[int, int]:
        names = self.law.follower, self.law.leader
        follower, leader = (self._joint(name).v.start for name in names)
        return follower, leader

    def _joint(self, name: str) -> PlacedJoint:
        return next(joint for joint in self.tree.joints if joint.name == name)

    def _polynomial(self, derivative: int) -> Scalar:
        """Return a derivative of the polynomial at the leader, by Horner's rule."""
        leader = sub(self.joints[self._joint(self.law.leader).x.start], self.law.leader_zero)
        coefficients = np.polynomial.polynomial.polyder(self.law.coefficients, derivative)
        value: Scalar = 0.0
        for c in reversed(coefficients.tolist()):
            value = add(mul(value, leader), c)
        return value


@dataclass
class SurfaceRow:
    """The row of a surface of a ball's attitudes."""

    tree: ShapeSpace
    surface: BallSurface
    joints: Sequence[Scalar]

    def row(self, n: int) -> dict[int, Scalar]:  # noqa: ARG002
        """Return the row of J: {tree rate: entry}."""
        q, v = self._ball
        return dict(zip(v, _along_rates(q, _slope(self.surface, q)), strict=True))

    def turning(self, nu: Mapping[int, Scalar], rates: Sequence[Scalar]) -> dict[int, Scalar]:
        """Return J̇ᵀν, as LoopRows.turning does."""
        q, v = self._ball
        turn = quaternion_rate(q, [rates[k] for k in v])
        first = _along_rates(q, _slope(self.surface, turn, constant=False))
        second = _along_rates(turn, _slope(self.surface, q))
        return dict(zip(v, [mul(nu[0], c) for c in plus(first, second)], strict=True))

    @property
    def value(self) -> Scalar:
        """The constraint φ."""
        return _surface_value(self.surface, self._ball[0])

    @property
    def _ball(self) -> tuple[list[Scalar], range]:
        """The quaternion of the ball, and the indices of its rates."""
        joint = next(joint for joint in self.tree.joints if joint.name == self.surface.ball)
        return list(self.joints[joint.x]), range(joint.v.start, joint.v.stop)


def _surface_value(surface: BallSurface, q: Sequence[Scalar]) -> Scalar:
    """Return φ at a quaternion."""
    S, l, c = surface.form
    half = [add(0.5 * dot(row, list(q)), k) for row, k in zip(S.tolist(), l.tolist(), strict=True)]
    return sub(dot(half, list(q)), c)


def _slope(surface: BallSurface, q: Sequence[Scalar], *, constant: bool = True) -> list[Scalar]:
    """Return S q + l, or S q if not `constant`."""
    S, l, _ = surface.form
    ends = l.tolist() if constant else [0.0] * 4
    return [add(dot(row, list(q)), end) for row, end in zip(S.tolist(), ends, strict=True)]


def _along_rates(q: Sequence[Scalar], slope: list[Scalar]) -> list[Scalar]:
    """Return the components of a derivative by a quaternion q along the rates of its ball, (3,)."""
    return [dot(slope, quaternion_rate(q, unit)) for unit in _UNITS]


@dataclass
class RestingBall:
    """A ball on surfaces of its attitudes.

    The integrated quaternion has parts of constant norm (see `quaternion_parts`).  The attitude has
    the same parts with their exact norms, so it is on the surfaces, whatever errors the integrated
    norms have.

    Attributes:
        parts: Parts of the integrated quaternion, (4,) each.
        sizes: Their norms.
        radii: The exact norms.
        projectors: Projectors on the parts, (4, 4) each.
    """

    parts: list[list[Scalar]]
    sizes: list[Scalar]
    radii: list[float]
    projectors: list[list[list[float]]]

    @classmethod
    def of(cls, system: System, ball: PlacedJoint, q: Sequence[Scalar]) -> RestingBall:
        """Return a ball of a system with an integrated quaternion."""
        loops = (loop for loop in system.loops if isinstance(loop, BallSurface))
        surfaces = [loop for loop in loops if loop.ball == ball.name]
        projectors, radii = zip(*quaternion_parts(surfaces), strict=True)
        rows = [projector.tolist() for projector in projectors]
        parts = [[dot(row, list(q)) for row in projector] for projector in rows]
        return cls(parts, [ca.sqrt(dot(part, part)) for part in parts], list(radii), rows)

    @property
    def attitude(self) -> list[Scalar]:
        """The unit quaternion of the attitude."""
        q: list[Scalar] = [0.0] * 4
        for part, size, radius in zip(self.parts, self.sizes, self.radii, strict=True):
            q = plus(q, [mul(radius / size, c) for c in part])
        return q

    def rate(self, rate: Sequence[Scalar]) -> list[Scalar]:
        """Return the rate of the integrated quaternion for a rate of the attitude, (4,)."""
        rates: list[Scalar] = [0.0] * 4
        for rows, size, radius in zip(self.projectors, self.sizes, self.radii, strict=True):
            if sum(row[k] for k, row in enumerate(rows)) > 1.5:  # a part of one entry is constant
                scale = size / radius
                rates = plus(rates, [mul(scale, dot(row, list(rate))) for row in rows])
        return rates


def chain_to_root(bodies: Sequence[Body], end: LoopEnd) -> list[int]:
    """Return the bodies from the body of a frame to the root."""
    chain = [end.joint - 1]
    while chain[-1]:
        chain.append(bodies[chain[-1]].parent)
    return chain


def _axes(body: Body, R: Mat) -> Mat:
    """Return the axes of a joint's rates; R: axes of frame a in the axes of its body, by rows."""
    if not body.is_ball:
        return [[axis[2] for axis in R]]
    return [[dot(axis, body.to_frame(unit)) for axis in R] for unit in _UNITS]


def _turn(turning: Mapping[tuple[int, int], Scalar], columns: Mapping[int, Vec]) -> Vec:
    """Return Σ g_ik R e_k × e_i."""
    total: Vec = [0.0, 0.0, 0.0]
    for (i, k), g in turning.items():
        total = plus(total, [mul(g, c) for c in cross(columns[k], _UNITS[i])])
    return total


def _coefficients(
    loop: Loop, nu: Mapping[int, Scalar]
) -> tuple[Vec, dict[tuple[int, int], Scalar]]:
    """Return the coefficients f of the position and g_ik of the attitude for multipliers."""
    f: Vec = [nu.get(n, 0.0) for n in range(3)]
    turning: dict[tuple[int, int], Scalar] = {}
    for n, value in nu.items():
        if n < 3:
            continue
        if loop.kind == "6d":
            i, k = ((2, 1), (0, 2), (1, 0))[n - 3]
            for pair, sign in (((i, k), 0.5), ((k, i), -0.5)):
                turning[pair] = add(turning.get(pair, 0.0), mul(sign, value))
        else:
            turning[rotation_axes(loop.kind)[n - 3]] = value
    return f, turning


# Rate at which the impetus approaches the canonical momentum [1/s].  Under a steady load λ of the
# loops, ν tends to −λ over this rate; without it, ν grows like λ t, and steps become shorter.
GAUGE_RATE = 1.0
# Response of the open tree, relative to that at closed loops, above which round-off counts.
_LOSS = 100.0


@dataclass(frozen=True)
class LoopTerms:
    """The solution of the equations with loops.

    Attributes:
        swept: Velocities and momentum rates of the tree at velocities that keep the loops closed.
        pi: Canonical momenta π = p − Jᵀν, (m,).
        rates: Terms J̇ᵀν of the rates of the impetus, and the term −Jᵀν that keeps ν bounded, (m,).
        values: φ(x), (k,).
        jacobian: Derivatives of φ with respect to x, (k, nx).
        mobility: The matrix J H⁻¹ Jᵀ, (k, k), whose solutions are ν.
    """

    swept: Swept
    pi: list[Scalar]
    rates: list[Scalar]
    values: ca.SX
    jacobian: ca.SX
    mobility: list[list[Scalar]]


def constraint_values(system: System, bodies: Sequence[Body], x: Sequence[Scalar]) -> list[Scalar]:
    """Return the independent constraints φ(x), (k,), of a system with loops.

    Args:
        system: The system.
        bodies: Bodies of the tree, root first.
        x: Shape, (nx,).
    """
    assert system.closure is not None
    joints = joint_values(system, x)
    values: list[Scalar] = []
    for loop in system.loops:
        if isinstance(loop, Loop):
            values += _values(system.sorted_model, bodies, loop, joints)
        elif isinstance(loop, BallSurface):
            values.append(SurfaceRow(system.tree, loop, joints).value)
        else:
            values.append(_polynomial(loop, dict(zip(system.tree.x_names, joints, strict=True))))
    return [values[k] for k in system.closure.rows.tolist()]


def jacobian_function(system: System) -> ca.Function:
    """Return the map from a shape x (nx,) to the Jacobian (k, m) of the independent constraints."""

    def make() -> ca.Function:
        x = ca.SX.sym("x", system.nx)
        entries = ca.vertsplit(x)
        phi = ca.vertcat(*constraint_values(system, bodies_of(system), entries))
        J = ca.jacobian(phi, x) @ rate_map(system, entries)
        return ca.Function("loop_jacobian", [x], [ca.densify(J)], {"cse": True})

    return once(system, jacobian_function, make)


def solve_with_loops(
    system: System,
    bodies: Sequence[Body],
    x: Sequence[ca.SX],
    momentum: Sequence[Scalar],
    sweep: Callable[[list[Scalar], bool], Swept],
    *,
    prescribed: Sequence[int] = (),
) -> LoopTerms:
    """Solve the equations of a system with loops in impetus–striction form.

    Args:
        system: The system.
        bodies: Bodies of the tree, root first.
        x: Shape, (nx,): symbols, or expressions for prescribed joints and for balls at rest.
        momentum: Impetus p, (m,).
        sweep: Function that sweeps the open tree from canonical momenta (m,), with or without the
            body momentum and the rates of prescribed joints.
        prescribed: Indices of the prescribed rates.
    Returns:
        Velocities, canonical momenta and rates.
    """
    has_expressions = not all(isinstance(entry, ca.SX) and entry.is_symbolic() for entry in x)
    entries = ca.vertsplit(ca.SX.sym("x", system.nx)) if has_expressions else x
    column = ca.vertcat(*entries)
    phi = as_column(constraint_values(system, bodies, entries))
    by_coordinates = ca.jacobian(phi, column)
    if has_expressions:
        coordinates = ca.vertcat(*(ca.SX(value) for value in x))
        phi, by_coordinates = ca.substitute([phi, by_coordinates], [column], [coordinates])
    rows = _rows_of(system, bodies, joint_values(system, x))
    J = [on_shape(system, _spread(system, loop.row(n))) for loop, n in rows]
    responses, free = [sweep(list(row), False) for row in J], sweep(list(momentum), True)
    if system.coupled is None:
        mobility = [[_product(a, b) for b in responses] for a in responses]
    else:
        mobility = [[dot(row, response.xdot) for response in responses] for row in J]
    if prescribed or system.coupled is not None:  # factors do not contain prescribed rates
        gaps = [dot(row, free.xdot) for row in J]
    else:
        gaps = [_product(response, free) for response in responses]
    L, _, inverse = factor_ldl(mobility)
    nu = solve_factored(L, inverse, gaps)
    pi, loop_momenta = _less_multipliers(J, momentum, nu)
    swept = sweep(pi, True)
    if needs_second_solution(system):
        more = solve_factored(L, inverse, [dot(row, swept.xdot) for row in J])
        pi, along_more = _less_multipliers(J, pi, more)
        nu, loop_momenta = _sums(nu, more), _sums(loop_momenta, along_more)
        swept = sweep(pi, True)
    rotated = _turning(system, rows, nu, joint_rates(system, swept.xdot))
    rates = [sub(t, mul(GAUGE_RATE, a)) for t, a in zip(rotated, loop_momenta, strict=True)]
    return LoopTerms(swept, pi, rates, phi, by_coordinates, mobility)


def _less_multipliers(
    J: Sequence[Sequence[Scalar]], momentum: Sequence[Scalar], nu: Sequence[Scalar]
) -> tuple[list[Scalar], list[Scalar]]:
    """Return p − Jᵀν and Jᵀν, (m,) each."""
    multiplier_momenta = [
        total([mul(row[k], n) for row, n in zip(J, nu, strict=True)]) for k in range(len(momentum))
    ]
    return [
        sub(p, a) for p, a in zip(momentum, multiplier_momenta, strict=True)
    ], multiplier_momenta


def _sums(a: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    return [add(x, y) for x, y in zip(a, b, strict=True)]


def needs_second_solution(system: System) -> bool:
    """Return whether the difference p − Jᵀν loses digits, so that the loops are solved twice.

    Round-off of the difference moves the open tree, and the second solution projects this motion on
    the closed shapes.  Both are compared at one closed shape, by the largest eigenvalues of the
    inverse mass matrices: light links respond much more in the open tree if the loops hold them.
    """
    system = nominal(system)

    def decide() -> bool:
        closure = system.closure
        assert closure is not None
        model, q = system.sorted_model, system.sorted_q(system.group.identity(), closure.x)
        upper = np.triu(pin.crba(model, model.createData(), q))
        H = system.coupled_matrix((upper + np.triu(upper, 1).T)[None])[0]
        units = rate_units(system, closure.length)
        response = np.linalg.inv(H)[system.r :, system.r :] / np.outer(units, units)
        J = scaled_jacobian(system, closure.x, closure.length)[closure.rows]
        kept = np.linalg.svd(J)[2][len(J) :]
        constrained = np.linalg.inv(kept @ np.linalg.solve(response, kept.T))
        free, closed = (float(np.linalg.eigvalsh(matrix)[-1]) for matrix in (response, constrained))
        return free > _LOSS * closed

    return once(system, needs_second_solution, decide)


def _product(a: Swept, b: Swept) -> Scalar:
    """Return (μ, π)·H⁻¹(μ, π)' from the factors of two sweeps."""
    return total([mul(u, w) for (u, _), (_, w) in zip(a.factors, b.factors, strict=True)])


Row = tuple[LoopRows | PolynomialRow | SurfaceRow, int]


def _rows_of(system: System, bodies: Sequence[Body], joints: Sequence[Scalar]) -> list[Row]:
    """Return the loop of each independent equation, and the number of the equation in it."""
    assert system.closure is not None
    rows: list[Row] = []
    for loop in system.loops:
        if isinstance(loop, Loop):
            chain = LoopRows.at(system.sorted_model, bodies, loop, joints)
            rows += [(chain, n) for n in range(loop.equations)]
        elif isinstance(loop, BallSurface):
            rows.append((SurfaceRow(system.tree, loop, joints), 0))
        else:
            rows.append((PolynomialRow(system.tree, loop, joints), 0))
    return [rows[k] for k in system.closure.rows.tolist()]


def _turning(
    system: System, rows: Sequence[Row], nu: Sequence[Scalar], rates: Sequence[Scalar]
) -> list[Scalar]:
    """Return J̇ᵀν along the shape, (m,), at rates of all joints."""
    multipliers: dict[int, tuple[LoopRows | PolynomialRow | SurfaceRow, dict[int, Scalar]]] = {}
    for (loop, n), value in zip(rows, nu, strict=True):
        multipliers.setdefault(id(loop), (loop, {}))[1][n] = value
    rates_of_joints: list[Scalar] = [0.0] * system.tree.m
    for loop, values in multipliers.values():
        for k, entry in loop.turning(values, rates).items():
            rates_of_joints[k] = add(rates_of_joints[k], entry)
    return on_shape(system, rates_of_joints)


def _spread(system: System, entries: Mapping[int, Scalar]) -> list[Scalar]:
    """Return entries {tree rate: value} as a list for all joints."""
    row: list[Scalar] = [0.0] * system.tree.m
    for k, entry in entries.items():
        row[k] = entry
    return row


def rate_map(system: System, x: Sequence[ca.SX]) -> ca.SX:
    """Return E(x), (nx, m), which maps rates along the frame to derivatives of x."""
    E = ca.SX(system.nx, system.m)
    for joint in system.space.joints:
        if joint.kind.nx == joint.kind.m:
            E[joint.x, joint.v] = ca.SX.eye(joint.kind.m)
            continue
        a, b, c, d = x[joint.x]
        rows = [[d, -c, b], [c, d, -a], [-b, a, d], [-a, -b, -c]]
        E[joint.x, joint.v] = 0.5 * ca.vertcat(*(ca.horzcat(*row) for row in rows))
    return E


def _scalar(entry: ca.SX) -> Scalar:
    return float(entry) if entry.is_constant() else entry


def _values(
    model: pin.Model, bodies: Sequence[Body], loop: Loop, joints: Sequence[Scalar]
) -> list[Scalar]:
    """Return all equations of a loop; see system/loops/kinematics.py."""
    a, b = loop_ends(model, loop)
    chains = [chain_to_root(bodies, end) for end in (a, b)]
    common = set(chains[0]) & set(chains[1])
    (R_a, p_a), (R_b, p_b) = (
        _placement(bodies, end, [i for i in chain if i not in common], joints)
        for end, chain in zip((a, b), chains, strict=True)
    )
    columns_a, columns_b = _columns(R_a), _columns(R_b)
    gap = [sub(q, p) for p, q in zip(p_a, p_b, strict=True)]
    values = [dot(axis, gap) for axis in columns_a]
    if loop.kind == "3d":
        return values
    if loop.kind == "6d":
        for i, k in ((2, 1), (0, 2), (1, 0)):
            forward, back = dot(columns_a[i], columns_b[k]), dot(columns_a[k], columns_b[i])
            values.append(mul(0.5, sub(forward, back)))
        return values
    return values + [dot(columns_a[i], columns_b[k]) for i, k in rotation_axes(loop.kind)]


def _polynomial(law: JointPolynomial, joints: Mapping[str, Scalar]) -> Scalar:
    """Return φ of a polynomial between two joints, by Horner's rule."""
    leader, value = sub(joints[law.leader], law.leader_zero), 0.0
    for c in reversed(law.coefficients):
        value = add(mul(value, leader), c)
    return sub(sub(joints[law.follower], law.follower_zero), value)


def _placement(
    bodies: Sequence[Body], end: LoopEnd, chain: Sequence[int], joints: Sequence[Scalar]
) -> tuple[Mat, Vec]:
    """Return the rotation and origin of a frame in the frame of the body before a chain."""
    at = bodies[end.joint - 1].frame.actInv(end.placement)
    columns: list[Vec] = [[float(c) for c in column] for column in at.rotation.T]
    point: Vec = [float(c) for c in at.translation]
    for i in chain:
        step = step_of(bodies[i], joints)
        point = [point[0], point[1], add(point[2], step.slide)]
        for turn in reversed(step.turns):
            if not turn.is_none:
                point = turn.vector(point)
                columns = [turn.vector(column) for column in columns]
        point = [add(c, s) for c, s in zip(point, step.shift, strict=True)]
    return _columns(columns), point


def _columns(rows: Mat) -> Mat:
    return [list(column) for column in zip(*rows, strict=True)]

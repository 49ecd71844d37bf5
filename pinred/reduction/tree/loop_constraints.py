"""CasADi expressions of closed loops, and velocities that keep loops closed.

The impetus–striction form of the equations has no chart and no projection.  With independent
constraints φ(x) = 0, J = ∂φ/∂x and an impetus p in place of the canonical momentum,

    [H Jᵀ; J 0] [v; ν] = [(μ, p); 0],   ẋ = v_s,   ṗ = π̇ + J̇ᵀν,

where π̇ are the rates of the open tree at this velocity, and loop_rows.py computes J and J̇ᵀν.  φ is
an invariant of these equations, so nothing drifts but round-off.  The canonical momenta are
π = p − Jᵀν.  A change of p by Jᵀ times any function changes neither v nor π (gauge), and the force
of the loops is Jᵀλ with λ = −ν̇.
Source: J. H. Maddocks and R. L. Pego, "An unconstrained Hamiltonian formulation for incompressible
fluid flow", 1995; O. Gonzalez, J. H. Maddocks and R. L. Pego, 1999.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import pinocchio as pin

from ...common.memo import once
from ...system.loops.kinematics import LoopEnd, loop_ends, rotation_axes
from ...system.loops.loop import JointPolynomial, Loop
from ...system.system import System
from .all_joints import joint_rates, joint_values, on_shape
from .articulated_sweep import Swept, step_of
from .body_frames import Body, bodies_of
from .loop_rows import LoopRows, PolynomialRow, chain_to_root
from .scalars import Mat, Scalar, Vec, add, as_column, dot, mul, solve_ldl, sub, total

# Rate at which the impetus approaches the canonical momentum [1/s].  Under a steady load λ of the
# loops, ν tends to −λ over this rate; without it, ν grows like λ t, and steps become shorter.
GAUGE_RATE = 1.0


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
        x: Symbols of the shape, (nx,); expressions for prescribed joints.
        momentum: Impetus p, (m,).
        sweep: Function that sweeps the open tree from canonical momenta (m,), with or without the
            body momentum and the rates of prescribed joints.
        prescribed: Indices of the prescribed rates.
    Returns:
        Velocities, canonical momenta and rates.
    """
    m = system.m
    driven = bool(prescribed)
    entries = ca.vertsplit(ca.SX.sym("x", system.nx)) if driven else x
    column = ca.vertcat(*entries)
    phi = as_column(constraint_values(system, bodies, entries))
    by_coordinates = ca.jacobian(phi, column)
    if driven:
        here = ca.vertcat(*(ca.SX(value) for value in x))
        phi, by_coordinates = ca.substitute([phi, by_coordinates], [column], [here])
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
    nu = solve_ldl(mobility, gaps)
    along = [total([mul(row[k], n) for row, n in zip(J, nu, strict=True)]) for k in range(m)]
    pi = [sub(p, a) for p, a in zip(momentum, along, strict=True)]
    swept = sweep(pi, True)
    turned = _turning(system, rows, nu, joint_rates(system, swept.xdot))
    rates = [sub(t, mul(GAUGE_RATE, a)) for t, a in zip(turned, along, strict=True)]
    return LoopTerms(swept, pi, rates, phi, by_coordinates, mobility)


def _product(a: Swept, b: Swept) -> Scalar:
    """Return (μ, π)·H⁻¹(μ, π)' from the factors of two sweeps."""
    return total([mul(u, w) for (u, _), (_, w) in zip(a.factors, b.factors, strict=True)])


Row = tuple[LoopRows | PolynomialRow, int]


def _rows_of(system: System, bodies: Sequence[Body], joints: Sequence[Scalar]) -> list[Row]:
    """Return the loop of each independent equation, and the number of the equation in it."""
    assert system.closure is not None
    rows: list[Row] = []
    for loop in system.loops:
        if isinstance(loop, Loop):
            chain = LoopRows.at(system.sorted_model, bodies, loop, joints)
            rows += [(chain, n) for n in range(loop.equations)]
        else:
            rows.append((PolynomialRow(system.tree, loop, joints), 0))
    return [rows[k] for k in system.closure.rows.tolist()]


def _turning(
    system: System, rows: Sequence[Row], nu: Sequence[Scalar], rates: Sequence[Scalar]
) -> list[Scalar]:
    """Return J̇ᵀν along the shape, (m,), at rates of all joints."""
    multipliers: dict[int, tuple[LoopRows | PolynomialRow, dict[int, Scalar]]] = {}
    for (loop, n), value in zip(rows, nu, strict=True):
        multipliers.setdefault(id(loop), (loop, {}))[1][n] = value
    turned: list[Scalar] = [0.0] * system.tree.m
    for loop, values in multipliers.values():
        for k, entry in loop.turning(values, rates).items():
            turned[k] = add(turned[k], entry)
    return on_shape(system, turned)


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

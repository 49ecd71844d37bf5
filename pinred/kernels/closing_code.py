"""Kernels of methods with multipliers: rates of the open tree, and code that closes the loops.

A method with multipliers (see Method.multipliers) keeps φ(x) = 0 at step ends by impulses Jᵀλ at
the start of a step, see integrators/implicit/lagrange_poincare.py.  The machine code

    (y₀, parameters, y₁, (γ, c, Λ)) → (γ', c', Λ')

computes the largest gap γ' of φ(x₁), a Newton step Λ' = Λ − (J H⁻¹ Jᵀ)⁻¹ φ(x₁) with J and H at x₀,
and the pull c' = Jᵀ Λ' on the momenta that are conjugate to the positions in y.  With Λ = h λ, a
step of length h whose momenta change by c'/h moves x₁ by H⁻¹ c'.
"""

from __future__ import annotations

import ctypes
from dataclasses import replace

import casadi as ca
import numpy as np

from ..common.machine_code import NativeCode
from ..lie.rotations import conjugate, quaternion_product
from ..reduction.tree.scalars import as_column, as_scalars, solve_ldl
from ..system.loops.kinematics import loop_jacobian, loop_kinematics, loop_values
from .build import build_kernel
from .derived_code import derived_code
from .kernel import Kernel
from .machine.native import compile_object
from .reduced_graph import ReducedGraph
from .reference_state import ReferenceState, random_state
from .validation import require_agreement

_STATES = 3  # number of random states at which the code is compared with Pinocchio
_TRIALS = 40  # largest number of random states drawn
_TOLERANCE = 1e-9  # tolerance of the comparison, relative to the largest entry
_POINTER = ctypes.POINTER(ctypes.c_double)
_SIGNATURE = ctypes.CFUNCTYPE(None, *[_POINTER] * 5)


def with_multipliers(kernel: Kernel) -> Kernel:
    """Return the kernel of a robot with loops for methods that close the loops by multipliers.

    Args:
        kernel: The kernel of the impetus–striction form, already validated.
    Returns:
        A kernel with the same state, parameters and outputs. Its rates are those of the open tree.
    Raises:
        KernelMismatch: The code disagrees with Pinocchio.
    """
    tree = build_kernel(kernel.system.open_tree(), kernel.structure, kernel.forces)
    closing = derived_code(
        kernel,
        "closing",
        {"closing": 1},
        lambda graph: compile_object(_closing_graph(graph), "closing"),
        lambda native: _validate(kernel, native),
    )
    return replace(kernel, rate=tree.rate, instructions=tree.instructions, closing=closing)


def _closing_graph(graph: ReducedGraph) -> ca.Function:
    terms, system, layout = graph.loops, graph.system, graph.layout
    assert terms is not None
    assert system.closure is not None
    y, parameters = graph.y, graph.parameters
    values = ca.Function("values", [y, parameters], [terms.values])
    end, pull = ca.SX.sym("end", layout.size), ca.SX.sym("pull", layout.size + 1)
    gaps, first = values(end, parameters), 1 + layout.pairs
    change = solve_ldl(terms.mobility, as_scalars(gaps))
    multipliers = pull[first : first + len(change)] - as_column(change)
    positions = [*layout.active_x, *(layout.ball_x if layout.lifted_balls else ())]
    units = np.where(loop_kinematics(system).is_length, system.closure.length, 1.0)
    gap: ca.SX = ca.SX(0)
    for value, unit in zip(ca.vertsplit(gaps), units[system.closure.rows], strict=True):
        gap = ca.fmax(gap, ca.fabs(value) / unit)
    out = [gap, terms.jacobian[:, positions].T @ multipliers, multipliers]
    padding = ca.SX(layout.size + 1 - first - len(change), 1)
    column = ca.densify(ca.vertcat(*out, padding))
    return ca.Function("closing", [y, parameters, end, pull], [column], {"cse": True})


def _validate(kernel: Kernel, native: NativeCode) -> None:
    """Compare the code with Pinocchio's constraints and mass matrix at random states."""
    rng = np.random.default_rng(0)
    reaches = [0.9 ** max(0, k - _STATES) for k in range(_TRIALS)]
    # The code closes gaps, so it is compared where there are some.
    drawn = (random_state(kernel, rng, reach, is_closed=False) for reach in reaches)
    states = [at for at in drawn if at is not None]
    for at, end in zip(states[:_STATES], states[_STATES : 2 * _STATES], strict=False):
        _validate_between(kernel, native, at, end, rng)


def _validate_between(
    kernel: Kernel,
    native: NativeCode,
    at: ReferenceState,
    end: ReferenceState,
    rng: np.random.Generator,
) -> None:
    """Compare the code with Pinocchio for a step between two states."""
    system, layout = kernel.system, kernel.layout
    assert system.closure is not None
    rows, pairs = system.closure.rows, layout.pairs
    x = end.x.copy()
    if kernel.forces is not None and layout.prescribed:
        motion = kernel.forces.prescribed(end.time, at.force_parameters)
        x[list(layout.prescribed_x)] = motion.x
    J = np.zeros((len(rows), system.n))
    J[:, system.r :] = loop_jacobian(system, at.x)[rows]
    J = J[:, at.free]
    mobility = J @ np.linalg.solve(at.H[np.ix_(at.free, at.free)], J.T)
    gaps = loop_values(system, x)[rows]
    is_length = np.asarray(loop_kinematics(system).is_length)[rows]
    units = np.where(is_length, system.closure.length, 1.0)
    pull, out = np.zeros((2, layout.size + 1))
    change = np.linalg.solve(mobility, gaps)
    pull[1 + pairs : 1 + pairs + len(rows)] = rng.normal(size=len(rows)) * change
    arrays = [np.ascontiguousarray(a) for a in (at.y, at.parameters, end.y, pull, out)]
    _SIGNATURE(native.address)(*(a.ctypes.data_as(_POINTER) for a in arrays))
    out = arrays[-1]
    who = f"the code that closes the loops of '{system.name}'"
    # Gaps are differences of positions, which may be of the size of the loop.
    terms = np.abs(np.linalg.inv(mobility)) @ (units + np.abs(mobility) @ np.abs(change))
    expected = pull[1 + pairs : 1 + pairs + len(rows)] - change
    multipliers = out[1 + pairs : 1 + pairs + len(rows)]
    require_agreement(
        who, "the multipliers", multipliers, expected, terms, _TOLERANCE, kinds=is_length
    )
    active, a = list(layout.active), len(layout.active)
    J = loop_jacobian(system, at.x)[rows]
    sizes, pulled = np.abs(J).T @ np.abs(multipliers), out[1 : 1 + a]
    kinds = at.is_linear[system.r :][active]
    require_agreement(
        who, "the pull", pulled, (J.T @ multipliers)[active], sizes[active], kinds=kinds
    )
    if layout.lifted_balls:
        q, pulled = at.x[layout.ball_x].reshape(-1, 4), out[1 + a : 1 + pairs].reshape(-1, 4)
        torques = 0.5 * quaternion_product(conjugate(q), pulled)[:, :3].ravel()
        expected = (J.T @ multipliers)[layout.ball_v]
        require_agreement(who, "the pull on balls", torques, expected, sizes[layout.ball_v])
    gap = np.array([np.abs(gaps / units).max()])
    require_agreement(who, "the gap", out[:1], gap, 1.0)

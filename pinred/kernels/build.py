"""Construction of kernels, and of machine code derived from their vector fields.

Code is loaded from the cache on disk or compiled, and then validated. Derived code is made on
demand: the Jacobian, the field at several states at once, and the closing of loops.

The derivative of the vector field along several directions serves Newton's method.  Each SIMD lane
computes one direction: the Jacobian of a state of size n needs n/8 evaluations and is exact to
round-off.  Kernels of open trees of hinges and slides have the Jacobian as CasADi expressions, by a
recursion: the chain rule connects the derivatives of the sweep (see
reduction/tree/articulated_sweep.py) with those of forces and of the base, which CasADi computes.

The vector field at several states has one state per lane.  Methods with parallel stages use one
parameter vector for all lanes; batches of runs use one parameter vector per lane.  Because the
states occupy the lanes, identical branches of the robot are not packed into lanes here.

A method with multipliers (see Method.multipliers) keeps φ(x) = 0 at step ends by impulses Jᵀλ at
the start of a step, see integrators/implicit/lagrange_poincare.py.  Its rates are those of the open
tree.  The machine code

    (y₀, parameters, y₁, (γ, c, Λ)) → (γ', c', Λ')

computes the largest gap γ' of φ(x₁), a Newton step Λ' = Λ − (J H⁻¹ Jᵀ)⁻¹ φ(x₁) with J and H at x₀,
and the pull c' = Jᵀ Λ' on the momenta that are conjugate to the positions in y.  With Λ = h λ, a
step of length h whose momenta change by c'/h moves x₁ by H⁻¹ c'.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import struct
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import asdict, replace
from functools import partial

import casadi as ca
import numpy as np

from ..common.arrays import Array, central_differences
from ..common.errors import InputError, KernelMismatch
from ..common.machine_code import NativeCode, load_object, load_objects, spare_processors
from ..common.memo import once
from ..common.object_cache import ObjectCache, cache_key
from ..forces.force_model import ForceModel
from ..integrators.stepping import linear_systems
from ..integrators.stepping.intrinsics import SEEDS
from ..lie.rotations import conjugate, quaternion_product
from ..reduction.tree.articulated_sweep import sweep_jacobian
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.free_bodies import NOTHING, Freed
from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.loop_constraints import GAUGE_RATE, needs_second_solution
from ..reduction.tree.scalars import Mat, as_column, as_scalars, solve_ldl
from ..system.joints import axes_of
from ..system.loops.kinematics import law_of, loop_ends, loop_jacobian, loop_kinematics, loop_values
from ..system.loops.loop import Loop
from ..system.system import System, nominal
from .kernel import Kernel, Structure, call_value, evaluate, layout_of
from .machine.native import compile_object, generate, lowered
from .reduced_graph import ReducedGraph
from .reference_state import ReferenceState, perturb_parameters, random_state
from .validation import (
    ROUND_OFF,
    explain_ill_scaling,
    require_agreement,
    trial_states,
    validate_kernel,
    validate_rate,
)


def model_bytes(system: System, freed: Freed = NOTHING) -> bytes:
    """Compute a digest of all model parameters that the equations of motion depend on.

    Args:
        system: The system.
        freed: Variable parameters.  Their values are excluded from the digest, because they are
            inputs of the kernel.
    Returns:
        The SHA-256 digest.
    """
    model, reference = system.sorted_model, nominal(system).model
    variable_placements = [body for body, _ in freed.steps]
    digest = hashlib.sha256(f"{system.group.name} {system.group.axes}".encode())
    for i in range(1, model.njoints):
        joint, Y = model.joints[i], model.inertias[i]
        digest.update(f"{joint.shortname()} {model.parents[i]} {joint.nq};".encode())
        # Body frames follow the nominal placements, even if joint placements vary.
        digest.update(reference.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in variable_placements:
            digest.update(model.jointPlacements[i].homogeneous.tobytes())
        if i - 1 not in freed.inertias:
            digest.update(np.concatenate([[Y.mass], Y.lever, Y.inertia.ravel()]).tobytes())
        # The motion axis of a joint that is not aligned with x, y or z is not part of its type.
        digest.update(axes_of(joint).tobytes())
    digest.update(np.asarray(model.armature).tobytes())
    if system.coupled is not None:
        for numbers in (system.coupled.leads, system.coupled.G, system.coupled.offset):
            digest.update(numbers.tobytes())
    if system.closure is not None:
        digest.update(system.closure.rows.tobytes() + str(GAUGE_RATE).encode())
        if needs_second_solution(system):  # Stores of earlier versions have none.
            digest.update(b"second solution")
        for loop in system.loops:
            if not isinstance(loop, Loop):
                digest.update(repr(loop).encode())
                digest.update(f"{law_of(model, loop).joints}".encode())
                continue
            digest.update(loop.kind.encode())
            for end in loop_ends(model, loop):
                digest.update(f"{end.joint}".encode() + end.placement.homogeneous.tobytes())
    return digest.digest()


def build_kernel(
    system: System,
    structure: Structure,
    forces: ForceModel | None = None,
    cache: ObjectCache | None = None,
) -> Kernel:
    """Load the kernel of a system and structure from the cache, or compile it; then validate it.

    Args:
        system: The system.
        structure: Structure of the reduced equations.
        forces: Forces on the system, or None.
        cache: Cache of machine code; by default the user's cache on disk.
    Returns:
        The validated kernel.
    Raises:
        KernelMismatch: The kernel disagrees with Pinocchio.
        ModelError: The kernel disagrees because the system is ill-scaled.
    """
    cache = ObjectCache() if cache is None else cache
    settings = asdict(structure) | {"forces": None if forces is None else forces.key}

    def compile_code() -> bytes:
        lanes = Lanes()
        graph = ReducedGraph(system, structure, forces, lanes)
        rate, outputs = graph.rate(), graph.outputs()
        meta = {"instructions": rate.n_instructions()}
        codes = [
            compile_object(f, f.name(), lanes.marks[f.name()], rare=f is outputs)
            for f in (rate, outputs)
        ]
        return _pack(json.dumps(meta).encode(), *codes)

    key = cache_key(model_bytes(system, structure.freed), json.dumps(settings))
    head, rate_code, outputs_code = _unpack(
        cache.get_or_compile(key, compile_code, f"the equations of '{system.name}'")
    )
    meta = json.loads(head)
    rate, outputs = load_objects({"rate": rate_code, "outputs": outputs_code})
    kernel = Kernel(
        system=system,
        structure=structure,
        forces=forces,
        layout=layout_of(system, structure, forces),
        rate=rate,
        outputs=outputs,
        instructions=int(meta["instructions"]),
    )
    with explain_ill_scaling(system):
        validate_kernel(kernel)
        if structure.freed:  # also validate with other values of the variable parameters
            validate_kernel(perturbed(kernel))
    return kernel


def perturbed(kernel: Kernel) -> Kernel:
    """Return a kernel with random values of its variable body parameters, or the kernel itself."""
    structure, forces = kernel.structure, kernel.forces
    if not structure.freed:
        return kernel
    system = perturb_parameters(
        kernel.system, structure.freed, (*structure.cyclic, *structure.rotors, *structure.axial)
    )
    return replace(kernel, system=system, forces=None if forces is None else forces.on(system))


def _pack(*blocks: bytes) -> bytes:
    return b"".join(struct.pack("<Q", len(block)) + block for block in blocks)


def _unpack(packed: bytes) -> list[bytes]:
    blocks, at = [], 0
    while at < len(packed):
        (size,) = struct.unpack_from("<Q", packed, at)
        blocks.append(packed[at + 8 : at + 8 + size])
        at += 8 + size
    return blocks


def derived_code(
    kernel: Kernel,
    name: str,
    kind: dict[str, int],
    make: Callable[[ReducedGraph], bytes],
    judge: Callable[[NativeCode], None],
) -> NativeCode:
    """Return machine code derived from a kernel's equations, compiled and validated once.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        name: Name of the compiled function.
        kind: Key that distinguishes this code from other code of the same equations.
        make: Function that compiles the object code from the graph.
        judge: Function that raises an error if the code disagrees with the kernel.
    Returns:
        The machine code.
    """
    what = f"derivatives of the equations of '{kernel.system.name}'"

    def load() -> NativeCode:
        forces = None if kernel.forces is None else kernel.forces.key
        settings = asdict(kernel.structure) | {"forces": forces} | kind
        key = cache_key(model_bytes(kernel.system, kernel.structure.freed), json.dumps(settings))

        def compile_code() -> bytes:
            return make(ReducedGraph(kernel.system, kernel.structure, kernel.forces))

        if _is_expecting.get():
            ObjectCache().compile_ahead(
                key, lambda: [partial(generate, lowered(compile_code))], b"".join, what
            )
            raise _ExpectedError
        native = load_object(ObjectCache().get_or_compile(key, compile_code, what), name)
        judge(native)
        return native

    return once(kernel, (derived_code, *kind.items()), load)


class _ExpectedError(Exception):
    """Ends a request of `expect_code`."""


_is_expecting: ContextVar[bool] = ContextVar("is expecting", default=False)


def expect_code(request: Callable[[], object]) -> None:
    """Let other threads generate machine code of derivatives before it is needed.

    This thread only writes the LLVM code.  The request ends at the first code that is missing.

    Args:
        request: Function that needs the machine code.
    """
    if not spare_processors():
        return
    token = _is_expecting.set(True)
    try:
        request()
    except _ExpectedError:
        pass
    finally:
        _is_expecting.reset(token)


_TRIALS, _REQUIRED = 40, 2  # number of random states to try, and of states that must be comparable
_STEP = 2e-3  # step of the finite differences, relative to the size of the state
# Step of further differences, relative to _STEP, and the tolerance of their comparison, relative to
# the largest entry of a Jacobian column.
_CLOSER, _ROUGH = 0.01, 1e-2
_TOLERANCE = 1e-7  # tolerance of comparisons, relative to the largest entry of a Jacobian column
_NEIGHBOURS = 9  # number of states that differ in the last digits
_SAFETY = 10.0  # factor on the observed round-off of rates


def tangent_of(kernel: Kernel) -> NativeCode:
    """Return machine code (y, parameters, directions) → ∂ẏ/∂y · directions, compiled once.

    Entry i of direction j has index 8 i + j, in the directions and in the result.

    Args:
        kernel: The kernel, already validated against Pinocchio.
    Returns:
        The machine code.
    Raises:
        KernelMismatch: The code disagrees with differences of the kernel.
        InputError: The forces are not differentiable at most random states.
    """
    return derived_code(
        kernel,
        "tangent",
        {"tangent": SEEDS},
        lambda graph: compile_object(
            _tangent_graph(graph, kernel), "tangent", wide=SEEDS, wide_inputs=(2,)
        ),
        lambda native: validate_jacobian(kernel, partial(jacobian_by_columns, native)),
    )


def _tangent_graph(graph: ReducedGraph, kernel: Kernel) -> ca.Function:
    y, parameters = ca.SX.sym("y", kernel.layout.size), ca.SX.sym("p", kernel.layout.parameters)
    direction = ca.SX.sym("v", kernel.layout.size)
    derivative = ca.jtimes(graph.rate()(y, parameters), y, direction)
    return ca.Function(
        "tangent", [y, parameters, direction], [ca.densify(derivative)], {"cse": True}
    )


def jacobian_by_columns(native: NativeCode, y: Array, parameters: Array) -> Array:
    """Compute the Jacobian of the vector field, eight columns at once.

    Args:
        native: The machine code of `tangent_of`.
        y: Reduced state, (size,).
        parameters: Parameters, (p,).
    Returns:
        (size, size): ∂ẏ/∂y.
    """
    n = len(y)
    if n == 0:  # a body without variables
        return np.zeros((0, 0))
    seeds, derivatives = np.zeros((2, n * SEEDS))
    padded = np.zeros((n, -(-n // SEEDS) * SEEDS))
    linear_systems.jacobian(native.address, y, parameters, seeds, derivatives, padded, 0, n)
    return padded[:, :n].copy()


def validate_jacobian(kernel: Kernel, jacobian: Callable[[Array, Array], Array]) -> None:
    """Compare a Jacobian with finite differences of the rates where these are accurate.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        jacobian: Function of the reduced state and the parameters.
    Raises:
        KernelMismatch: The Jacobian disagrees with differences of the kernel.
        InputError: The forces are not differentiable at most random states.
    """
    rng, size, compared = np.random.default_rng(0), kernel.layout.size, 0
    who = f"the derivative of the kernel of '{kernel.system.name}'"
    for trial in range(_TRIALS):
        at = random_state(kernel, rng, 0.9 ** max(0, trial - _REQUIRED))
        if at is None:
            continue
        # Compare without units: a robot of a millimetre has derivatives of very different sizes.
        units = at.sizes.of_state(kernel.layout, kernel.system.r)

        def rate_at(displacement: Array, at: ReferenceState = at, units: Array = units) -> Array:
            rate = kernel.evaluate_rate(at.y + units * displacement, at.parameters)
            return rate * at.sizes.time / units

        start = np.zeros(size)
        values = jacobian(at.y, at.parameters) * at.sizes.time / units[:, None] * units
        # Differences are inaccurate where a force has a kink, and not finite where it is undefined.
        with np.errstate(all="ignore"):
            rough, expected = (central_differences(rate_at, start, h) for h in (2.0 * _STEP, _STEP))
            noise = round_off_near(rate_at, size) / _STEP
            bound = _TOLERANCE * np.abs(expected).max(axis=0, initial=0.0) + noise
            smooth = np.abs(rough - expected).max(axis=0, initial=0.0) <= bound
            # Both differences may skip a pulse that is much shorter than their steps.
            near = central_differences(rate_at, start, _STEP * _CLOSER)
            size_of_column = np.maximum(np.abs(near), np.abs(expected)).max(axis=0, initial=0.0)
            allowed = _ROUGH * size_of_column + noise / _CLOSER
            smooth &= np.abs(near - expected).max(axis=0, initial=0.0) <= allowed
        smooth &= np.isfinite(values).all(axis=0)
        for j in np.flatnonzero(smooth):
            terms = noise / ROUND_OFF
            require_agreement(
                who, f"column {j}", values[:, j], expected[:, j], terms, 10.0 * _TOLERANCE,
                "differences of the kernel",
            )  # fmt: skip
        compared += bool(2 * smooth.sum() >= size)
        if compared == _REQUIRED:
            return
    raise InputError(
        f"the forces on '{kernel.system.name}' have no derivatives at {_TRIALS - compared} of "
        f"{_TRIALS} random states; an implicit method needs them"
    )


def round_off_near(function: Callable[[Array], Array], size: int) -> float:
    """Estimate the largest round-off of a function's values, at points that differ in last digits.

    Args:
        function: Function of a displacement, (size,), relative to the size of its arguments.
        size: Length of the displacement.
    Returns:
        The round-off.
    """
    rng, epsilon = np.random.default_rng(0), np.finfo(float).eps
    values = [function(epsilon * rng.integers(-4, 5, size)) for _ in range(_NEIGHBOURS)]
    return _SAFETY * float(np.ptp(values, axis=0).max(initial=0.0))


def wide_rate(kernel: Kernel, lanes: int, *, own_parameters: bool = False) -> NativeCode:
    """Return machine code of a kernel's vector field at several states at once.

    Entry i of state j has index i · lanes + j in y and dy/dt.  With own_parameters, the parameters
    have the same layout.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        lanes: Number of states.
        own_parameters: Whether each state has separate parameters.
    Returns:
        The machine code, compiled once.
    Raises:
        KernelMismatch: The code disagrees with the kernel.
    """
    wide_inputs = (0, 1) if own_parameters else (0,)
    return derived_code(
        kernel,
        "rate",
        {"lanes": lanes} | ({"own_parameters": 1} if own_parameters else {}),
        lambda graph: compile_object(graph.rate(), "rate", wide=lanes, wide_inputs=wide_inputs),
        lambda native: _validate_wide_rate(kernel, native, lanes, own_parameters=own_parameters),
    )


def _validate_wide_rate(
    kernel: Kernel, native: NativeCode, lanes: int, *, own_parameters: bool
) -> None:
    """Compare each lane with Pinocchio at two random states.

    In round k, bit k of a lane's index selects its state.  No two lanes have the same states in all
    rounds, so exchanged lanes are detected.  Of equal rates, only one is compared.

    Args:
        kernel: The kernel.
        native: The machine code.
        lanes: Number of lanes.
        own_parameters: Whether each lane has separate parameters.
    Raises:
        KernelMismatch: A lane disagrees with Pinocchio.
    """
    size = kernel.layout.size
    kernels = [kernel, perturbed(kernel) if own_parameters else kernel]
    states = [next(trial_states(tested, 1, seed)) for seed, tested in enumerate(kernels)]
    validated = set()
    for k in range((lanes - 1).bit_length()):
        selected = np.arange(lanes) >> k & 1
        y = np.transpose([states[i].y for i in selected]).reshape(1, -1)
        parameters = np.transpose([states[i].parameters for i in selected]).ravel()
        for i, at in enumerate(states):
            # Without parameters of their own, the lanes with the other state have those of `at`.
            numbers = parameters if own_parameters else at.parameters
            values = evaluate(native.address, numbers, y, size * lanes).reshape(size, lanes)
            for lane in np.flatnonzero(selected == i):
                rate = values[:, lane]
                if (i, rate.tobytes()) in validated:
                    continue
                try:
                    validate_rate(kernels[i], at, rate)
                except KernelMismatch as error:
                    who = f"the kernel of '{kernel.system.name}' at {lanes} states at once"
                    raise KernelMismatch(f"{who}, in lane {lane}: {error}") from None
                validated.add((i, rate.tobytes()))


def has_recursion(system: System, structure: Structure, forces: ForceModel | None) -> bool:
    """Return whether `jacobian_graph` supports a system and structure.

    Balls, joints that follow others, closed loops, prescribed joints and variable bodies are not
    supported.
    """
    followers = system.space.balls or system.coupled is not None or system.closure is not None
    prescribed = layout_of(system, structure, forces).prescribed
    return not (followers or prescribed or structure.freed)


def jacobian_graph(
    system: System, structure: Structure, forces: ForceModel | None
) -> tuple[ca.Function, Sequence[Mark]]:
    """Build the Jacobian of the vector field.

    Args:
        system: The system.
        structure: Structure of the reduced equations, for which `has_recursion` is true.
        forces: Forces on the system, or None.
    Returns:
        Function (y, parameters) → ∂ẏ/∂y, row by row, and its marks.
    """
    lanes = Lanes(joins=False)
    graph = ReducedGraph(system, structure, forces, lanes, cut=True)
    y, cuts = graph.y, graph.cuts
    sweep = _matrix(sweep_jacobian(graph.swept, bodies_of(system), system.group.axes, lanes))
    through = sweep @ ca.jacobian(graph.sweep_inputs, y)
    jacobian = ca.jacobian(graph.rates, y) + ca.jacobian(graph.rates, cuts) @ through
    (jacobian,) = ca.substitute([jacobian], [cuts], [graph.sweep_results])
    column = ca.vec(ca.densify(jacobian).T)
    function = lanes.function("jacobian", [y, graph.parameters], column)
    return function, lanes.marks["jacobian"]


def _matrix(rows: Mat) -> ca.SX:
    """Return a matrix without its entries that are exactly zero."""
    entries = [
        (i, k, entry)
        for i, row in enumerate(rows)
        for k, entry in enumerate(row)
        if not (isinstance(entry, float) and entry == 0.0)
    ]
    at = [i for i, _, _ in entries], [k for _, k, _ in entries]
    matrix = ca.SX.zeros(ca.Sparsity.triplet(len(rows), len(rows), *at))
    for i, k, entry in entries:
        matrix[i, k] = entry
    return matrix


def jacobian_of(kernel: Kernel, y: Array, parameters: Array) -> Array:
    """Compute the Jacobian of the vector field.

    A recursion over the tree computes it.  Structures that the recursion does not support use
    `tangent_of`, with eight columns at once.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        y: Reduced state, (size,).
        parameters: Parameters, (p,).
    Returns:
        (size, size): ∂ẏ/∂y.
    Raises:
        KernelMismatch: The code disagrees with differences of the kernel.
        InputError: The forces are not differentiable at most random states.
    """
    if not has_recursion(kernel.system, kernel.structure, kernel.forces):
        return jacobian_by_columns(tangent_of(kernel), y, parameters)
    return _evaluate(jacobian_code(kernel), y, parameters)


def jacobian_code(kernel: Kernel) -> NativeCode:
    """Return machine code (y, parameters) → ∂ẏ/∂y, row by row, compiled and validated once.

    Args:
        kernel: A kernel for which `has_recursion` is true.
    Returns:
        The machine code.
    """

    def compile_code() -> bytes:
        function, marks = jacobian_graph(kernel.system, kernel.structure, kernel.forces)
        return compile_object(function, "jacobian", marks)

    return derived_code(
        kernel,
        "jacobian",
        {"jacobian": 1},
        lambda _: compile_code(),
        lambda native: validate_jacobian(kernel, partial(_evaluate, native)),
    )


def _evaluate(native: NativeCode, y: Array, parameters: Array) -> Array:
    matrix = np.empty((len(y), len(y)))
    y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
    call_value(native.address, y, parameters, matrix.ravel())
    return matrix


# --- loops that multipliers close ----------------------------------------------------------

_CLOSING_STATES = 3  # number of random states at which the code is compared with Pinocchio
_CLOSING_TOLERANCE = 1e-9  # tolerance of the comparison, relative to the largest entry
_POINTER = ctypes.POINTER(ctypes.c_double)
_CLOSING_SIGNATURE = ctypes.CFUNCTYPE(None, *[_POINTER] * 5)


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
        lambda native: _validate_closing(kernel, native),
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


def _validate_closing(kernel: Kernel, native: NativeCode) -> None:
    """Compare the code with Pinocchio's constraints and mass matrix at random states."""
    rng = np.random.default_rng(0)
    reaches = [0.9 ** max(0, k - _CLOSING_STATES) for k in range(_TRIALS)]
    # The code closes gaps, so it is compared where there are some.
    drawn = (random_state(kernel, rng, reach, is_closed=False) for reach in reaches)
    states = [at for at in drawn if at is not None]
    for at, end in zip(
        states[:_CLOSING_STATES], states[_CLOSING_STATES : 2 * _CLOSING_STATES], strict=False
    ):
        _validate_closing_between(kernel, native, at, end, rng)


def _validate_closing_between(
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
    _CLOSING_SIGNATURE(native.address)(*(a.ctypes.data_as(_POINTER) for a in arrays))
    out = arrays[-1]
    who = f"the code that closes the loops of '{system.name}'"
    # Gaps are differences of positions, which may be of the size of the loop.
    terms = np.abs(np.linalg.inv(mobility)) @ (units + np.abs(mobility) @ np.abs(change))
    expected = pull[1 + pairs : 1 + pairs + len(rows)] - change
    multipliers = out[1 + pairs : 1 + pairs + len(rows)]
    require_agreement(
        who, "the multipliers", multipliers, expected, terms, _CLOSING_TOLERANCE, kinds=is_length
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

"""Machine code of integrators that other threads generate while a robot's kernel is built.

Code is generated from the bitcode that the package ships, and only if the object cache lacks it.
Each `expect_…` function has the arguments of one kind of run in minimal sizes, because the code
depends on their types only.

Several threads generate one module, which is divided into parts.  The functions keep their
instructions.  Functions that only their module could call become visible to the other parts; calls
have the same instructions for both, because the code model of machine code in memory permits
functions at any address.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from ...common.arrays import read_only
from ...common.machine_code import (
    archive_of,
    create_machine,
    emit_object,
    parse_bitcode,
    spare_processors,
)
from ...common.object_cache import Part
from ...integrators.integrate_many import checked_batch
from ...integrators.methods.method import Explicit, Method, stepper_of
from ...integrators.stepping import shipped_code
from ...integrators.stepping.call_wrapper import (
    CallWrapper,
    argument_type,
    objects_are_as_expected,
    plain_value,
)
from ...integrators.stepping.run_state import Replay, new_run

_LANES = 8  # members of a batch at once, unless the robot is small
_requested: set[tuple[str, type[Method], int]] = set()  # kinds of calls, methods and their orders


def expect_integration(method: Method) -> None:
    """Generate the code of `integrate` for a method.

    Args:
        method: The method.
    """
    if not _is_first("integration", method):
        return
    stepper = stepper_of(method)
    none, columns = np.empty(0), np.empty((0, 1))
    _expect(
        stepper.loops.advance, new_run(), read_only(none), stepper.work(1), read_only(none),
        columns, none.copy(), columns,
    )  # fmt: skip


def expect_members(method: Method) -> None:
    """Generate the code of `integrate_many`, or of `integrate_in_lanes` with eight lanes.

    Args:
        method: The method.
    """
    if not _is_first("members", method):
        return
    batch = checked_batch(1, np.empty((1, 0)), np.ones((1, 1)), 1.0, [1.0], (0, 0), 1).batch
    if isinstance(method, Explicit):
        from ...integrators.lanes.integrate_in_lanes import _lane_loop

        loop = _lane_loop(type(method).__name__, method.order, method.tableau(), _LANES)
        queue = np.zeros(1, dtype=np.int64)
        _expect(loop.members, batch, new_run(), queue, loop.workspace(1, 0), 1)
    else:
        stepper = stepper_of(method)
        _expect(stepper.loops.members, batch, new_run(), new_run(), stepper.work(1), 0, 1)


def expect_tangents(method: Method, count: int) -> None:
    """Generate the code of `run_along` for a number of directions.

    Args:
        method: The method.
        count: Number of directions.
    """
    if not _is_first(f"tangents {count == 1}", method):
        return
    frozen, replay, matrix = read_only(np.empty((1, 1))), _replay(), np.empty((1, 1))
    tangents = (matrix[0], matrix, matrix, matrix, np.empty((1, 1, 1)))
    if not isinstance(method, Explicit):
        from ...integrators.implicit import gauss_sensitivities as gauss

        _expect(gauss.forward, replay, 1, 1, frozen, tangents, gauss.sensitivity_rows(1, 1))
        return
    from ...integrators.explicit import run_sensitivities as explicit

    weights = explicit.weights_of(type(method).tableau())
    if count == 1:
        pairs = explicit.pairs_of(weights, 1)
        _expect(explicit.forward_pair, replay, 1, weights, tangents, pairs)
    else:
        work = explicit.workspace_of(weights, 1)
        _expect(explicit.forward, replay, 1, weights, tangents, work)


def expect_cotangents(method: Method) -> None:
    """Generate the code of `run_back`.

    Args:
        method: The method.
    """
    if not _is_first("cotangents", method):
        return
    matrix, frozen = np.empty((1, 1)), read_only(np.empty((1, 1)))
    back = (frozen, matrix[0], matrix, matrix[0], matrix[0])
    if isinstance(method, Explicit):
        from ...integrators.explicit.run_sensitivities import adjoint_sweep_of, weights_of

        tableau = type(method).tableau()
        (_, dense, _), adjoint = weights_of(tableau), adjoint_sweep_of(tableau)
        _expect(adjoint.sweep, _replay(), 1, dense, back, adjoint.rows(1), matrix[0])
    else:
        from ...integrators.implicit.gauss_sensitivities import reverse, sensitivity_rows

        _expect(reverse, _replay(), 1, 1, 1, back, sensitivity_rows(1, 1))


def expect(function: Any, *arguments: Any) -> None:
    """Generate the code of a compiled function.

    Args:
        function: The function.
        *arguments: Arguments of the types with which it will be called.
    """
    if spare_processors():
        _expect(function, *arguments)


def _is_first(call: str, method: Method) -> bool:
    """Return whether code may be generated ahead that was not requested yet in this process."""
    key = call, type(method), method.order
    if key in _requested or not spare_processors():
        return False
    _requested.add(key)
    return True


def _replay() -> Replay:
    numbers = read_only(np.empty(1))
    return 1, (0, 0), numbers, numbers, numbers


def _expect(function: Any, *arguments: Any) -> None:
    """Let other threads generate the code of a function for arguments of these types."""
    types = tuple(map(argument_type, map(plain_value, arguments)))
    supported = tuple(t for t in types if t is not None)
    # Code in memory is not generated again, even if no cache could store it.
    if len(supported) < len(types) or function.has_code(supported):
        return
    python = function.py_func
    name = shipped_code.shipped_name(python, supported, function.stamp)
    if not (shipped_code.is_shipped(name) and objects_are_as_expected()):
        return
    result = ""

    def parts() -> Sequence[Part]:
        nonlocal result
        bitcode = shipped_code.read_shipped(name)
        result, context = bitcode.result, llvm.create_context()
        wrapper = CallWrapper(python.__name__, supported, result)
        module = parse_bitcode(bitcode.module, context)
        shipped_code.check_parameters(wrapper, module)
        texts = [*divide(module), wrapper.text]
        module.close()  # before its context is deleted
        return [partial(_generate, text) for text in texts]

    def join(codes: Sequence[bytes]) -> bytes:
        return result.encode() + b"\n" + archive_of(codes)

    key = shipped_code.key_of(name)
    shipped_code.STORE.compile_ahead(key, parts, join, "an integrator, once for all robots")


def _generate(text: str) -> bytes:
    """Generate object code of LLVM assembly."""
    context = llvm.create_context()
    module = llvm.parse_assembly(text, context)
    code = emit_object(create_machine(shipped_code.LEVEL), module)
    module.close()  # before its context is deleted
    return code


# Length of a part's text above which it gets no further function.  A part takes some milliseconds
# besides the time for its functions, which is about a second per megabyte of text.
_LENGTH = 100_000


def divide(module: llvm.ModuleRef) -> list[str]:
    """Return LLVM assembly of parts of a module, the longest first.

    Constants are part of all parts.

    Args:
        module: The module, whose functions are renamed. Its global variables are constants.
    Returns:
        The parts; no function belongs to two of them.
    """
    for k, function in enumerate(f for f in module.functions if not f.is_declaration):
        if function.linkage in (llvm.Linkage.internal, llvm.Linkage.private):
            function.name = f"part_{k}"
            function.linkage, function.visibility = "external", "hidden"
    # A module is global values, definitions that each start and end at the start of a line,
    # and attributes.
    shared, *definitions = re.split(r"^(?=define )", str(module), flags=re.MULTILINE)
    functions = []
    for definition in definitions:
        end = definition.index("\n}\n") + 3
        functions.append(definition[:end])
        shared += definition[end:]
    declared = ["declare" + f[len("define") : f.index(" {\n")] + "\n" for f in functions]
    return [
        shared + "".join(functions[k] if k in group else declared[k] for k in range(len(functions)))
        for group in _groups([len(function) for function in functions])
    ]


def _groups(lengths: list[int]) -> list[set[int]]:
    """Return indices of functions that are parts together, the longest part first."""
    groups: list[set[int]] = []
    length = _LENGTH
    for k in sorted(range(len(lengths)), key=lambda k: -lengths[k]):
        if length >= _LENGTH:
            groups.append(set())
            length = 0
        groups[-1].add(k)
        length += lengths[k]
    return groups

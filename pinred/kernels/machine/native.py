"""Compilation of CasADi Functions to machine code with LLVM, without a C compiler.

The only LLVM pass is the inlining of helpers.  Code generation eliminates common
subexpressions; LLVM's default pipeline takes a third longer, and its code is not faster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar

import casadi as ca
import llvmlite.binding as llvm

from ...common.errors import InputError
from ...common.machine_code import code_level, cpu_target, create_machine, emit_object
from ...reduction.tree.identical_branches import Mark
from .lowering import RESERVED, lower

# Code of more than LONG instructions for each lane is divided into functions of PART lines of IR.
# Kernels of most robots have fewer.  talos with a member in each of eight lanes is above LONG, but
# below it for each lane; divided, it evaluates 1.3 times slower.
LONG, PART = 8000, 1000


def compile_object(
    function: ca.Function,
    name: str,
    marks: Sequence[Mark] | None = None,
    *,
    wide: int = 1,
    wide_inputs: Sequence[int] = (0,),
    rare: bool = False,
) -> bytes:
    """Compile `void name(const double *in0, …, double *out)` for the CPU of `cpu_target`.

    No pointer may overlap `out`; the pointer of an empty column may have any value.

    Args:
        function: SX Function of dense columns with one dense column as output.
        name: Name of the compiled function, a C identifier.
        marks: Marks of a Function built by `Lanes`; its additional input and output have no
            pointers.
        wide: Number of points at which the function is evaluated at once.  Each entry of the
            wide inputs and of `out` then occupies this many consecutive numbers.
        wide_inputs: Indices of the inputs with this layout.
        rare: Whether the function is evaluated so rarely that long code is not optimised.  It then
            takes a seventh of the time to compile, and twice the time to run.
    Returns:
        The object code.
    Raises:
        InputError: The Function or the name is invalid.
        UnsupportedOperationError: The Function contains an operation without machine code.
        _LoweredError: Only `lowered` needs the LLVM code.
    """
    _check(function, name, outputs=1 if marks is None else 2)
    is_long = function.n_instructions() > LONG * wide
    text = lower(
        function, name, marks, fma=cpu_target().fma, wide=wide, wide_inputs=wide_inputs,
        part=PART if is_long and not rare else 0,
    )  # fmt: skip
    if _only_lowers.get():
        raise _LoweredError(text)
    return generate(text, 0 if is_long and rare else None)


class _LoweredError(Exception):
    """Carries LLVM code out of `compile_object`."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text


_only_lowers: ContextVar[bool] = ContextVar("only lowers", default=False)


def lowered(make: Callable[[], bytes]) -> str:
    """Return the LLVM code for which a function that calls `compile_object` returns object code.

    Args:
        make: The function.
    Returns:
        LLVM assembly, see `generate`.
    Raises:
        RuntimeError: The function does not call `compile_object`.
    """
    token = _only_lowers.set(True)
    try:
        make()
    except _LoweredError as stop:
        return stop.text
    finally:
        _only_lowers.reset(token)
    raise RuntimeError("the function does not call compile_object")


def generate(text: str, level: int | None = None) -> bytes:
    """Generate object code of LLVM assembly; several threads may do so at the same time.

    Args:
        text: The assembly.
        level: LLVM's level of optimisation in code generation; None for `code_level`.
    Returns:
        The object code.
    """
    context = llvm.create_context()
    module = llvm.parse_assembly(text, context)
    machine = create_machine(code_level() if level is None else level)
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    code = emit_object(machine, module)
    module.close()  # before its context is deleted
    return code


def _check(function: ca.Function, name: str, outputs: int) -> None:
    if not (name.isascii() and name.isidentifier()) or name in RESERVED:
        raise InputError(f"the name of the function must be an unused C identifier, got {name!r}")
    if not function.is_a("SXFunction"):
        raise InputError(
            f"'{name}' must be a Function of SX expressions, got {function.class_name()}; "
            "expand() converts an MX Function"
        )
    if function.n_out() != outputs:
        raise InputError(f"'{name}' must have one output, got {function.n_out()}")
    for what, shape in [
        *((f"input {k}", function.sparsity_in(k)) for k in range(function.n_in())),
        ("the output", function.sparsity_out(outputs - 1)),
    ]:
        if not (shape.is_dense() and (shape.is_column() or shape.numel() == 0)):
            raise InputError(f"{what} of '{name}' must be a dense column, got {shape.dim(True)}")

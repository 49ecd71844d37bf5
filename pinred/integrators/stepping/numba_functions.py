"""Compilation with numba: from Python functions to optimised LLVM bitcode.

numba takes seconds to compile an integrator: it infers types and optimises.  Both depend neither
on the robot nor, with the compiler of this module, on the CPU.  Bitcode contains the result: a
module with one function, without the wrapper that Python calls.  Users of pinred's own methods
need no numba, because the package ships their bitcode.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import CellType, CodeType, FunctionType
from typing import Any

import llvmlite.binding as llvm
import numba
from numba.core import compiler
from numba.core import types as numba_types
from numba.extending import intrinsic

from .call_wrapper import COMPILED, RESULTS, ArgumentType, ArrayType, Bitcode, NumberType

_LEVEL = 3  # of LLVM's optimisation, as in numba
# The CPU whose costs decide how code is optimised. Its instructions are not assumed: machine code
# is generated for the CPU that runs it.
_OPTIMISED_FOR = {"x86_64": "x86-64-v3"}.get(platform.machine(), "generic")
# Symbols of Python and of numba's runtime, and instructions of certain CPUs.
_BOUND = re.compile(r"_?Py|NRT_|_ZN|\.?numba[._]|llvm\.(x86|aarch64)\.")


class PortableCompiler(compiler.Compiler):
    """numba's compiler, which optimises for one CPU instead of the machine's."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        """Compile a function, and the functions of numba that it needs."""
        with _optimising_for_all(self.state.targetctx.codegen()):
            return super().compile_extra(func)


# Without fast-math, results do not depend on where a function is inlined. Compiled functions
# never allocate arrays, so reference counting (_nrt) is off and views of rows cost nothing.
_OPTIONS: Any = {
    "nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True,
    "pipeline_class": PortableCompiler,
}  # fmt: skip


def compile_bitcode(function: Any, name: str, types: tuple[ArgumentType, ...]) -> Bitcode:
    """Compile a function.

    Args:
        function: The CompiledFunction.
        name: Name of its bitcode, which is for those who keep it.
        types: Types of its arguments.
    Returns:
        The bitcode.
    Raises:
        TypeError: The function needs objects of Python or of this process, or a certain CPU.
    """
    signature = tuple(map(_numba_type, types))
    function.numba_object.compile(signature)
    bitcode = extract_bitcode(function.numba_object.overloads[signature])
    if bitcode is None:
        raise TypeError(
            f"'{name}' cannot be compiled, because it needs objects of Python; use numbers and "
            "arrays only"
        )
    return bitcode


def make_dispatcher(function: Callable[..., Any], *, inline: bool) -> Any:
    """Return numba's dispatcher of a function.

    Args:
        function: The Python function.
        inline: Whether numba inlines the function in those that call it.
    """
    options = {**_OPTIONS, "inline": "always"} if inline else _OPTIONS
    return numba.njit(**options)(_with_numba(function))


def make_numba_intrinsic(generator: Callable[..., Any]) -> Any:
    """Return numba's object for a function whose LLVM instructions a generator emits."""
    make: Callable[..., Any] = intrinsic
    return make(generator)


def _with_numba(function: Callable[..., Any]) -> Any:
    """Return a copy of a Python function that refers to numba's objects of compiled functions."""
    names = set(_names(function.__code__))
    values = {k: _numba_object(v) if k in names else v for k, v in function.__globals__.items()}
    cells = function.__closure__ or ()
    closure = tuple(CellType(_numba_object(cell.cell_contents)) for cell in cells)
    copy = FunctionType(
        function.__code__, values, function.__name__, function.__defaults__, closure
    )
    copy.__qualname__, copy.__module__ = function.__qualname__, function.__module__
    copy.__doc__, copy.__kwdefaults__ = function.__doc__, function.__kwdefaults__
    return copy


def _names(code: CodeType) -> Iterator[str]:
    """Yield the global names in a function and in the functions that it contains."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _numba_object(value: Any) -> Any:
    return value.numba_object if hasattr(type(value), "numba_object") else value


def _numba_type(argument: ArgumentType) -> Any:
    """Return numba's type of an argument."""
    kinds: Any = numba_types
    if isinstance(argument, NumberType):
        return {int: kinds.int64, float: kinds.float64, bool: kinds.boolean}[argument.kind]
    if isinstance(argument, ArrayType):
        return kinds.Array(numba.from_dtype(argument.dtype), argument.ndim, argument.layout)
    items = tuple(map(_numba_type, argument.items))
    return kinds.BaseTuple.from_types(items, None if argument.kind is tuple else argument.kind)


# --- bitcode ------------------------------------------------------------------------------------


@contextmanager
def _optimising_for_all(codegen: Any) -> Iterator[None]:
    """Replace the target of numba's optimiser; numba lets one thread at a time compile."""
    found = codegen._tm  # noqa: SLF001, numba has no option for this
    codegen._tm = _target()  # noqa: SLF001
    try:
        yield
    finally:
        codegen._tm = found  # noqa: SLF001


@cache
def _target() -> Any:
    target = llvm.Target.from_triple(llvm.get_process_triple())
    return target.create_target_machine(cpu=_OPTIMISED_FOR, opt=_LEVEL, jit=True)


def extract_bitcode(compiled: Any) -> Bitcode | None:
    """Return the bitcode of a compiled function.

    Args:
        compiled: numba's compile result.
    Returns:
        The bitcode, or None if it needs objects of Python or of this process, or a certain CPU.
    """
    library, name = compiled.library, compiled.fndesc.llvm_func_name
    module = llvm.parse_bitcode(library._final_module.as_bitcode())  # noqa: SLF001
    # Code that runs without numba has no function of numba to call.
    if any(value.name == RESHAPE for value in module.functions):
        module.link_in(llvm.parse_assembly(RESHAPE_CODE))
    for value in (*module.functions, *module.global_variables):
        if not value.is_declaration and value.name != name:
            value.linkage = "internal"
    # Symbols and the name of the module contain a count of the functions that were compiled before.
    module.get_function(name).name = COMPILED
    module.name = ""
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.add_strip_symbols_pass()
    passes.run(module, llvm.create_pass_builder(_target(), llvm.create_pipeline_tuning_options()))
    result = str(compiled.signature.return_type)
    if result not in RESULTS or compiled.reload_init or not _is_portable(module):
        return None
    return Bitcode(result, module.as_bitcode())


def _is_portable(module: Any) -> bool:
    """Return whether a module needs only functions of the C library and of LLVM."""
    values = (*module.functions, *module.global_variables)
    foreign = [value.name for value in values if value.is_declaration]
    return not any(map(_BOUND.match, foreign)) and "target-cpu" not in str(module)


RESHAPE = "numba_attempt_nocopy_reshape"
# It accepts arrays in C order alone, and returns 0 for others, as numba's does where it needs a
# copy. The arrays have entries, and both shapes have equally many; the last argument is not used.
RESHAPE_CODE = f"""
define i32 @{RESHAPE}(i64 %axes, ptr %dims, ptr %strides, i64 %new_axes, ptr %new_dims,
                      ptr %new_strides, i64 %itemsize, i32 %columns) {{
entry:
  br label %old
old:
  %k = phi i64 [ %axes, %entry ], [ %axis, %checked ]
  %expected = phi i64 [ %itemsize, %entry ], [ %larger, %checked ]
  %more = icmp sgt i64 %k, 0
  br i1 %more, label %check, label %new
check:
  %axis = sub i64 %k, 1
  %dim.at = getelementptr i64, ptr %dims, i64 %axis
  %dim = load i64, ptr %dim.at
  %stride.at = getelementptr i64, ptr %strides, i64 %axis
  %stride = load i64, ptr %stride.at
  %equal = icmp eq i64 %stride, %expected
  %single = icmp eq i64 %dim, 1
  %fits = or i1 %equal, %single
  %larger = mul i64 %expected, %dim
  br i1 %fits, label %checked, label %copy
checked:
  br label %old
new:
  %j = phi i64 [ %new_axes, %old ], [ %new_axis, %fill ]
  %size = phi i64 [ %itemsize, %old ], [ %new_size, %fill ]
  %unfilled = icmp sgt i64 %j, 0
  br i1 %unfilled, label %fill, label %done
fill:
  %new_axis = sub i64 %j, 1
  %new_stride.at = getelementptr i64, ptr %new_strides, i64 %new_axis
  store i64 %size, ptr %new_stride.at
  %new_dim.at = getelementptr i64, ptr %new_dims, i64 %new_axis
  %new_dim = load i64, ptr %new_dim.at
  %new_size = mul i64 %size, %new_dim
  br label %new
done:
  ret i32 1
copy:
  ret i32 0
}}
"""

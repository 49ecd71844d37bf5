"""Optimised LLVM bitcode of compiled functions, which any Python and any CPU can turn into code.

numba takes seconds to compile an integrator: it infers types and optimises.  Both depend neither
on the robot nor, with the compiler of this module, on the CPU.  Bitcode contains the result, so
that only machine code must be generated.  It is a module with one function, without the wrapper
that Python calls; the wrapper is compiled for each version of Python.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import llvmlite.binding as llvm
from numba.core import compiler, types
from numba.core.bytecode import FunctionIdentity
from numba.core.environment import Environment
from numba.core.funcdesc import PythonFunctionDescriptor
from numba.core.targetconfig import ConfigStack
from numba.core.typing.templates import signature

from .call_wrapper import COMPILED
from .reshape_code import RESHAPE, RESHAPE_CODE
from .shipped_code import OPTIMISED_FOR, Bitcode

_LEVEL = 3  # of LLVM's optimisation, as in numba
_RESULTS = {str(kind): kind for kind in (types.none, types.int64, types.float64, types.boolean)}
# Symbols of Python and of numba's runtime, and instructions of certain CPUs.
_BOUND = re.compile(r"_?Py|NRT_|_ZN|\.?numba[._]|llvm\.(x86|aarch64)\.")


class PortableCompiler(compiler.Compiler):
    """numba's compiler, which optimises for OPTIMISED_FOR instead of the machine's CPU."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        """Compile a function, and the functions of numba that it needs."""
        with _optimising_for_all(self.state.targetctx.codegen()):
            return super().compile_extra(func)


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
    if OPTIMISED_FOR:
        return target.create_target_machine(cpu=OPTIMISED_FOR, opt=_LEVEL, jit=True)
    features = llvm.get_host_cpu_features().flatten()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=features, opt=_LEVEL, jit=True
    )


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
    if result not in _RESULTS or compiled.reload_init or not _is_portable(module):
        return None
    return Bitcode(result, module.as_bitcode())


def _is_portable(module: Any) -> bool:
    """Return whether a module needs only functions of the C library and of LLVM."""
    values = (*module.functions, *module.global_variables)
    foreign = [value.name for value in values if value.is_declaration]
    return not any(map(_BOUND.match, foreign)) and "target-cpu" not in str(module)


def link_bitcode(dispatcher: Any, arguments: tuple[Any, ...], bitcode: Bitcode) -> Any:
    """Generate machine code of bitcode for this CPU, and a wrapper for this Python.

    Args:
        dispatcher: numba's dispatcher of the function.
        arguments: Types of the arguments.
        bitcode: Bitcode of the function.
    Returns:
        numba's compile result.
    """
    flags = compiler.Flags()
    dispatcher.targetdescr.options.parse_as_flags(flags, dispatcher.targetoptions)
    context = compiler._make_subtarget(dispatcher.targetctx, flags)  # noqa: SLF001
    function = FunctionIdentity.from_function(dispatcher.py_func)
    description = PythonFunctionDescriptor(
        True, function.modname, function.func_qualname, function.unique_name, "", None,
        _RESULTS[bitcode.result], None, tuple(function.arg_names), (), mangler=context.mangler,
        argtypes=arguments, inline=flags.forceinline, noalias=flags.noalias,
        abi_tags=[flags.get_mangle_string()], uid=function.unique_id,
    )  # fmt: skip
    environment = Environment.from_fndesc(description)
    library = context.codegen().create_library(function.func_qualname)
    library.enable_object_caching()
    module = llvm.parse_bitcode(bitcode.module)
    module.get_function(COMPILED).name = description.llvm_func_name
    module.name = library._final_module.name  # noqa: SLF001
    library._final_module = module  # noqa: SLF001
    with ConfigStack().enter(flags.copy()):
        context.create_cpython_wrapper(library, description, environment, None, flags.release_gil)
    # numba would optimise the module again.
    library._finalize_final_module()  # noqa: SLF001
    return compiler.compile_result(
        typing_context=dispatcher.typingctx,
        target_context=context,
        entry_point=context.get_executable(library, description, environment),
        type_annotation="",
        signature=signature(description.restype, *arguments),
        library=library,
        environment=environment,
        fndesc=description,
        objectmode=False,
        lifted=(),
        reload_init=(),
        referenced_envs=(),
    )

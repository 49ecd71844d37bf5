"""Batches on a CUDA device as LLVM IR and PTX: one thread integrates one member.

The step loop is the bitcode that integrates single runs on the CPU (`step_loop.advance`), and the
vector field is the IR of the kernel.  The entry point only addresses the arrays of a member.  A
thread copies the registers of its run, and keeps the work rows, in its local memory.

Devices have no libm, so the module also generates the sine and cosine of angles of any size.

M. H. Payne and R. N. Hanek, Radian reduction for trigonometric functions, SIGNUM Newsletter 18(1),
1983: x = m 2ᵉ with an integer m, so x · 2/π mod 4 needs only a window of the binary digits of 2/π.
The product of m with a window of 256 digits is exact modulo 2²⁵⁶.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import read_only
from ...common.errors import InputError, UnsupportedOperationError
from ...common.machine_code import LLVM_LOCK
from ...common.memo import once, once_for_all
from ...common.object_cache import ObjectCache, cache_key
from ...common.optional_packages import install_command
from ...integrators.integrate import begun_by
from ...integrators.integrate_many import Solutions, checked_batch, solutions
from ...integrators.methods.method import Explicit, Method, stepper_of
from ...integrators.stepping.argument_types import argument_type
from ...integrators.stepping.call_wrapper import COMPILED
from ...integrators.stepping.codes import PAUSED
from ...integrators.stepping.run_state import LAYOUT, NOT_CANONICAL, new_run
from ...integrators.stepping.shipped_code import shipped_name
from ...integrators.stepping.wrapped_code import bitcode_of
from ..build import model_bytes
from ..kernel import Kernel
from ..machine.lowering import lower
from ..machine.sincos import PARTS, constant, declarations, rotated_ir
from ..reduced_graph import ReducedGraph
from .cuda_driver import CAPABILITY, opened_device, run_on_device

_DIGITS = 1225  # number of binary digits of 2/π that the largest angles need
_WINDOW = 32  # length of a window [bytes]
# Angles below 2²⁰ never reach these functions. Their exponent decides the last window.
_TABLE = (2046 - (1023 + 20) + 7) // 8 + _WINDOW


def _two_over_pi() -> int:
    """Return ⌊2/π · 2^_DIGITS⌋, with π = 16 arctan 1/5 − 4 arctan 1/239 (Machin)."""
    one = 1 << (2 * _DIGITS)

    def inverse_arctan(k: int) -> int:
        power, total, n = one // k, 0, 1
        while power:
            total += power // n if n % 4 == 1 else -(power // n)
            power, n = power // (k * k), n + 2
        return total

    pi = 16 * inverse_arctan(5) - 4 * inverse_arctan(239)
    return (one << (_DIGITS + 1)) // pi


def large_angles_ir() -> str:
    """Generate `double @sin(double)` and `double @cos(double)`, for angles of at least 2²⁰ rad.

    The angles may also be infinite or NaN; the results are then NaN.

    Returns:
        The LLVM IR.
    """
    table = "".join(f"\\{byte:02X}" for byte in _two_over_pi().to_bytes(_TABLE, "little"))
    results = "\n".join(
        f"define double @{name}(double %x) nounwind {{\n"
        "%both = call {double, double} @pinred.large(double %x)\n"
        f"%value = extractvalue {{double, double}} %both, {k}\n"
        "ret double %value\n}"
        for k, name in enumerate(("sin", "cos"))
    )
    return f"""\
{declarations(1)}
declare i256 @llvm.ctlz.i256(i256, i1)
@pinred.two_over_pi = internal constant [{_TABLE} x i8] c"{table}"
{rotated_ir()}
define internal {{double, double}} @pinred.large(double %x) noinline nounwind {{
; |x| = m 2^(exponent - 1075); the quotient |x| 2/π is v 2^-254 mod 4.
%sized = bitcast double %x to i64
%shifted = lshr i64 %sized, 52
%exponent = and i64 %shifted, 2047
%fraction = and i64 %sized, {2**52 - 1}
%m = or i64 %fraction, {2**52}
%digits = sub i64 2046, %exponent
%upwards = add i64 %digits, 7
%byte = lshr i64 %upwards, 3
%whole = shl i64 %byte, 3
%rest = sub i64 %whole, %digits
%at = getelementptr i8, ptr @pinred.two_over_pi, i64 %byte
%window = load i256, ptr %at, align 1
%scaled = shl i64 %m, %rest
%wide = zext i64 %scaled to i256
%v = mul i256 %wide, %window
; The nearest multiple of π/2, and the rest as a signed fraction f 2^-256 of π/2.
%rounded = add i256 %v, {2**253}
%quadrant = lshr i256 %rounded, 254
%q = trunc i256 %quadrant to i64
%f = shl i256 %v, 2
%below = icmp slt i256 %f, 0
%minusf = sub i256 0, %f
%size = select i1 %below, i256 %minusf, i256 %f
; Its 106 highest digits, as two numbers h and l, of which 2^-zeros (h + l) is the fraction.
%zeros = call i256 @llvm.ctlz.i256(i256 %size, i1 false)
%normal = shl i256 %size, %zeros
%highbits = lshr i256 %normal, 203
%high = trunc i256 %highbits to i64
%lowbits = lshr i256 %normal, 150
%lower = trunc i256 %lowbits to i64
%low = and i64 %lower, {2**53 - 1}
%h53 = uitofp i64 %high to double
%l106 = uitofp i64 %low to double
%count = trunc i256 %zeros to i64
%power = sub i64 1023, %count
%scalebits = shl i64 %power, 52
%scale = bitcast i64 %scalebits to double
%h0 = fmul double %h53, {constant(2.0**-53)}
%l0 = fmul double %l106, {constant(2.0**-106)}
%h = fmul double %h0, %scale
%l = fmul double %l0, %scale
; r + e = (h + l) π/2
%r = fmul double %h, {constant(PARTS[0])}
%minusr = fneg double %r
%e0 = call double @llvm.fma.f64(double %h, double {constant(PARTS[0])}, double %minusr)
%e1 = call double @llvm.fma.f64(double %h, double {constant(PARTS[1] + PARTS[2])}, double %e0)
%e = call double @llvm.fma.f64(double %l, double {constant(PARTS[0])}, double %e1)
%minuse = fneg double %e
%rs = select i1 %below, double %minusr, double %r
%es = select i1 %below, double %minuse, double %e
%both = call {{double, double}} @pinred.rotated(double %rs, double %es, i64 %q)
; The sine has the sign of x, and both are NaN for infinities and NaN.
%sine = extractvalue {{double, double}} %both, 0
%cosine = extractvalue {{double, double}} %both, 1
%negative = icmp slt i64 %sized, 0
%minussine = fneg double %sine
%signed = select i1 %negative, double %minussine, double %sine
%nan = fsub double %x, %x
%lastsine = fadd double %signed, %nan
%lastcosine = fadd double %cosine, %nan
%first = insertvalue {{double, double}} poison, double %lastsine, 0
%result = insertvalue {{double, double}} %first, double %lastcosine, 1
ret {{double, double}} %result
}}
{results}
"""


ENTRY = "integrate_members"  # name of the entry point
_CPU, _FEATURES = f"sm_{CAPABILITY[0]}{CAPABILITY[1]}", "+ptx80"  # PTX of CUDA 12.0
_TRIPLE = "nvptx64-nvidia-cuda"
_LEVEL = 2  # of code generation
_SQRT = """\
declare double @llvm.sqrt.f64(double)
define double @sqrt(double %x) alwaysinline {
%root = call double @llvm.sqrt.f64(double %x)
ret double %root
}
"""
# Intrinsics of LLVM, and a function of libdevice, that become instructions of the device.
_INTRINSICS = re.compile(
    r"__nvvm_reflect$|llvm\.(nvvm|mem(cpy|set)|lifetime|experimental\.noalias|assume|fma|fmuladd|"
    r"vector\.reduce|sqrt|fabs|floor|ceil|copysign|minnum|maxnum|ctlz|[su](min|max)|abs)\."
)


def ptx_of(kernel: Kernel, method: Explicit) -> bytes:
    """Return the PTX that integrates members with a kernel, from the cache if it is there.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        method: Explicit method.
    Returns:
        The PTX.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    advance = _advance(method)
    loop = advance.py_func.__name__, advance.stamp

    def load() -> bytes:
        forces = None if kernel.forces is None else kernel.forces.key
        settings = asdict(kernel.structure) | {"forces": forces, "ptx": [_CPU, *loop]}
        key = cache_key(model_bytes(kernel.system, kernel.structure.freed), json.dumps(settings))
        return ObjectCache().get_or_compile(
            key, lambda: emit_ptx(device_ir(kernel, method)), f"'{kernel.system.name}' for a device"
        )

    return once(kernel, (ptx_of, *loop), load)


def device_ir(kernel: Kernel, method: Explicit) -> str:
    """Return the IR of all code on the device: step loop, kernel and entry point.

    Args:
        kernel: The kernel.
        method: Explicit method.
    Returns:
        The IR, for the device, with no function undefined.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    # Without states, one number is integrated instead.
    n = max(kernel.layout.size, 1)
    texts = [
        lower(rate, "rate", fma=True),
        _entry(n, kernel.layout.parameters, stepper_of(method).work(n).shape),
        large_angles_ir(),
        _SQRT,
    ]
    loop = _bitcode(_advance(method))
    with LLVM_LOCK:
        context = llvm.create_context()
        module = llvm.parse_bitcode(loop, context)
        module = llvm.parse_assembly(_with_direct_calls(str(module)), context)
        machine = _machine()
        for text in texts:
            module.link_in(llvm.parse_assembly(text, context))
        missing = _settle(module, machine)
        if missing and (library := _libdevice()) is not None:
            library = llvm.parse_bitcode(library, context)
            known = {function.name for function in library.functions if not function.is_declaration}
            text = _with_names_of_libdevice(str(module), missing, known)
            module.close()
            module = llvm.parse_assembly(text, context)
            module.link_in(library)
            missing = _settle(module, machine)
        ir = str(module)
        module.close()  # before its context is deleted
    if missing:
        raise UnsupportedOperationError(
            f"device: {method.name} or the forces on '{kernel.system.name}' need "
            f"{', '.join(missing)}, for which there is no device code. {_remedy()}, or integrate "
            "without device"
        )
    return ir


def emit_ptx(ir: str) -> bytes:
    """Generate the PTX of `device_ir`."""
    with LLVM_LOCK:
        context = llvm.create_context()
        module = llvm.parse_assembly(ir, context)
        text: str = _machine().emit_assembly(module)
        module.close()  # before its context is deleted
    return text.encode()


def _settle(module: Any, machine: Any) -> list[str]:
    """Inline and remove functions of a module for the device; return the names that it lacks."""
    module.triple, module.data_layout = _TRIPLE, str(machine.target_data)
    for function in module.functions:
        if not function.is_declaration and function.name != ENTRY:
            function.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    names = [function.name for function in module.functions if function.is_declaration]
    return sorted(name for name in names if not _INTRINSICS.match(name))


def _machine() -> Any:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(_TRIPLE)
    return target.create_target_machine(cpu=_CPU, features=_FEATURES, opt=_LEVEL)


# --- libdevice: NVIDIA's functions of libm ---------------------------------------------------


def _with_names_of_libdevice(ir: str, names: list[str], known: set[str]) -> str:
    """Call functions of libm, and LLVM's intrinsics of them, by their names in libdevice."""
    declared: set[str] = set()
    for name in names:
        own = f"__nv_{name.removeprefix('llvm.').removesuffix('.f64')}"
        if own not in known:
            continue
        if own in declared:  # once for the function, and once for the intrinsic
            ir = re.sub(rf"^declare .*@{re.escape(name)}\(.*$", "", ir, flags=re.M)
        ir = ir.replace(f"@{name}(", f"@{own}(")
        declared.add(own)
    return ir


@once_for_all
def _libdevice() -> bytes | None:
    """Return the bitcode of libdevice, None if it is not installed."""
    try:
        pathfinder = import_module("cuda.pathfinder")
        return Path(pathfinder.find_bitcode_lib("device")).read_bytes()
    except (ImportError, RuntimeError):
        return None


def _remedy() -> str:
    if _libdevice() is None:
        return f"Install NVIDIA's libdevice: {install_command('ptxas')}"
    return "Use a method and forces without these functions"


# --- step loop ------------------------------------------------------------------------------


def _advance(method: Explicit) -> Any:
    """Return the compiled step loop of single runs."""
    return stepper_of(method).loops.advance


@once_for_all
def _bitcode(advance: Any) -> bytes:
    """Return the bitcode of a step loop: what is shipped, or else what numba compiles."""
    numbers, rows = np.zeros(2), np.zeros((2, 2))
    fixed = read_only(np.zeros(2))
    arguments = (new_run(), fixed, rows, fixed, rows, numbers, rows)
    types = tuple(kind for kind in map(argument_type, arguments) if kind is not None)
    name = shipped_name(advance.py_func, types, advance.stamp)
    return bitcode_of(advance, name, types).module


def _with_direct_calls(ir: str) -> str:
    """Call the kernel by its name, not by its address: a step loop has no other such calls."""
    calls = re.sub(r"\bcall void %\d+\(", "call void @rate(", ir)
    return f"{calls}\ndeclare void @rate(ptr, ptr, ptr)"


# --- entry point ----------------------------------------------------------------------------


def _array(data: str, itemsize: int, size: str, *shape: str | int) -> str:
    """Write the arguments that numba's functions take for an array in C order.

    Args:
        data: Pointer to the entries.
        itemsize: Size of an entry [bytes].
        size: Number of entries.
        shape: Lengths of the axes; all but the first are numbers.
    Returns:
        Memory that numba manages, the Python object, size, bytes of an entry, data, and axes.
    """
    strides = [itemsize]
    for length in shape[:0:-1]:
        strides.insert(0, strides[0] * int(length))
    numbers = ", ".join(f"i64 {number}" for number in (*shape, *strides))
    return f"ptr null, ptr null, i64 {size}, i64 {itemsize}, ptr {data}, {numbers}"


def _entry(n: int, parameters: int, rows: tuple[int, ...]) -> str:
    """Generate the entry point. Each thread executes it for one member.

    Its arguments are N, T, and R, the number of rows of report times, 1 or N; then the addresses of
    runs (N,), parameters (N, p), initial states (N, n), report times (R, T), states (N, T, n), and
    of the values that `advance` returns (N,).

    Args:
        n: Number of entries of the state.
        parameters: Number of parameters.
        rows: Shape of the work rows.
    Returns:
        The LLVM IR.
    """
    run, (count, stride) = LAYOUT.itemsize, rows
    arguments = ", ".join([
        "ptr %result", "ptr %error",
        _array("%run", run, "1", "1"),
        _array("%params", 8, str(parameters), parameters),
        _array("%work", 8, str(count * stride), count, stride),
        _array("%times", 8, "%T", "%T"),
        _array("%y", 8, "%numbers", "%T", n),
        _array("%nothing", 8, "0", 0),
        _array("%nothing", 8, "0", 0, n),
    ])  # fmt: skip
    kinds = ", ".join(argument.split()[0] for argument in arguments.split(", "))
    special = ("tid", "ctaid", "ntid")
    reads = "\n".join(
        f"%{name}32 = call i32 @llvm.nvvm.read.ptx.sreg.{name}.x()\n"
        f"%{name} = zext i32 %{name}32 to i64"
        for name in special
    )
    return f"""\
declare i32 @{COMPILED}({kinds})
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
{"".join(f"declare i32 @llvm.nvvm.read.ptx.sreg.{name}.x(){chr(10)}" for name in special)}
define ptx_kernel void @{ENTRY}(i64 %N, i64 %T, i64 %R, ptr %allruns, ptr %allparams,
                                ptr %ally0, ptr %alltimes, ptr %ally, ptr %allstatus) {{
%run = alloca [{run} x i8], align 8
%work = alloca [{count * stride} x double], align 32
%result = alloca i64
%error = alloca i64
%nothing = alloca i64
{reads}
%before = mul i64 %ctaid, %ntid
%member = add i64 %before, %tid
%ismember = icmp slt i64 %member, %N
br i1 %ismember, label %integrate, label %end
integrate:
%numbers = mul i64 %T, {n}
%params.first = mul i64 %member, {parameters}
%y0.first = mul i64 %member, {n}
%times.row = urem i64 %member, %R
%times.first = mul i64 %times.row, %T
%y.first = mul i64 %member, %numbers
%own = getelementptr [{run} x i8], ptr %allruns, i64 %member
%params = getelementptr double, ptr %allparams, i64 %params.first
%y0 = getelementptr double, ptr %ally0, i64 %y0.first
%times = getelementptr double, ptr %alltimes, i64 %times.first
%y = getelementptr double, ptr %ally, i64 %y.first
%status = getelementptr i64, ptr %allstatus, i64 %member
call void @llvm.memcpy.p0.p0.i64(ptr %run, ptr %own, i64 {run}, i1 false)
call void @llvm.memset.p0.i64(ptr %work, i8 0, i64 {8 * count * stride}, i1 false)
call void @llvm.memcpy.p0.p0.i64(ptr %work, ptr %y0, i64 {8 * n}, i1 false)
%code = call i32 @{COMPILED}({arguments})
%value = load i64, ptr %result
store i64 %value, ptr %status
call void @llvm.memcpy.p0.p0.i64(ptr %own, ptr %run, i64 {run}, i1 false)
br label %end
end:
ret void
}}
"""


_NO_PAUSE = 2**62  # number of evaluations before a run pauses


def integrate_on_device(
    method: Method,
    kernel: Kernel,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for all members i, one member per thread.

    The step loop and its numbers are those of `integrate`. A device may round the kernel and its
    sines differently, so the results agree up to round-off and its growth.

    Args:
        method: Explicit method, such as DOP853.
        kernel: Kernel of f.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times, (T,) or (N, T), as for `integrate_many` [s].
    Returns:
        The solutions, member first.
    Raises:
        InputError: An argument is invalid.
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    if not isinstance(method, Explicit):
        raise InputError(
            f"method: expected DOP853 or Tsit5 on a device, got {method.name}. Choose one of them"
        )
    opened_device()  # report a missing device before its code is generated
    quaternions = kernel.layout.quaternions
    asked = checked_batch(kernel.rate.address, params, y0, t_end, times, quaternions, 1)
    batch = asked.batch
    (size, n), (rows, columns) = batch.y0.shape, batch.times.shape
    first = begun_by(method, kernel.rate.address, n, asked.end, quaternions, NOT_CANONICAL)
    runs = np.repeat(first, size)
    runs["t_end"], runs["budget"] = batch.ends, _NO_PAUSE
    status = np.full(size, PAUSED)
    arrays = (runs, batch.params, batch.y0, batch.times, batch.y, status)
    run_on_device(ptx_of(kernel, method), ENTRY, size, (size, columns, rows, *arrays))
    batch.outcomes["status"] = status
    for name in ("t", "entry", "steps", "rejected", "evaluations"):
        batch.outcomes[name] = runs[name]
    return solutions(method, batch)

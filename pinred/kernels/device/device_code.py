"""Batches on a CUDA device as LLVM IR and PTX: one thread integrates one member, or a group does.

The step loop is bitcode with the operations of single runs on the CPU, on fewer work rows
(`few_rows.py`), and the vector field is the IR of the kernel.  The entry point only addresses the
arrays of a member.  A thread copies the registers of its run, and keeps the work rows, in its local
memory.  Another entry point computes fields of states from reduced states, one state per thread.

Devices have no libm, so the module also generates the sine and cosine of angles of any size.

M. H. Payne and R. N. Hanek, Radian reduction for trigonometric functions, SIGNUM Newsletter 18(1),
1983: x = m 2ᵉ with an integer m, so x · 2/π mod 4 needs only a window of the binary digits of 2/π.
The product of m with a window of 256 digits is exact modulo 2²⁵⁶.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import llvmlite.binding as llvm
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...common.arrays import Array, read_only
from ...common.errors import UnsupportedOperationError, install_command
from ...common.machine_code import LLVM_LOCK
from ...common.memo import once, once_for_all
from ...common.object_cache import ObjectCache, cache_key
from ...integrators.integrate import begun_by
from ...integrators.integrate_many import Solutions, checked_batch, solutions
from ...integrators.methods.method import Explicit
from ...integrators.stepping.call_wrapper import COMPILED, argument_type
from ...integrators.stepping.run_state import LAYOUT, NOT_CANONICAL, new_run
from ...integrators.stepping.shipped_code import bitcode_of, shipped_name
from ...integrators.stepping.step_loop import OUTCOME
from ...reduction.tree.identical_branches import Mark
from ...system.state_fields import FIELDS
from ..build import model_bytes
from ..differentiable import joined_tangent
from ..kernel import Kernel, in_given_order
from ..machine.lowering import lower
from ..machine.sincos import PARTS, constant, declarations, rotated_ir
from ..reduced_graph import ReducedGraph
from .cuda_driver import CAPABILITY, Launch, opened_devices, run_on_devices
from .equal_limbs import Group, group_of
from .few_rows import GROUP_CALLS, stepper_with_few_rows

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
OUTPUTS_ENTRY = "evaluate_outputs"
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


def ptx_of(kernel: Kernel, method: Explicit, *, tangent: bool = False) -> bytes:
    """Return the PTX that integrates members with a kernel, from the cache if it is there.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        method: Explicit method.
        tangent: Whether members carry a tangent.
    Returns:
        The PTX.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    group = group_of(kernel, tangent=tangent)
    advance: Any = stepper_with_few_rows(
        method, tangent=tangent, group=group is not None
    ).loops.advance
    loop = advance.py_func.__name__, advance.stamp
    return _cached_ptx(kernel, loop, lambda: device_ir(kernel, method, tangent=tangent))


def outputs_ptx(kernel: Kernel, names: Sequence[str]) -> bytes:
    """Return the PTX that computes fields of states, from the cache if it is there.

    Args:
        kernel: The kernel.
        names: Names of the fields.
    Returns:
        The PTX.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    return _cached_ptx(kernel, ("outputs", *names), lambda: outputs_ir(kernel, names))


def _cached_ptx(kernel: Kernel, kind: tuple[str, ...], make_ir: Callable[[], str]) -> bytes:
    def load() -> bytes:
        forces = None if kernel.forces is None else kernel.forces.key
        settings = asdict(kernel.structure) | {"forces": forces, "ptx": [_CPU, *kind]}
        key = cache_key(model_bytes(kernel.system, kernel.structure.freed), json.dumps(settings))
        return ObjectCache().get_or_compile(
            key, lambda: emit_ptx(make_ir()), f"'{kernel.system.name}' for a device"
        )

    return once(kernel, (_cached_ptx, *kind), load)


def device_ir(kernel: Kernel, method: Explicit, *, tangent: bool = False) -> str:
    """Return the IR that integrates members: step loop, kernel and entry point.

    Args:
        kernel: The kernel.
        method: Explicit method.
        tangent: Whether members carry a tangent: their states and parameters are followed by
            directions.
    Returns:
        The IR, for the device, with no function undefined.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    # Without states, one number is integrated instead.
    n, parameters = max(kernel.layout.size, 1), kernel.layout.parameters
    group = group_of(kernel, tangent=tangent)
    stepper = stepper_with_few_rows(method, tangent=tangent, group=group is not None)
    if group is not None:
        field, rows = group.ir, stepper.work(len(group.places[0])).shape
    else:
        rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
        marks: list[Mark] | None = None
        if tangent:
            rate, marks = joined_tangent(rate, "rate"), []
            n, parameters = 2 * n, 2 * parameters
        field, rows = lower(rate, "rate", marks, fma=True), stepper.work(n).shape
    texts = [field, _entry(n, parameters, rows, group)]
    user = f"{method.name} or the forces"
    return _linked_ir(kernel, user, texts, ENTRY, bitcode_of_loop(stepper.loops.advance))


def outputs_ir(kernel: Kernel, names: Sequence[str]) -> str:
    """Return the IR that computes fields of states, one state per thread.

    Args:
        kernel: The kernel.
        names: Names of the fields; nothing else is computed.
    Returns:
        The IR, for the device, with no function undefined.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    every = ReducedGraph(kernel.system, kernel.structure, kernel.forces).outputs()
    inputs = every.sx_in()
    slices = [kernel.where.fields[name] for name in names]
    wanted = ca.vertcat(*[every(*inputs)[part] for part in slices])
    outputs = ca.Function("outputs", inputs, [ca.densify(wanted)], {"cse": True})
    entry = _outputs_entry(kernel, inputs[1].numel(), [part.stop - part.start for part in slices])
    texts = [lower(outputs, "outputs", fma=True), entry]
    return _linked_ir(kernel, "states", texts, OUTPUTS_ENTRY)


def _linked_ir(
    kernel: Kernel, user: str, texts: list[str], entry: str, loop: bytes | None = None
) -> str:
    """Link IR with what devices lack.

    Args:
        kernel: The kernel.
        user: What the code computes, for messages.
        texts: IR.
        entry: Name of the entry point.
        loop: Bitcode of a step loop, None for none.
    Returns:
        The IR, for the device, with no function undefined.
    Raises:
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    texts = [*texts, large_angles_ir(), _SQRT]
    with LLVM_LOCK:
        context = llvm.create_context()
        machine = _machine()
        if loop is None:
            module = llvm.parse_assembly(texts.pop(0), context)
        else:
            module = llvm.parse_bitcode(loop, context)
            module = llvm.parse_assembly(_with_direct_calls(str(module)), context)
        for text in texts:
            module.link_in(llvm.parse_assembly(text, context))
        missing = _settle(module, machine, entry)
        if missing and (library := _libdevice()) is not None:
            library = llvm.parse_bitcode(library, context)
            known = {function.name for function in library.functions if not function.is_declaration}
            text = _with_names_of_libdevice(str(module), missing, known)
            module.close()
            module = llvm.parse_assembly(text, context)
            module.link_in(library)
            missing = _settle(module, machine, entry)
        ir = str(module)
        module.close()  # before its context is deleted
    if missing:
        raise UnsupportedOperationError(
            f"device: {user} on '{kernel.system.name}' need "
            f"{', '.join(missing)}, for which there is no device code. {_remedy()}, or integrate "
            "without device"
        )
    return ir


def emit_ptx(ir: str) -> bytes:
    """Generate the PTX of code for the device."""
    with LLVM_LOCK:
        context = llvm.create_context()
        module = llvm.parse_assembly(ir, context)
        text: str = _machine().emit_assembly(module)
        module.close()  # before its context is deleted
    return text.encode()


def _settle(module: Any, machine: Any, entry: str) -> list[str]:
    """Inline and remove functions of a module for the device; return the names that it lacks."""
    module.triple, module.data_layout = _TRIPLE, str(machine.target_data)
    for function in module.functions:
        if not function.is_declaration and function.name != entry:
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


def loop_arguments() -> tuple[Any, ...]:
    """Return arguments of a step loop, for a run that has reached its end."""
    numbers, rows = np.zeros(2), np.zeros((2, 2))
    fixed = read_only(np.zeros(2))
    return new_run(begun=1), fixed, rows, fixed, rows, numbers, rows


@once_for_all
def bitcode_of_loop(advance: Any) -> bytes:
    """Return the bitcode of a step loop: what is shipped, or else what numba compiles."""
    types = tuple(kind for kind in map(argument_type, loop_arguments()) if kind is not None)
    name = shipped_name(advance.py_func, types, advance.stamp)
    return bitcode_of(advance, name, types).module


def _with_direct_calls(ir: str) -> str:
    """Return the code with calls of the kernel and of a group's functions by name, not by address.

    A step loop has no other such calls.
    """
    calls = re.sub(r"\bcall void %\d+\(", "call void @rate(", ir)
    for address, name in GROUP_CALLS.items():
        calls = calls.replace(f" inttoptr (i64 {address} to ptr)(", f" @{name}(")
    return f"""\
{calls}
declare void @rate(ptr, ptr, ptr)
declare double @pinred.sum(double)
declare i64 @pinred.first(i64)
declare i64 @pinred.entry(i64)
"""


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


def _thread_ir(size: str) -> str:
    """Generate the start of an entry point: `%thread`, and the end of threads beyond `size`."""
    special = ("tid", "ctaid", "ntid")
    reads = "\n".join(
        f"%{name}32 = call i32 @llvm.nvvm.read.ptx.sreg.{name}.x()\n"
        f"%{name} = zext i32 %{name}32 to i64"
        for name in special
    )
    return f"""\
{reads}
%before = mul i64 %ctaid, %ntid
%thread = add i64 %before, %tid
%isthread = icmp slt i64 %thread, {size}
br i1 %isthread, label %begin, label %end
begin:"""


_SPECIAL = "\n".join(
    f"declare i32 @llvm.nvvm.read.ptx.sreg.{name}.x()" for name in ("tid", "ctaid", "ntid")
)


def _entry(n: int, parameters: int, rows: tuple[int, ...], group: Group | None) -> str:
    """Generate the entry point. Each thread executes it for one member, or for its part of one.

    Its arguments are N, T, and R, the number of rows of report times, 1 or N; then the addresses of
    the registers of all runs (1,), parameters (N, p), initial states (N, n), end times (N,), report
    times (R, T), states (N, T, n), and outcomes (N,).

    Args:
        n: Number of entries of the state.
        parameters: Number of parameters.
        rows: Shape of the work rows.
        group: What the threads of a member divide, None if a member has one thread.
    Returns:
        The LLVM IR.
    """
    run, (count, stride) = LAYOUT.itemsize, rows
    threads = 1 if group is None else len(group.places)
    start = f"call void @llvm.memcpy.p0.p0.i64(ptr %work, ptr %y0, i64 {8 * n}, i1 false)"
    places = ""
    if group is not None:
        last = (count - 1) * stride
        start = "\n".join(
            f"%place{k}.at = getelementptr [{threads} x i64], ptr addrspace(1) @places, i64 {k}, "
            f"i64 %lane\n"
            f"%place{k} = load i64, ptr addrspace(1) %place{k}.at\n"
            f"%y0.{k} = getelementptr double, ptr %y0, i64 %place{k}\n"
            f"%value{k} = load double, ptr %y0.{k}\n"
            f"%work{k} = getelementptr double, ptr %work, i64 {k}\n"
            f"store double %value{k}, ptr %work{k}\n"
            f"%number{k} = sitofp i64 %place{k} to double\n"
            f"%places{k} = getelementptr double, ptr %work, i64 {last + k}\n"
            f"store double %number{k}, ptr %places{k}"
            for k in range(len(group.places[0]))
        )
        table = [row for column in zip(*group.places, strict=True) for row in column]
        entries = ", ".join(f"i64 {place}" for place in table)
        places = f"""\
@places = internal addrspace(1) constant [{len(table)} x i64] [{entries}]
declare i64 @pinred.lane()
define i64 @pinred.entry(i64 %index) nounwind {{
%lane = call i64 @pinred.lane()
%at = getelementptr [{threads} x i64], ptr addrspace(1) @places, i64 %index, i64 %lane
%entry = load i64, ptr addrspace(1) %at
ret i64 %entry
}}"""
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
    registers, outcome = LAYOUT.fields, OUTCOME.fields
    assert registers is not None
    assert outcome is not None
    stores = "\n".join(
        f"%{name}.from = getelementptr i8, ptr %run, i64 {registers[name][1]}\n"
        f"%{name}.to = getelementptr i8, ptr %outcome, i64 {outcome[name][1]}\n"
        f"%{name}.of = load i64, ptr %{name}.from\n"
        f"store i64 %{name}.of, ptr %{name}.to"
        for name in ("t", "entry", "steps", "rejected", "evaluations")
    )
    return f"""\
declare i32 @{COMPILED}({kinds})
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
{_SPECIAL}
{places}
define ptx_kernel void @{ENTRY}(i64 %N, i64 %T, i64 %R, ptr %allruns, ptr %allparams, ptr %ally0,
                                ptr %allends, ptr %alltimes, ptr %ally, ptr %alloutcomes) {{
%run = alloca [{run} x i8], align 8
%work = alloca [{count * stride} x double], align 32
%result = alloca i64
%error = alloca i64
%nothing = alloca i64
%threads = mul i64 %N, {threads}
{_thread_ir("%threads")}
%member = udiv i64 %thread, {threads}
%lane = urem i64 %thread, {threads}
%numbers = mul i64 %T, {n}
%params.first = mul i64 %member, {parameters}
%y0.first = mul i64 %member, {n}
%times.row = urem i64 %member, %R
%times.first = mul i64 %times.row, %T
%y.first = mul i64 %member, %numbers
%params = getelementptr double, ptr %allparams, i64 %params.first
%y0 = getelementptr double, ptr %ally0, i64 %y0.first
%end.from = getelementptr double, ptr %allends, i64 %member
%times = getelementptr double, ptr %alltimes, i64 %times.first
%y = getelementptr double, ptr %ally, i64 %y.first
%outcome = getelementptr [{OUTCOME.itemsize} x i8], ptr %alloutcomes, i64 %member
call void @llvm.memcpy.p0.p0.i64(ptr %run, ptr %allruns, i64 {run}, i1 false)
%end.to = getelementptr i8, ptr %run, i64 {registers["t_end"][1]}
%end.time = load double, ptr %end.from
store double %end.time, ptr %end.to
call void @llvm.memset.p0.i64(ptr %work, i8 0, i64 {8 * count * stride}, i1 false)
{start}
%code = call i32 @{COMPILED}({arguments})
%status = load i64, ptr %result
%status.to = getelementptr i8, ptr %outcome, i64 {outcome["status"][1]}
store i64 %status, ptr %status.to
{stores}
%next.from = getelementptr i8, ptr %run, i64 {registers["next"][1]}
%next = load i64, ptr %next.from
%missing.first = mul i64 %next, {n}
br label %missing
; States at times that the run did not reach are NaN.
missing:
%k = phi i64 [ %missing.first, %begin ], [ %k.next, %fill ]
%ismissing = icmp slt i64 %k, %numbers
br i1 %ismissing, label %fill, label %end
fill:
%at = getelementptr double, ptr %y, i64 %k
store double {constant(math.nan)}, ptr %at
%k.next = add i64 %k, 1
br label %missing
end:
ret void
}}
"""


def _outputs_entry(kernel: Kernel, constants: int, sizes: Sequence[int]) -> str:
    """Generate the entry point of outputs. Each thread executes it for one state.

    Its arguments are N and T; then the addresses of constants (N, c), states (N, T, n), times (T,),
    and of each field (N, T, size).

    Args:
        kernel: The kernel.
        constants: Number of constants.
        sizes: Number of entries of each field.
    Returns:
        The LLVM IR.
    """
    fields = ", ".join(f"ptr %field{k}" for k in range(len(sizes)))
    copies, first = "", 0
    for k, size in enumerate(sizes):
        copies += (
            f"%from{k} = getelementptr double, ptr %out, i64 {first}\n"
            f"%offset{k} = mul i64 %thread, {size}\n"
            f"%to{k} = getelementptr double, ptr %field{k}, i64 %offset{k}\n"
            f"call void @llvm.memcpy.p0.p0.i64(ptr %to{k}, ptr %from{k}, i64 {8 * size}, i1 0)\n"
        )
        first += size
    entries = kernel.layout.size
    return f"""\
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare void @outputs(ptr, ptr, ptr)
{_SPECIAL}
define ptx_kernel void @{OUTPUTS_ENTRY}(i64 %N, i64 %T, ptr %allconstants, ptr %ally, ptr %times,
                                        {fields}) {{
%row = alloca [{entries + 1} x double], align 8
%out = alloca [{first} x double], align 8
%threads = mul i64 %N, %T
{_thread_ir("%threads")}
%member = udiv i64 %thread, %T
%j = urem i64 %thread, %T
%constants.first = mul i64 %member, {constants}
%constants = getelementptr double, ptr %allconstants, i64 %constants.first
%y.first = mul i64 %thread, {max(entries, 1)}
%y = getelementptr double, ptr %ally, i64 %y.first
call void @llvm.memcpy.p0.p0.i64(ptr %row, ptr %y, i64 {8 * entries}, i1 false)
%time.from = getelementptr double, ptr %times, i64 %j
%time = load double, ptr %time.from
; It is no input if the state contains the time.
%time.to = getelementptr double, ptr %row, i64 {entries}
store double %time, ptr %time.to
call void @outputs(ptr %row, ptr %constants, ptr %out)
{copies}br label %end
end:
ret void
}}
"""


_NO_PAUSE = 2**62  # number of evaluations before a run pauses


def integrate_on_device(
    method: Explicit,
    kernel: Kernel,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
    progress: Callable[[float], None] | None = None,
    *,
    tangent: bool = False,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for all members i, one member per thread or group.

    The step loop and its numbers are those of `integrate`. A device may round the kernel and its
    sines differently, so the results agree up to round-off and its growth.

    Args:
        method: Explicit method, such as DOP853.
        kernel: Kernel of f.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times, (T,) or (N, T), as for `integrate_many` [s].
        progress: Called with the completed fraction of the members.
        tangent: Whether members carry a tangent: y0 is (N, 2 n) and params (N, 2 p), with
            directions in their second halves, and the states of the solutions are (…, 2 n).
    Returns:
        The solutions, member first.
    Raises:
        InputError: An argument is invalid.
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    opened_devices()  # report a missing device before its code is generated
    quaternions = kernel.layout.quaternions
    asked = checked_batch(kernel.rate.address, params, y0, t_end, times, quaternions, 1)
    batch = asked.batch
    n, (rows, columns) = batch.y0.shape[1], batch.times.shape
    group = group_of(kernel, tangent=tangent)
    if group is not None:
        n, (first, count) = len(group.places[0]), quaternions
        quaternions = (group.places[0].index(first) if count else 0), count
    run = begun_by(method, kernel.rate.address, n, asked.end, quaternions, NOT_CANONICAL)
    run["budget"] = _NO_PAUSE
    if group is not None:
        run["lanes"], run["pairs"] = len(group.places), group.own
    launch = Launch(
        ptx_of(kernel, method, tangent=tangent),
        ENTRY,
        (columns, rows),
        (run, batch.params, batch.y0, batch.ends, batch.times),
        (batch.y, batch.outcomes),
        1 if group is None else len(group.places),
    )
    run_on_devices(launch, progress)
    return solutions(method, batch)


def fill_fields_on_device(
    kernel: Kernel,
    constants: Array,
    y: Array,
    times: Array,
    members: NDArray[np.int64],
    fields: Mapping[str, Array],
) -> None:
    """Compute fields of the states of N members on CUDA devices, one state per thread.

    Args:
        kernel: The kernel.
        constants: Inputs of the outputs besides states and time, (N, c).
        y: Reduced states, (N, T, k).
        times: Times, (T,) [s].
        members: Row of each member in `fields`, (N,) sorted.
        fields: Fields of State except the time, (M, T, …), of which the members' rows are filled.
    Raises:
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
        UnsupportedOperationError: The code needs a function that devices do not have.
    """
    opened_devices()
    results = {}
    for name, field in fields.items():
        part = kernel.where.fields[name]
        # Other fields have the joints in another order, or rows of other members.
        direct = len(members) == len(field) and FIELDS[name].axis not in ("nq", "nv")
        shape = (*y.shape[:2], part.stop - part.start)
        results[name] = field if direct else np.empty(shape)
    launch = Launch(
        outputs_ptx(kernel, tuple(fields)),
        OUTPUTS_ENTRY,
        (len(times),),
        (constants, np.ascontiguousarray(y), times[None]),
        tuple(results.values()),
        each=len(times),
    )
    run_on_devices(launch)
    for name, values in results.items():
        if values is not fields[name]:
            fields[name][members] = in_given_order(name, values, kernel.system)

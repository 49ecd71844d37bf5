"""A stand-in for `cuda.bindings.driver`: memory and threads of devices are those of the CPU.

Its modules are LLVM IR instead of PTX.  The IR is compiled for the CPU without changes, except
that the numbers of a thread and its block come from the stand-in.  Threads run one after another;
those of a warp that exchange numbers run in turn, each on its own stack, from one exchange to the
next.  What is put into a stream waits there until the stream is synchronised, so results that are
read too early, or inputs that change too early, are wrong.
"""

from __future__ import annotations

import ctypes
import re
import sys
from collections import OrderedDict
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from importlib.util import find_spec
from itertools import count
from types import ModuleType
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest

from pinred.common.machine_code import LLVM_LOCK, NativeCode, create_machine, load_object
from pinred.common.memo import once_for_all
from pinred.integrators.methods.method import Explicit
from pinred.kernels.device import cuda_driver, device_code
from pinred.kernels.device.device_code import device_ir, outputs_ir
from pinred.kernels.kernel import Kernel

_NUMBERS = {name: ctypes.c_int32() for name in ("tid", "ctaid", "ntid")}  # of the current thread
_WARP = 32  # threads
# Bytes of the stack of a thread, and of the C library's context and place in a function.
_STACK, _CONTEXT, _PLACE = 2**18, 2**12, 2**9


def _plain(operation: str, kinds: str, kind: str = "double") -> tuple[str, list[str], str]:
    """Return result, arguments and body of a function that is one instruction."""
    return kind, kinds.split(), f"%value = {operation}\nret {kind} %value"


def _half(shift: int) -> tuple[str, list[str], str]:
    """Return a function that takes one half of the bits of a number."""
    body = f"%bits = bitcast double %x to i64\n%moved = lshr i64 %bits, {shift}"
    return "i32", ["double"], f"{body}\n%value = trunc i64 %moved to i32\nret i32 %value"


_JOINED = """\
%low = zext i32 %x to i64
%half = zext i32 %y to i64
%high = shl i64 %half, 32
%bits = or i64 %low, %high
%value = bitcast i64 %bits to double
ret double %value"""
# The instructions of a device that libdevice uses: result, arguments, and body for the CPU.
_LIBDEVICE = {
    "__nvvm_reflect": ("i32", ["ptr"], "ret i32 0"),
    "llvm.nvvm.add.rn.d": _plain("fadd double %x, %y", "double double"),
    "llvm.nvvm.mul.rn.d": _plain("fmul double %x, %y", "double double"),
    "llvm.nvvm.fma.rn.d": _plain(
        "call double @llvm.fma.f64(double %x, double %y, double %z)", "double double double"
    ),
    "llvm.nvvm.fmin.d": _plain(
        "call double @llvm.minnum.f64(double %x, double %y)", "double double"
    ),
    "llvm.nvvm.rcp.approx.ftz.d": _plain("fdiv double 1.0, %x", "double"),
    "llvm.nvvm.trunc.d": _plain("call double @llvm.trunc.f64(double %x)", "double"),
    "llvm.nvvm.round.f": _plain("call float @llvm.rint.f32(float %x)", "float", "float"),
    "llvm.nvvm.ex2.approx.ftz.f32": _plain("call float @llvm.exp2.f32(float %x)", "float", "float"),
    "llvm.nvvm.fabs.f64": _plain("call double @llvm.fabs.f64(double %x)", "double"),
    "llvm.nvvm.fabs.f32": _plain("call float @llvm.fabs.f32(float %x)", "float", "float"),
    "llvm.nvvm.fabs.ftz.f32": _plain("call float @llvm.fabs.f32(float %x)", "float", "float"),
    "llvm.nvvm.d2i.rn": _plain("fptosi double %x to i32", "double", "i32"),
    "llvm.nvvm.d2i.hi": _half(32),
    "llvm.nvvm.d2i.lo": _half(0),
    "llvm.nvvm.lohi.i2d": ("double", ["i32", "i32"], _JOINED),
}
_ASSEMBLY = """
declare void @llvm.trap()
define { i64, i64 } @host.abort() {
call void @llvm.trap()
unreachable
}
define double @host.inverse_root(double %x) {
%root = call double @llvm.sqrt.f64(double %x)
%value = fdiv double 1.0, %root
ret double %value
}
"""


class _Warp:
    """Threads that exchange numbers: contexts of the C library, which continue one another.

    A thread stores its number, continues the next thread of the mask, and reads the numbers of
    others when its turn comes again.  Exchanges of even and odd numbers have different memory,
    since the threads before it have already stored their next numbers.
    """

    def __init__(self) -> None:
        self.library = ctypes.CDLL(None)
        self.contexts = np.zeros((_WARP + 1, _CONTEXT), np.uint8)  # the last is that of the launch
        self.places = np.zeros((_WARP, _PLACE), np.uint8)
        self.stacks = np.zeros((_WARP + 1, _STACK), np.uint8)
        self.numbers = np.zeros((2, _WARP), np.int32)
        self.exchanges = np.zeros(_WARP, np.int64)
        self.ended = np.zeros(_WARP, np.int64)
        self.mixed = np.zeros(1, np.int64)  # whether a thread read a number of another exchange
        self.arguments = np.zeros(32, np.int64)

    def run(self, start: int, arguments: list[int], first: int, count: int) -> None:
        """Run threads first … first + count − 1 of a block."""
        self.exchanges[:], self.ended[:], self.mixed[:] = 0, 0, 0
        self.arguments[: len(arguments)] = arguments
        for k in range(count):
            self._prepare(k, start)
        for k in range(count):
            if self.ended[k]:
                continue
            _NUMBERS["tid"].value = first + k
            if self.exchanges[k]:  # it continues, after another thread of its group has ended
                self._prepare(k, start)
            self.library.swapcontext(self._context(_WARP), self._context(k))
            assert self.ended[k], f"thread {k} waits for others"
        assert not self.mixed[0], "threads of a group made different exchanges"

    def _context(self, k: int) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.contexts[k].ctypes.data)

    def _prepare(self, k: int, address: int) -> None:
        """Let a context begin with a function."""
        assert self.library.getcontext(self._context(k)) == 0
        # The fields after flags: the context that follows; address, flags and size of the stack.
        stack = self.stacks[k] if not self.exchanges[k] else self.stacks[_WARP]
        fields = self.contexts[k, 8:40].view(np.int64)
        fields[:] = np.array([self._context(_WARP).value, stack.ctypes.data, 0, _STACK])
        self.library.makecontext(self._context(k), ctypes.c_void_p(address), 0)

    def code(self, entry: str, parameters: int) -> str:
        """Return the IR of the first function of each thread, and of exchanges."""
        at = {
            name: f"inttoptr (i64 {getattr(self, name).ctypes.data} to ptr)"
            for name in (
                "contexts",
                "places",
                "numbers",
                "exchanges",
                "ended",
                "mixed",
                "arguments",
            )
        }
        tid = f"inttoptr (i64 {ctypes.addressof(_NUMBERS['tid'])} to ptr)"
        loads = "\n".join(
            f"%p{k} = getelementptr i64, ptr {at['arguments']}, i64 {k}\n"
            f"%a{k} = load i64, ptr %p{k}"
            for k in range(parameters)
        )
        kinds = _kinds_of(entry)
        values = [f"i64 %a{k}" if kind == "i64" else f"ptr %q{k}" for k, kind in enumerate(kinds)]
        casts = "\n".join(
            f"%q{k} = inttoptr i64 %a{k} to ptr" for k, kind in enumerate(kinds) if kind == "ptr"
        )
        name = re.findall(r"@(\w+)\(", entry)[0]
        return f"""
declare i32 @setcontext(ptr)
declare i32 @_setjmp(ptr) returns_twice
declare void @_longjmp(ptr, i32) noreturn
define void @host.thread() {{
%tid = load volatile i32, ptr {tid}
%lane = and i32 %tid, {_WARP - 1}
%begun.at = getelementptr i64, ptr {at["exchanges"]}, i32 %lane
%begun = load volatile i64, ptr %begun.at
%isnew = icmp eq i64 %begun, 0
br i1 %isnew, label %start, label %continue
continue:
%place = getelementptr [{_PLACE} x i8], ptr {at["places"]}, i32 %lane
call void @_longjmp(ptr %place, i32 1)
unreachable
start:
{loads}
{casts}
call void @{name}({", ".join(values)})
%ended = getelementptr i64, ptr {at["ended"]}, i32 %lane
store i64 1, ptr %ended
ret void
}}
define i32 @host.exchange(i32 %mask, i32 %number, i32 %source) noinline {{
%tid = load volatile i32, ptr {tid}
%lane = and i32 %tid, {_WARP - 1}
%count.at = getelementptr i64, ptr {at["exchanges"]}, i32 %lane
%before = load volatile i64, ptr %count.at
%count = add i64 %before, 1
store volatile i64 %count, ptr %count.at
%parity = and i64 %count, 1
%own = getelementptr [{_WARP} x i32], ptr {at["numbers"]}, i64 %parity, i32 %lane
store volatile i32 %number, ptr %own
%until = shl i32 -2, %lane
%after = and i32 %mask, %until
%islast = icmp eq i32 %after, 0
%left = select i1 %islast, i32 %mask, i32 %after
%next = call i32 @llvm.cttz.i32(i32 %left, i1 true)
%change = sub i32 %next, %lane
%next.tid = add i32 %tid, %change
store volatile i32 %next.tid, ptr {tid}
%place = getelementptr [{_PLACE} x i8], ptr {at["places"]}, i32 %lane
%returned = call i32 @_setjmp(ptr %place)
%isleaving = icmp eq i32 %returned, 0
br i1 %isleaving, label %leave, label %back
leave:
%ended.at = getelementptr i64, ptr {at["ended"]}, i32 %next
%ended = load volatile i64, ptr %ended.at
%isover = icmp ne i64 %ended, 0
br i1 %isover, label %fail, label %go
fail:
%launch = getelementptr [{_CONTEXT} x i8], ptr {at["contexts"]}, i32 {_WARP}
%failed = call i32 @setcontext(ptr %launch)
unreachable
go:
%begun.at = getelementptr i64, ptr {at["exchanges"]}, i32 %next
%begun = load volatile i64, ptr %begun.at
%isnew = icmp eq i64 %begun, 0
br i1 %isnew, label %start, label %continue
start:
%context = getelementptr [{_CONTEXT} x i8], ptr {at["contexts"]}, i32 %next
%status = call i32 @setcontext(ptr %context)
unreachable
continue:
%other.place = getelementptr [{_PLACE} x i8], ptr {at["places"]}, i32 %next
call void @_longjmp(ptr %other.place, i32 1)
unreachable
back:
store volatile i32 %tid, ptr {tid}
%other.at = getelementptr i64, ptr {at["exchanges"]}, i32 %source
%other = load volatile i64, ptr %other.at
%ahead = sub i64 %other, %count
%ismixed = icmp ugt i64 %ahead, 1
%mixed = load volatile i64, ptr {at["mixed"]}
%also = zext i1 %ismixed to i64
%any = or i64 %mixed, %also
store volatile i64 %any, ptr {at["mixed"]}
%result.at = getelementptr [{_WARP} x i32], ptr {at["numbers"]}, i64 %parity, i32 %source
%result = load volatile i32, ptr %result.at
ret i32 %result
}}
declare i32 @llvm.cttz.i32(i32, i1)
define i32 @host.bfly(i32 %mask, i32 %number, i32 %step, i32 %segment) {{
%tid = load volatile i32, ptr {tid}
%lane = and i32 %tid, {_WARP - 1}
%source = xor i32 %lane, %step
%value = call i32 @host.exchange(i32 %mask, i32 %number, i32 %source)
ret i32 %value
}}
define i32 @host.idx(i32 %mask, i32 %number, i32 %index, i32 %segment) {{
%tid = load volatile i32, ptr {tid}
%lane = and i32 %tid, {_WARP - 1}
%bits = lshr i32 %segment, 8
%first = and i32 %lane, %bits
%source = or i32 %first, %index
%value = call i32 @host.exchange(i32 %mask, i32 %number, i32 %source)
ret i32 %value
}}
"""


def _kinds_of(entry: str) -> list[str]:
    """Return the types of the parameters in the definition of a function."""
    return [parameter.split()[0] for parameter in entry[entry.index("(") + 1 :].split(",")]


class _Status(IntEnum):
    """Some of the statuses of the driver."""

    CUDA_SUCCESS = 0
    CUDA_ERROR_INVALID_VALUE = 1
    CUDA_ERROR_OUT_OF_MEMORY = 2
    CUDA_ERROR_NO_DEVICE = 100


class _Attribute(IntEnum):
    """The attributes that are read."""

    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR = 75
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR = 76


class _HostDriver(ModuleType):
    """The functions of the driver that pinred calls.

    Attributes:
        capabilities: Compute capability of each device.
        limit: Size of the memory of all devices [bytes].
        memory: Arrays by their address in the memory of devices.
        contexts: The stack of current contexts.
        launched: Context and number of members of each launch.
        ended: Number of launches whose threads have ended.
        modules: Code, its warp if threads exchange numbers, and its number of parameters, by
            context and address.
        streams: What waits in each stream.
        copied: Sizes of all copies to devices, and from there [bytes].
    """

    CUdevice_attribute = _Attribute

    def __init__(self) -> None:
        super().__init__("cuda.bindings.driver")
        self.capabilities: list[tuple[int, int]] = [(9, 0)]
        self.limit = 2**30
        self.memory: dict[int, Any] = {}
        self.contexts: list[str] = []
        self.launched: list[tuple[str, int]] = []
        self.ended = 0
        self.modules: dict[tuple[str, int], tuple[NativeCode, _Warp | None, int]] = {}
        self.streams: dict[int, list[Callable[[], object]]] = {}
        self.copied = [0, 0]
        self._numbers = count(1)

    def cuInit(self, flags: int) -> tuple[_Status]:
        assert flags == 0
        return (_Status.CUDA_SUCCESS if self.capabilities else _Status.CUDA_ERROR_NO_DEVICE,)

    def cuDeviceGetCount(self) -> tuple[_Status, int]:
        return _Status.CUDA_SUCCESS, len(self.capabilities)

    def cuDeviceGet(self, ordinal: int) -> tuple[_Status, int]:
        return _Status.CUDA_SUCCESS, ordinal

    def cuDeviceGetAttribute(self, kind: _Attribute, device: int) -> tuple[_Status, int]:
        return _Status.CUDA_SUCCESS, self.capabilities[device][kind - 75]

    def cuDevicePrimaryCtxRetain(self, device: int) -> tuple[_Status, str]:
        return _Status.CUDA_SUCCESS, f"context of {device}"

    def cuCtxPushCurrent(self, context: str) -> tuple[_Status]:
        self.contexts.append(context)
        return (_Status.CUDA_SUCCESS,)

    def cuCtxPopCurrent(self) -> tuple[_Status, str]:
        return _Status.CUDA_SUCCESS, self.contexts.pop()

    def cuCtxSynchronize(self) -> tuple[_Status]:
        for stream in self.streams:
            self.cuStreamSynchronize(stream)
        return (_Status.CUDA_SUCCESS,)

    def cuStreamCreate(self, flags: int) -> tuple[_Status, int]:
        assert flags == 0
        stream = next(self._numbers)
        self.streams[stream] = []
        return _Status.CUDA_SUCCESS, stream

    def cuStreamSynchronize(self, stream: int) -> tuple[_Status]:
        waiting, self.streams[stream] = self.streams[stream], []
        for act in waiting:
            act()
        return (_Status.CUDA_SUCCESS,)

    def cuStreamDestroy(self, stream: int) -> tuple[_Status]:
        assert not self.streams.pop(stream)
        return (_Status.CUDA_SUCCESS,)

    def cuModuleLoadData(self, image: bytes) -> tuple[_Status, tuple[str, int]]:
        assert image.endswith(b"\0")
        text = image[:-1].decode()
        (name, parameters) = re.findall(r"ptx_kernel void @(\w+)\(([^)]*)\)", text)[0]
        code, warp = _compile(text, name)
        module = self.contexts[-1], code.address
        # All parameters have 8 bytes.
        self.modules[module] = code, warp, parameters.count(",") + 1
        return _Status.CUDA_SUCCESS, module

    def cuModuleUnload(self, module: tuple[str, int]) -> tuple[_Status]:
        assert module[0] == self.contexts[-1]
        del self.modules[module]
        return (_Status.CUDA_SUCCESS,)

    def cuModuleGetFunction(
        self, module: tuple[str, int], name: bytes
    ) -> tuple[_Status, tuple[str, int]]:
        assert module[0] == self.contexts[-1]
        code, warp, _ = self.modules[module]
        assert code.name == (name.decode() if warp is None else "host.thread")
        return _Status.CUDA_SUCCESS, module

    def cuMemGetInfo(self) -> tuple[_Status, int, int]:
        return _Status.CUDA_SUCCESS, self.limit - sum(map(len, self.memory.values())), self.limit

    def cuMemAlloc(self, size: int) -> tuple[_Status, int]:
        if size == 0:
            return _Status.CUDA_ERROR_INVALID_VALUE, 0
        if size > self.cuMemGetInfo()[1]:
            return _Status.CUDA_ERROR_OUT_OF_MEMORY, 0
        # Numbers that nobody has stored are visible: 1e306, and no NaN, which failures store.
        array = np.full(size, 0x7F, np.uint8)
        self.memory[array.ctypes.data] = array
        return _Status.CUDA_SUCCESS, array.ctypes.data

    def cuMemFree(self, pointer: int) -> tuple[_Status]:
        del self.memory[pointer]
        return (_Status.CUDA_SUCCESS,)

    def cuMemcpyHtoDAsync(self, to: int, source: int, size: int, stream: int) -> tuple[_Status]:
        self._check_place(to, size)
        self.copied[0] += size
        self.streams[stream].append(partial(ctypes.memmove, to, source, size))
        return (_Status.CUDA_SUCCESS,)

    def cuMemcpyDtoHAsync(self, to: int, source: int, size: int, stream: int) -> tuple[_Status]:
        self._check_place(source, size)
        self.copied[1] += size
        self.streams[stream].append(partial(ctypes.memmove, to, source, size))
        return (_Status.CUDA_SUCCESS,)

    def _check_place(self, first: int, size: int) -> None:
        """Check that an array is in memory of the device."""
        assert any(
            start <= first and first + size <= start + len(array)
            for start, array in self.memory.items()
        )

    def cuLaunchKernel(self, function: tuple[str, int], *sizes: int) -> tuple[_Status]:
        *shape, shared, stream, parameters, extra = sizes
        (blocks, *grid), (threads, *block) = shape[:3], shape[3:]
        assert (*grid, *block, shared, extra) == (1, 1, 1, 1, 0, 0)
        assert function[0] == self.contexts[-1]
        _, warp, length = self.modules[function]
        addresses = (ctypes.c_uint64 * length).from_address(parameters)
        values = [ctypes.c_int64.from_address(address).value for address in addresses]
        run = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * length)(function[1])

        def act() -> None:
            _NUMBERS["ntid"].value = threads
            for _NUMBERS["ctaid"].value in range(blocks):
                if warp is not None:
                    for first in range(0, threads, _WARP):
                        warp.run(function[1], values, first, min(_WARP, threads - first))
                    continue
                for _NUMBERS["tid"].value in range(threads):
                    run(*values)
            self.ended += 1

        self.streams[stream].append(act)
        self.launched.append((function[0], values[0]))
        return (_Status.CUDA_SUCCESS,)


@once_for_all
def _compile(text: str, name: str) -> tuple[NativeCode, _Warp | None]:
    entry = re.findall(r"ptx_kernel void (@[^)]*)\)", text)[0]
    warp = _Warp() if "call i32 @llvm.nvvm.shfl.sync" in text else None
    text = re.sub(r"^target .*\n|ptx_kernel ", "", text, flags=re.M)
    for special, number in _NUMBERS.items():
        intrinsic = f"@llvm.nvvm.read.ptx.sreg.{special}.x()"
        text = re.sub(rf"^declare .*{re.escape(intrinsic)}.*\n", "", text, flags=re.M)
        text = text.replace(intrinsic, f"@host.{special}()") + (
            f"\ndefine i32 @host.{special}() {{\n%value = load volatile i32, ptr inttoptr "
            f"(i64 {ctypes.addressof(number)} to ptr)\nret i32 %value\n}}"
        )
    text = re.sub(r'asm "rsqrt[^"]*", "[^"]*"\(', "@host.inverse_root(", text)
    # The tangent of a large angle has instructions of the device that no other code replaces.
    text = re.sub(r"call \{ i64, i64 \} asm .*", "call { i64, i64 } @host.abort()", text)
    text += _ASSEMBLY
    if warp is not None:
        for kind in ("bfly", "idx"):
            intrinsic = f"@llvm.nvvm.shfl.sync.{kind}.i32("
            text = re.sub(rf"^declare .*{re.escape(intrinsic)}.*\n", "", text, flags=re.M)
            text = text.replace(intrinsic, f"@host.{kind}(")
        text += warp.code(entry, entry.count(",") + 1)
        name = "host.thread"
    for used, (kind, kinds, value) in _LIBDEVICE.items():
        declared = rf"^declare .*@{re.escape(used)}\(.*\n"
        if re.search(declared, text, flags=re.M):
            text = re.sub(declared, "", text, flags=re.M).replace(f"@{used}(", f"@host.{used}(")
            arguments = ", ".join(f"{each} %{x}" for each, x in zip(kinds, "xyz", strict=False))
            text += f"\ndefine {kind} @host.{used}({arguments}) {{\n{value}\n}}"
    with LLVM_LOCK:
        context = llvm.create_context()
        module = llvm.parse_assembly(text, context)
        code: bytes = create_machine(1).emit_object(module)
        module.close()
    return load_object(code, name), warp


def host_driver(monkeypatch: pytest.MonkeyPatch) -> _HostDriver:
    """Replace `cuda.bindings.driver`, and give it IR in place of PTX; return the stand-in."""
    driver = _HostDriver()
    names = ["cuda.bindings"] if find_spec("cuda") else ["cuda", "cuda.bindings"]
    for name in names:  # the package cuda.pathfinder may be there, and finds libdevice
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, driver.__name__, driver)
    for module in (cuda_driver, device_code):
        monkeypatch.setattr(module, "opened_devices", cuda_driver._open_devices)
    monkeypatch.setattr(cuda_driver, "_modules", OrderedDict())
    monkeypatch.setattr(device_code, "ptx_of", _ir_of)
    monkeypatch.setattr(device_code, "outputs_ptx", _outputs_ir_of)
    return driver


@once_for_all
def _ir_of(kernel: Kernel, method: Explicit, *, tangent: bool = False) -> bytes:
    return device_ir(kernel, method, tangent=tangent).encode()


@once_for_all
def _outputs_ir_of(kernel: Kernel, names: tuple[str, ...]) -> bytes:
    return outputs_ir(kernel, names).encode()

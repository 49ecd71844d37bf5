"""A stand-in for `cuda.bindings.driver`: memory and threads of devices are those of the CPU.

Its modules are LLVM IR instead of PTX.  The IR is compiled for the CPU without changes, except that
the numbers of a thread and its block come from the stand-in.  Threads run one after another.  What
is put into a stream waits there until the stream is synchronised, so results that are read too
early, or inputs that change too early, are wrong.
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
        modules: Code, and its number of parameters, by context and address.
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
        self.modules: dict[tuple[str, int], tuple[NativeCode, int]] = {}
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
        code = _compile(text, name)
        module = self.contexts[-1], code.address
        # All parameters have 8 bytes.
        self.modules[module] = code, parameters.count(",") + 1
        return _Status.CUDA_SUCCESS, module

    def cuModuleUnload(self, module: tuple[str, int]) -> tuple[_Status]:
        assert module[0] == self.contexts[-1]
        del self.modules[module]
        return (_Status.CUDA_SUCCESS,)

    def cuModuleGetFunction(
        self, module: tuple[str, int], name: bytes
    ) -> tuple[_Status, tuple[str, int]]:
        assert module[0] == self.contexts[-1]
        assert self.modules[module][0].name == name.decode()
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
        length = self.modules[function][1]
        addresses = (ctypes.c_uint64 * length).from_address(parameters)
        values = [ctypes.c_int64.from_address(address).value for address in addresses]
        run = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * length)(function[1])

        def act() -> None:
            _NUMBERS["ntid"].value = threads
            for _NUMBERS["ctaid"].value in range(blocks):
                for _NUMBERS["tid"].value in range(threads):
                    run(*values)
            self.ended += 1

        self.streams[stream].append(act)
        self.launched.append((function[0], values[0]))
        return (_Status.CUDA_SUCCESS,)


@once_for_all
def _compile(text: str, name: str) -> NativeCode:
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
    return load_object(code, name)


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

"""A stand-in for `cuda.bindings.driver`: memory and threads of the device are those of the CPU.

Its modules are LLVM IR instead of PTX.  The IR is compiled for the CPU without changes, except that
the numbers of a thread and its block come from the stand-in.  Threads run one after another.
"""

from __future__ import annotations

import ctypes
import re
import sys
from enum import IntEnum
from types import ModuleType
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest

from pinred.common.machine_code import LLVM_LOCK, NativeCode, create_machine, load_object
from pinred.common.memo import once_for_all
from pinred.integrators.methods.method import Explicit
from pinred.kernels.device import cuda_driver, integrate_on_device
from pinred.kernels.device.device_code import device_ir
from pinred.kernels.kernel import Kernel

_NUMBERS = {name: ctypes.c_int32() for name in ("tid", "ctaid", "ntid")}  # of the current thread
_PARAMETERS = 9  # number of parameters of the entry point, all of 8 bytes


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
        capability: Compute capability of the device; None if there is no device.
        limit: Size of the memory of the device [bytes].
        memory: Arrays by their address in the memory of the device.
        contexts: Number of contexts that are in use.
        launched: Number of launches.
    """

    CUdevice_attribute = _Attribute

    def __init__(self) -> None:
        super().__init__("cuda.bindings.driver")
        self.capability: tuple[int, int] | None = (9, 0)
        self.limit = 2**30
        self.memory: dict[int, Any] = {}
        self.contexts = 0
        self.launched = 0
        self.modules: dict[int, NativeCode] = {}

    def cuInit(self, flags: int) -> tuple[_Status]:
        assert flags == 0
        return (_Status.CUDA_ERROR_NO_DEVICE if self.capability is None else _Status.CUDA_SUCCESS,)

    def cuDeviceGet(self, ordinal: int) -> tuple[_Status, int]:
        return _Status.CUDA_SUCCESS, ordinal

    def cuDeviceGetAttribute(self, kind: _Attribute, device: int) -> tuple[_Status, int]:
        assert device == 0
        assert self.capability is not None
        return _Status.CUDA_SUCCESS, self.capability[kind - 75]

    def cuDevicePrimaryCtxRetain(self, device: int) -> tuple[_Status, str]:
        return _Status.CUDA_SUCCESS, f"context of {device}"

    def cuCtxPushCurrent(self, context: str) -> tuple[_Status]:
        assert context == "context of 0"
        self.contexts += 1
        return (_Status.CUDA_SUCCESS,)

    def cuCtxPopCurrent(self) -> tuple[_Status, str]:
        self.contexts -= 1
        return _Status.CUDA_SUCCESS, "context of 0"

    def cuCtxSynchronize(self) -> tuple[_Status]:
        return (_Status.CUDA_SUCCESS,)

    def cuModuleLoadData(self, image: bytes) -> tuple[_Status, int]:
        assert image.endswith(b"\0")
        text = image[:-1].decode()
        name = re.findall(r"ptx_kernel void @(\w+)", text)[0]
        code = _compile(text, name)
        self.modules[code.address] = code
        return _Status.CUDA_SUCCESS, code.address

    def cuModuleUnload(self, module: int) -> tuple[_Status]:
        del self.modules[module]
        return (_Status.CUDA_SUCCESS,)

    def cuModuleGetFunction(self, module: int, name: bytes) -> tuple[_Status, int]:
        assert self.modules[module].name == name.decode()
        return _Status.CUDA_SUCCESS, module

    def cuMemAlloc(self, size: int) -> tuple[_Status, int]:
        if size == 0:
            return _Status.CUDA_ERROR_INVALID_VALUE, 0
        if size + sum(map(len, self.memory.values())) > self.limit:
            return _Status.CUDA_ERROR_OUT_OF_MEMORY, 0
        # Numbers that nobody has stored are visible.
        array = np.full(size, 0xFF, np.uint8)
        self.memory[array.ctypes.data] = array
        return _Status.CUDA_SUCCESS, array.ctypes.data

    def cuMemFree(self, pointer: int) -> tuple[_Status]:
        del self.memory[pointer]
        return (_Status.CUDA_SUCCESS,)

    def cuMemcpyHtoD(self, to: int, source: int, size: int) -> tuple[_Status]:
        assert len(self.memory[to]) == size
        ctypes.memmove(to, source, size)
        return (_Status.CUDA_SUCCESS,)

    def cuMemcpyDtoH(self, to: int, source: int, size: int) -> tuple[_Status]:
        assert len(self.memory[source]) == size
        ctypes.memmove(to, source, size)
        return (_Status.CUDA_SUCCESS,)

    def cuLaunchKernel(self, function: int, *sizes: int) -> tuple[_Status]:
        *shape, shared, stream, parameters, extra = sizes
        (blocks, *grid), (threads, *block) = shape[:3], shape[3:]
        assert (*grid, *block, shared, stream, extra) == (1, 1, 1, 1, 0, 0, 0)
        addresses = (ctypes.c_uint64 * _PARAMETERS).from_address(parameters)
        values = [ctypes.c_int64.from_address(address).value for address in addresses]
        run = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * _PARAMETERS)(function)
        _NUMBERS["ntid"].value = threads
        for _NUMBERS["ctaid"].value in range(blocks):
            for _NUMBERS["tid"].value in range(threads):
                run(*values)
        self.launched += 1
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
    with LLVM_LOCK:
        context = llvm.create_context()
        module = llvm.parse_assembly(text, context)
        code: bytes = create_machine(1).emit_object(module)
        module.close()
    return load_object(code, name)


def host_driver(monkeypatch: pytest.MonkeyPatch) -> _HostDriver:
    """Replace `cuda.bindings.driver`, and give it IR in place of PTX; return the stand-in."""
    driver = _HostDriver()
    for name in ("cuda", "cuda.bindings"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, driver.__name__, driver)
    for module in (cuda_driver, integrate_on_device):
        monkeypatch.setattr(module, "opened_device", cuda_driver._open_device)
    monkeypatch.setattr(integrate_on_device, "ptx_of", _ir_of)
    return driver


@once_for_all
def _ir_of(kernel: Kernel, method: Explicit) -> bytes:
    return device_ir(kernel, method).encode()

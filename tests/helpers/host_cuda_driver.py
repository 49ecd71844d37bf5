"""A stand-in for `cuda.bindings.driver`: memory and threads of the device are those of the CPU.

Its modules are LLVM IR instead of PTX.  It is compiled for the CPU as it is, except that the numbers
of a thread and its block come from the stand-in.  Threads run one after another.
"""

from __future__ import annotations

import ctypes
import re
from enum import IntEnum
from types import ModuleType
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from pinred.common.machine_code import NativeCode, create_machine, load_object

_SPECIAL = ("tid", "ctaid", "ntid")


class Status(IntEnum):
    """Some of the statuses of the driver."""

    CUDA_SUCCESS = 0
    CUDA_ERROR_OUT_OF_MEMORY = 2
    CUDA_ERROR_NO_DEVICE = 100


class CUdevice_attribute(IntEnum):  # noqa: N801, the driver's name
    """The attributes that are read."""

    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR = 75
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR = 76


class HostDriver(ModuleType):
    """The functions of the driver that pinred calls.

    Attributes:
        capability: Compute capability of the device; None if there is no device.
        limit: Size of the memory of the device [bytes].
        memory: Arrays by their address in the memory of the device.
        contexts: Number of contexts that are in use.
        launched: Number of launches.
    """

    CUdevice_attribute = CUdevice_attribute

    def __init__(self) -> None:
        super().__init__("cuda.bindings.driver")
        self.capability: tuple[int, int] | None = (9, 0)
        self.limit = 2**30
        self.memory: dict[int, Any] = {}
        self.contexts = 0
        self.launched = 0
        self.modules: dict[int, NativeCode] = {}
        self._special = {name: ctypes.c_int32() for name in _SPECIAL}

    def cuInit(self, flags: int) -> tuple[Status]:
        assert flags == 0
        return (Status.CUDA_ERROR_NO_DEVICE if self.capability is None else Status.CUDA_SUCCESS,)

    def cuDeviceGet(self, ordinal: int) -> tuple[Status, int]:
        return Status.CUDA_SUCCESS, ordinal

    def cuDeviceGetAttribute(self, kind: CUdevice_attribute, device: int) -> tuple[Status, int]:
        assert device == 0
        assert self.capability is not None
        return Status.CUDA_SUCCESS, self.capability[kind - 75]

    def cuDevicePrimaryCtxRetain(self, device: int) -> tuple[Status, str]:
        return Status.CUDA_SUCCESS, f"context of {device}"

    def cuCtxPushCurrent(self, context: str) -> tuple[Status]:
        assert context == "context of 0"
        self.contexts += 1
        return (Status.CUDA_SUCCESS,)

    def cuCtxPopCurrent(self) -> tuple[Status, str]:
        self.contexts -= 1
        return Status.CUDA_SUCCESS, "context of 0"

    def cuCtxSynchronize(self) -> tuple[Status]:
        return (Status.CUDA_SUCCESS,)

    def cuModuleLoadData(self, image: bytes) -> tuple[Status, int]:
        assert image.endswith(b"\0")
        text = image[:-1].decode()
        name = re.findall(r"ptx_kernel void @(\w+)", text)[0]
        code = load_object(_compile(self._for_host(text)), name)
        self.modules[code.address] = code
        return Status.CUDA_SUCCESS, code.address

    def cuModuleUnload(self, module: int) -> tuple[Status]:
        del self.modules[module]
        return (Status.CUDA_SUCCESS,)

    def cuModuleGetFunction(self, module: int, name: bytes) -> tuple[Status, int]:
        assert self.modules[module].name == name.decode()
        return Status.CUDA_SUCCESS, module

    def cuMemAlloc(self, size: int) -> tuple[Status, int]:
        if size > self.limit:
            return Status.CUDA_ERROR_OUT_OF_MEMORY, 0
        # Numbers that nobody has stored are visible.
        array = np.full(size, 0xFF, np.uint8)
        self.memory[array.ctypes.data] = array
        return Status.CUDA_SUCCESS, array.ctypes.data

    def cuMemFree(self, pointer: int) -> tuple[Status]:
        del self.memory[pointer]
        return (Status.CUDA_SUCCESS,)

    def cuMemcpyHtoD(self, to: int, source: int, size: int) -> tuple[Status]:
        assert len(self.memory[to]) == size
        ctypes.memmove(to, source, size)
        return (Status.CUDA_SUCCESS,)

    def cuMemcpyDtoH(self, to: int, source: int, size: int) -> tuple[Status]:
        assert len(self.memory[source]) == size
        ctypes.memmove(to, source, size)
        return (Status.CUDA_SUCCESS,)

    def cuLaunchKernel(self, function: int, *sizes: int) -> tuple[Status]:
        *shape, shared, stream, parameters, extra = sizes
        (blocks, *grid), (threads, *block) = shape[:3], shape[3:]
        assert (*grid, *block, shared, stream, extra) == (1, 1, 1, 1, 0, 0, 0)
        kinds = (ctypes.c_int64,) * 3 + (ctypes.c_void_p,) * 6
        addresses = (ctypes.c_void_p * len(kinds)).from_address(parameters)
        values = [kind.from_address(at).value for kind, at in zip(kinds, addresses, strict=True)]  # type: ignore[arg-type]
        run = ctypes.CFUNCTYPE(None, *kinds)(function)
        self._special["ntid"].value = threads
        for self._special["ctaid"].value in range(blocks):
            for self._special["tid"].value in range(threads):
                run(*values)
        self.launched += 1
        return (Status.CUDA_SUCCESS,)

    def _for_host(self, text: str) -> str:
        text = re.sub(r"^target .*\n|ptx_kernel ", "", text, flags=re.M)
        for name, number in self._special.items():
            intrinsic = f"@llvm.nvvm.read.ptx.sreg.{name}.x()"
            text = re.sub(rf"^declare .*{re.escape(intrinsic)}.*\n", "", text, flags=re.M)
            text = text.replace(intrinsic, f"@host.{name}()") + (
                f"\ndefine i32 @host.{name}() {{\n%value = load volatile i32, ptr inttoptr "
                f"(i64 {ctypes.addressof(number)} to ptr)\nret i32 %value\n}}"
            )
        return text


def _compile(text: str) -> bytes:
    context = llvm.create_context()
    module = llvm.parse_assembly(text, context)
    code: bytes = create_machine(1).emit_object(module)
    module.close()
    return code

"""Execution of PTX on a CUDA device by NVIDIA's driver, which `cuda.bindings` calls."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import DeviceError
from ...common.memo import once_for_all
from ...common.optional_packages import install_command, optional_package

CAPABILITY = (9, 0)  # lowest compute capability that runs the PTX
MODULES = 16  # largest number of modules that stay loaded
_BLOCK = 64  # threads per block; a thread uses all registers that it can have
_REMEDY = "Omit device to integrate on the CPU."
_ATTRIBUTE = "CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY"


def run_on_device(
    code: bytes, entry: str, threads: int, arguments: Sequence[int | NDArray[Any]]
) -> None:
    """Run an entry point on the first CUDA device, and wait for its end.

    Args:
        code: PTX.
        entry: Name of the entry point.
        threads: Smallest number of threads; there are more, in whole blocks.
        arguments: Integers, and contiguous arrays in place of addresses. All arrays are copied to
            the device, and those that may be written are copied back.
    Raises:
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
    """
    driver, context = opened_device()
    with ExitStack() as stack:
        call(driver.cuCtxPushCurrent, context)
        stack.callback(call, driver.cuCtxPopCurrent)
        function = call(driver.cuModuleGetFunction, _loaded(driver, code), entry.encode())
        values = np.zeros(len(arguments), np.uint64)
        copies: list[tuple[NDArray[Any], Any]] = []
        for k, argument in enumerate(arguments):
            if isinstance(argument, int):
                values[k] = argument
                continue
            memory = call(driver.cuMemAlloc, max(argument.nbytes, 1))
            stack.callback(call, driver.cuMemFree, memory)
            if argument.nbytes:
                call(driver.cuMemcpyHtoD, memory, argument.ctypes.data, argument.nbytes)
                copies.append((argument, memory))
            values[k] = int(memory)
        # The driver takes an array with the address of each argument.
        addresses = values.ctypes.data + values.itemsize * np.arange(len(values), dtype=np.uint64)
        sizes = (-(-threads // _BLOCK), 1, 1, _BLOCK, 1, 1)
        call(driver.cuLaunchKernel, function, *sizes, 0, 0, addresses.ctypes.data, 0)
        call(driver.cuCtxSynchronize)
        for array, memory in copies:
            if array.flags.writeable:
                call(driver.cuMemcpyDtoH, array.ctypes.data, memory, array.nbytes)


# Modules by their code, the last used one last: the driver takes longer to load one than many runs.
_modules: OrderedDict[bytes, Any] = OrderedDict()


def _loaded(driver: Any, code: bytes) -> Any:
    """Return the module of a code, which the current context keeps."""
    if code not in _modules:
        module = call(driver.cuModuleLoadData, code + b"\0")
        while len(_modules) >= MODULES:
            call(driver.cuModuleUnload, _modules.popitem(last=False)[1])
        _modules[code] = module
    _modules.move_to_end(code)
    return _modules[code]


def _open_device() -> tuple[Any, Any]:
    """Return the module of the driver, and the context of the first device.

    Raises:
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
    """
    driver = optional_package(
        "cuda.bindings.driver",
        f"device 'cuda' needs the package cuda-bindings: {install_command('gpu')}. {_REMEDY}",
    )
    try:
        call(driver.cuInit, 0)
        device = call(driver.cuDeviceGet, 0)
    except RuntimeError as error:  # also if there is no driver
        raise DeviceError(
            f"device: expected a CUDA device and NVIDIA's driver, found none ({error}). {_REMEDY}"
        ) from error
    kinds = driver.CUdevice_attribute
    capability = tuple(
        call(driver.cuDeviceGetAttribute, getattr(kinds, f"{_ATTRIBUTE}_{part}"), device)
        for part in ("MAJOR", "MINOR")
    )
    if capability < CAPABILITY:
        raise DeviceError(
            "device: expected a CUDA device of compute capability "
            f"{'.'.join(map(str, CAPABILITY))} or higher, got {'.'.join(map(str, capability))}. "
            f"{_REMEDY}"
        )
    return driver, call(driver.cuDevicePrimaryCtxRetain, device)


opened_device = once_for_all(_open_device)


def call(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of the driver.

    Args:
        function: The function; it returns a status, and perhaps a value.
        *arguments: Its arguments.
    Returns:
        The value, or None.
    Raises:
        DeviceError: The status is an error.
    """
    status, *values = function(*arguments)
    if int(status) != 0:
        raise DeviceError(f"device: the driver's {function.__name__} failed: {status.name}")
    return values[0] if values else None

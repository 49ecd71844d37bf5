"""Execution of PTX on CUDA devices by NVIDIA's driver, which `cuda.bindings` calls."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import ceil
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import DeviceError, install_command, optional_package
from ...common.memo import once_for_all

CAPABILITY = (9, 0)  # lowest compute capability that runs the PTX
MODULES = 16  # largest number of modules that stay loaded on a device
MOST = 2**16  # largest number of threads of a launch; they fill a device
LEAST = 2**13  # number of threads that is worth another device
_QUEUE = 3  # launches that a device has at once: while one copies, others compute
_SHARE = 0.5  # largest part of the free memory of a device that a run takes
_ALIGNED = 256  # alignment of arrays on a device [bytes]
_BLOCK = 64  # threads per block; a thread uses all registers that it can have
_REMEDY = "Omit device to integrate on the CPU."
_ATTRIBUTE = "CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY"


@dataclass(frozen=True)
class Launch:
    """An entry point, and the arrays of its members.

    The entry point takes the number of members, `numbers`, and the addresses of `inputs` and of
    `results`.

    Attributes:
        code: PTX.
        entry: Name of the entry point.
        numbers: Integers.
        inputs: Contiguous arrays with an entry for each member, or with one that all share.
        results: Contiguous arrays with an entry for each member. The code writes all of them.
        each: Number of threads of a member.
    """

    code: bytes
    entry: str
    numbers: Sequence[int]
    inputs: Sequence[NDArray[Any]]
    results: Sequence[NDArray[Any]]
    each: int = 1


_running = Lock()  # Threads of a process share its modules and the memory of its devices.


def run_on_devices(launch: Launch, progress: Callable[[float], None] | None = None) -> None:
    """Run an entry point for all members on the CUDA devices, and wait for its end.

    Members are divided into launches of limited size, which devices take in turn. Only arrays that
    the entry point reads are copied to a device, and only its results are copied back.

    Args:
        launch: The entry point and its arrays.
        progress: Called with the completed fraction of the members.
    Raises:
        DeviceError: There is no device that can run the code, or it reports an error.
        MissingPackageError: `cuda.bindings` is not installed.
    """
    driver, devices = opened_devices()
    size = len(launch.results[0])
    used = devices[: max(1, ceil(size * launch.each / LEAST))]
    with _running, ExitStack() as stack:
        free = min(_free_memory(driver, device) for device in used)
        arrays = (*launch.inputs, *launch.results)
        bytes_each = sum(array.nbytes / len(array) for array in arrays)
        most = min(MOST / launch.each, size / len(used), _SHARE * free / (_QUEUE * bytes_each))
        count = max(1, ceil(most))
        bounds = range(0, size, count)
        places = [device for _ in range(_QUEUE) for device in used][: len(bounds)]
        slots = [stack.enter_context(_slot(driver, place, launch, count)) for place in places]
        for k, first in enumerate(bounds):
            slot = slots[k % len(slots)]
            slot.finish(progress)
            slot.start(first, min(first + count, size))
        for k in range(len(slots)):
            slots[(len(bounds) + k) % len(slots)].finish(progress)


class _Slot:
    """Memory and queue of one launch at a time on a device."""

    def __init__(
        self,
        driver: Any,
        device: int,
        launch: Launch,
        function: Any,
        stream: Any,
        addresses: list[int],
    ) -> None:
        self._driver, self._device, self._launch = driver, device, launch
        self._function, self._stream, self._addresses = function, stream, addresses
        self._span: tuple[int, int] | None = None

    def start(self, first: int, last: int) -> None:
        """Copy the inputs of members first … last − 1, and start their threads."""
        driver, launch, self._span = self._driver, self._launch, (first, last)
        addresses = self._addresses
        with _current(driver, self._device):
            for array, address in zip(launch.inputs, addresses, strict=False):
                part = array if len(array) == 1 else array[first:last]
                if part.nbytes:
                    data = part.ctypes.data
                    call(driver.cuMemcpyHtoDAsync, address, data, part.nbytes, self._stream)
            values = np.array([last - first, *launch.numbers, *addresses], np.uint64)
            # The driver takes an array with the address of each argument.
            pointers = values.ctypes.data + values.itemsize * np.arange(
                len(values), dtype=np.uint64
            )
            blocks = ceil((last - first) * launch.each / _BLOCK)
            sizes = (blocks, 1, 1, _BLOCK, 1, 1)
            call(
                driver.cuLaunchKernel, self._function, *sizes, 0, self._stream,
                pointers.ctypes.data, 0,
            )  # fmt: skip

    def finish(self, progress: Callable[[float], None] | None) -> None:
        """Wait for the launch, if there is one, and copy its results."""
        if self._span is None:
            return
        driver, launch, (first, last) = self._driver, self._launch, self._span
        with _current(driver, self._device):
            addresses = self._addresses[len(launch.inputs) :]
            for array, address in zip(launch.results, addresses, strict=True):
                part = array[first:last]
                if part.nbytes:
                    data = part.ctypes.data
                    call(driver.cuMemcpyDtoHAsync, data, address, part.nbytes, self._stream)
            call(driver.cuStreamSynchronize, self._stream)
        self._span = None
        if progress is not None:
            progress(last / len(launch.results[0]))


@contextmanager
def _slot(driver: Any, device: Any, launch: Launch, count: int) -> Iterator[_Slot]:
    """Allocate memory on a device for launches of `count` members, and free it at the end."""
    ends = [0]
    for array in (*launch.inputs, *launch.results):
        size = array.nbytes // len(array) * (1 if len(array) == 1 else count)
        ends.append(ends[-1] + ceil(size / _ALIGNED) * _ALIGNED)
    with _current(driver, device):
        module = _loaded(driver, device, launch.code)
        function = call(driver.cuModuleGetFunction, module, launch.entry.encode())
        memory = call(driver.cuMemAlloc, max(ends[-1], 1))
        stream = call(driver.cuStreamCreate, 0)
    try:
        addresses = [int(memory) + end for end in ends[:-1]]
        yield _Slot(driver, device, launch, function, stream, addresses)
    finally:
        with _current(driver, device):
            call(driver.cuStreamSynchronize, stream)  # Threads still run after an interruption.
            call(driver.cuMemFree, memory)
            call(driver.cuStreamDestroy, stream)


@contextmanager
def _current(driver: Any, device: int) -> Iterator[None]:
    """Make the context of a device current."""
    call(driver.cuCtxPushCurrent, _context(driver, device))
    try:
        yield
    finally:
        call(driver.cuCtxPopCurrent)


def _free_memory(driver: Any, device: int) -> int:
    with _current(driver, device):
        return int(call(driver.cuMemGetInfo))


# Modules by device and code, the last used one last: the driver takes longer to load one than many
# runs.
_modules: OrderedDict[tuple[int, bytes], Any] = OrderedDict()


def _loaded(driver: Any, device: int, code: bytes) -> Any:
    """Return the module of a code on the current device, which keeps it."""
    key = device, code
    if key not in _modules:
        module = call(driver.cuModuleLoadData, code + b"\0")
        kept = [other for other in _modules if other[0] == device]
        for other in kept[: len(kept) - MODULES + 1]:
            call(driver.cuModuleUnload, _modules.pop(other))
        _modules[key] = module
    _modules.move_to_end(key)
    return _modules[key]


@once_for_all
def _context(driver: Any, device: int) -> Any:
    return call(driver.cuDevicePrimaryCtxRetain, call(driver.cuDeviceGet, device))


def _open_devices() -> tuple[Any, list[int]]:
    """Return the module of the driver, and the numbers of the devices that can run the code.

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
        count = call(driver.cuDeviceGetCount)
    except RuntimeError as error:  # also if there is no driver
        raise DeviceError(
            f"device: expected a CUDA device and NVIDIA's driver, found none ({error}). {_REMEDY}"
        ) from error
    capabilities = [_capability(driver, device) for device in range(count)]
    able = [device for device, found in enumerate(capabilities) if found >= CAPABILITY]
    if not able:
        found = ", ".join(".".join(map(str, each)) for each in capabilities) or "no device"
        raise DeviceError(
            "device: expected a CUDA device of compute capability "
            f"{'.'.join(map(str, CAPABILITY))} or higher, got {found}. {_REMEDY}"
        )
    return driver, able


def _capability(driver: Any, device: int) -> tuple[int, ...]:
    kinds, handle = driver.CUdevice_attribute, call(driver.cuDeviceGet, device)
    return tuple(
        call(driver.cuDeviceGetAttribute, getattr(kinds, f"{_ATTRIBUTE}_{part}"), handle)
        for part in ("MAJOR", "MINOR")
    )


opened_devices = once_for_all(_open_devices)


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

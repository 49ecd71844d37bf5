"""Run exported batches on a CUDA device, and compare them with the CPU.

The machine needs NVIDIA's driver, NumPy and cuda-bindings, but neither pinred nor Pinocchio:

    python run_on_device.py FOLDER [--members 65536]

FOLDER comes from `export_batches.py`.  The members of a batch are repeated until there are enough
of them to fill the device.  The exit status is 1 if a number is farther from the CPU's than its
bound.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

BLOCK = 64  # threads per block
REPETITIONS = 3


def run_batch(driver: Any, file: Path, members: int) -> dict[str, Any]:
    """Run a batch, and compare all members with the states that the CPU found.

    Args:
        driver: The module `cuda.bindings.driver`, with a current context.
        file: Arguments of the launch and expected states (`.npz`); the PTX is beside it.
        members: Smallest number of members.
    Returns:
        Name, numbers of members, seconds to load the code, microseconds of the kernel per member,
        and median and largest difference relative to the largest state.
    """
    with np.load(file) as stored:
        arrays = dict(stored)
    # Numbers of each member, (N, m); a result may have more, such as the state at its end.
    expected = [arrays.pop(name) for name in sorted(arrays) if name.startswith("expected")]
    bound = float(arrays.pop("bound"))
    entry, each = str(arrays.pop("entry")), int(arrays.pop("each"))
    numbers = arrays.pop("numbers").tolist()
    count = len(expected[0])
    copies = -(-members // count)
    size = copies * count
    begun = perf_counter()
    module = call(driver.cuModuleLoadData, file.with_suffix(".ptx").read_bytes() + b"\0")
    loading = perf_counter() - begun
    function = call(driver.cuModuleGetFunction, module, entry.encode())
    # Arrays of bytes, (N, …), or (1, …) if all members share a row.
    host = {
        name: np.concatenate([array] * copies) if len(array) == count else array
        for name, array in arrays.items()
    }
    memory = {name: call(driver.cuMemAlloc, max(array.nbytes, 1)) for name, array in host.items()}
    arguments = [size, *numbers, *map(int, memory.values())]
    values = np.array(arguments, np.uint64)
    addresses = values.ctypes.data + values.itemsize * np.arange(len(values), dtype=np.uint64)
    stream = call(driver.cuStreamCreate, 0)
    walls = []
    for _ in range(REPETITIONS):
        for name, array in host.items():
            if array.nbytes and name.startswith("input"):
                call(
                    driver.cuMemcpyHtoDAsync, memory[name], array.ctypes.data, array.nbytes, stream
                )
        call(driver.cuStreamSynchronize, stream)
        begun = perf_counter()
        sizes = (-(-size * each // BLOCK), 1, 1, BLOCK, 1, 1)
        call(driver.cuLaunchKernel, function, *sizes, 0, stream, addresses.ctypes.data, 0)
        call(driver.cuStreamSynchronize, stream)
        walls.append(perf_counter() - begun)
    errors = []
    for k, values in enumerate(expected):
        found = host[f"result{k}"]
        call(
            driver.cuMemcpyDtoHAsync, found.ctypes.data, memory[f"result{k}"], found.nbytes, stream
        )
        call(driver.cuStreamSynchronize, stream)
        rows = found.view(float).reshape(copies, count, -1)[:, :, : values.shape[1]]
        scale = max(1.0, float(np.abs(values).max()))
        errors.append((np.abs(rows - values) / scale).ravel())
    call(driver.cuStreamDestroy, stream)
    for address in memory.values():
        call(driver.cuMemFree, address)
    call(driver.cuModuleUnload, module)
    differences = np.concatenate(errors)
    largest = float(differences.max())  # NaN where a member failed
    return {
        "batch": file.stem,
        "members": size,
        "loading_s": loading,
        "us_each": 1e6 * float(np.median(walls)) / size,
        "median": float(np.median(differences)),
        "largest": largest,
        "bound": bound,
        "passed": bool(largest <= bound),
    }


def call(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of the driver; return its value.  Raises RuntimeError for an error."""
    status, *values = function(*arguments)
    if int(status) != 0:
        raise RuntimeError(f"{function.__name__} failed: {status.name}")
    return values[0] if values else None


def run_folder(driver: Any, folder: Path, members: int) -> list[dict[str, Any]]:
    """Run all batches of a folder on the first device; print a line for each."""
    call(driver.cuInit, 0)
    device = call(driver.cuDeviceGet, 0)
    call(driver.cuCtxPushCurrent, call(driver.cuDevicePrimaryCtxRetain, device))
    results = []
    print("batch                 members   load s  µs each    median   largest     bound")
    try:
        for file in sorted(folder.glob("*.npz")):
            results.append(result := run_batch(driver, file, members))
            print(
                f"{result['batch']:20} {result['members']:8d} {result['loading_s']:8.2f} "
                f"{result['us_each']:8.3f} {result['median']:9.1e} {result['largest']:9.1e} "
                f"{result['bound']:9.1e}{'' if result['passed'] else '  FAILED'}",
                flush=True,
            )
    finally:
        call(driver.cuCtxPopCurrent)
    return results


def main() -> int:
    """Run the batches of a folder; write results.json there; return 1 if one fails."""
    from cuda.bindings import driver

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder of exported batches")
    parser.add_argument("--members", type=int, default=65536, help="smallest number of members")
    options = parser.parse_args()
    results = run_folder(driver, options.folder, options.members)
    (options.folder / "results.json").write_text(json.dumps(results, indent=1))
    return 0 if results and all(result["passed"] for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())

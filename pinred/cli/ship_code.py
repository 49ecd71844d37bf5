"""`python -m pinred.cli.ship_code`: write the bitcode of compiled functions that the package ships.

Run it after a change of the integrators or of any other compiled function, and once for each new
version of numba or llvmlite; `--check` compares instead.
"""

from __future__ import annotations

import argparse
import filecmp
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shutil import copytree, rmtree
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numba.core import event as events

from ..analysis.gaits.gait import Gait
from ..analysis.phases.phase import phase
from ..common.errors import InputError
from ..forces.kinds import Torque
from ..forces.signals.tabulated import Hold
from ..integrators.methods import DOP853, METHODS, Explicit, Tsit5
from ..integrators.stepping import shipped_code
from ..integrators.stepping.code_cache import CodeCache
from ..integrators.stepping.portable_code import extract_bitcode
from ..judge.compare import compare
from ..kernels.device.device_code import loop_arguments
from ..kernels.device.few_rows import stepper_with_few_rows
from ..simulation.flow_map.flow import flow
from ..simulation.simulate import simulate
from ..simulation.simulate_many import simulate_many
from ..system.load import load
from ..system.system import System
from ..views.playback.film import SIZE
from ..views.playback.film_frames import Frames
from ..views.playback.view_options import FILM_FPS, View
from .warm_caches import warm_caches

_PASSES = 5  # limit on the number of processes
_DURATION = 0.02  # of all simulations [s]


def main(words: list[str] | None = None) -> int:
    """Write the bitcode, or compare it with new bitcode.

    Args:
        words: Arguments; None for those of the process.
    Returns:
        0, or 1 if the shipped bitcode differs.
    """
    parser = argparse.ArgumentParser(prog="python -m pinred.cli.ship_code", description=__doc__)
    parser.add_argument("--check", action="store_true", help="only compare with new bitcode")
    parser.add_argument("--into", type=Path, default=shipped_code.FOLDER, help="another folder")
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    if options.once:
        print(compile_missing(options.into))
        return 0
    with TemporaryDirectory() as temporary:
        build(Path(temporary))
        new, shipped = Path(temporary), options.into
        if options.check:
            different = find_differences(new, shipped)
            print("\n".join(different) or "the shipped bitcode is the bitcode of the sources")
            return 1 if different else 0
        rmtree(shipped, ignore_errors=True)
        copytree(new, shipped)
    return 0


def build(folder: Path) -> None:
    """Write the bitcode of all functions that common calls compile.

    A function that was compiled for another one first is compiled by a later process.  The last
    process finds all bitcode, so it compiles nothing.

    Args:
        folder: Folder of shipped bitcode.
    Raises:
        RuntimeError: Processes with all bitcode still compile.
    """
    for _ in range(_PASSES):
        with TemporaryDirectory() as cache:
            done = subprocess.run(
                [sys.executable, "-m", __spec__.name, "--once", "--into", str(folder)],
                env={**os.environ, "PINRED_CACHE_DIR": cache}, stdout=subprocess.PIPE, check=True,
            )  # fmt: skip
        if int(done.stdout) == 0:
            return
    raise RuntimeError(f"functions were compiled in each of {_PASSES} processes")


def find_differences(new: Path, shipped: Path) -> list[str]:
    """Return the names of the files that only one of two folders has, or that differ."""
    names = {file.relative_to(root) for root in (new, shipped) for file in _files(root)}
    _, differing, missing = filecmp.cmpfiles(new, shipped, sorted(map(str, names)), shallow=False)
    return sorted([*differing, *missing])


def _files(root: Path) -> Iterator[Path]:
    return (file for file in (root / shipped_code.environment()).glob("*") if file.is_file())


def compile_missing(folder: Path) -> int:
    """Run common calls, and write the bitcode of functions that they compile.

    Args:
        folder: Folder of shipped bitcode.
    Returns:
        The number of functions compiled.
    """
    shipped_code.FOLDER = folder
    system = load("falling_cat")
    with events.install_recorder("numba:compile") as record:
        for call in _calls(system):
            call()
        for _ in warm_caches(system):
            pass
    depth = count = 0
    for _, event in record.buffer:
        depth += 1 if event.is_start else -1
        dispatcher = event.data["dispatcher"]
        store = vars(dispatcher).get("_cache")
        if event.is_start and depth == 1 and isinstance(store, CodeCache):
            arguments = tuple(event.data["args"])
            bitcode = extract_bitcode(dispatcher.overloads[arguments])
            if bitcode is not None:
                shipped_code.write_shipped(store.shipped_name(arguments), bitcode)
                count += 1
    return count


def _calls(system: System) -> Iterator[Callable[[], Any]]:
    """Yield simulations, batches and derivatives with all methods."""
    for name, kind in METHODS.items():
        method = name if kind.adaptive else f"{name}(0.01)"
        yield partial(_between, system, method)
        yield partial(simulate_many, system, seeds=range(8), times=[_DURATION], method=method)
        yield partial(_derivatives, system, method)
    yield lambda: compare(simulate(system, seed=1, duration=_DURATION))
    for kind in (DOP853, Tsit5):
        yield partial(stepper_with_few_rows(kind()).loops.advance, *loop_arguments())
    yield partial(_uncommon, system)
    yield partial(_film, system)
    if find_spec("jax") is not None:
        yield partial(_jax_gradient, system)


def _between(system: System, method: str) -> Any:
    return simulate(system, seed=1, duration=_DURATION, method=method)(np.array([0.7 * _DURATION]))


def _uncommon(system: System) -> Any:
    """Read a batch, prescribe a joint, hold a torque piecewise, and integrate along a gait."""
    joint, *further = system.space.names
    torque = Torque({further[0]: Hold([0.0, 0.5 * _DURATION], [1.0, 0.0])})
    driven: dict[str, Any] = {
        "duration": _DURATION,
        "prescribed": {joint: "0.1*sin(t)"},
        "hold": "free",
    }
    simulate(system, **driven, forces=[torque])
    compare(simulate(system, **driven))
    # The kernel of a rigid body is small enough for the larger number of lanes.
    body = load("rigid_body")
    for method in (name for name, kind in METHODS.items() if issubclass(kind, Explicit)):
        simulate_many(body, seeds=range(8), times=[_DURATION], method=method)
    corners = 0.1 * np.eye(3, system.m)
    return (
        simulate_many(system, seeds=range(8), times=[_DURATION]).x,
        phase(system, Gait.waypoints(corners)),
    )


def _film(system: System) -> Any:
    """Draw a frame of a film."""
    traj = simulate(system, seed=1, duration=_DURATION)
    return Frames(traj, View(fps=FILM_FPS), SIZE).draw(0.0)


def _jax_gradient(system: System) -> Any:
    """Differentiate a flow by JAX, which calls it through compiled functions."""
    import jax

    function = flow(system, wrt=["x0"], of=["x"], seed=1, duration=_DURATION).jax()
    return jax.grad(lambda x0: function(x0).sum())(np.zeros(system.m))


def _derivatives(system: System, method: str) -> Any:
    try:
        endpoint = flow(system, wrt=["x0"], seed=1, duration=_DURATION, method=method)
        columns = endpoint.jacobian()["x0"].shape[-1]
    except InputError:  # the steps of some methods have no derivatives
        return None
    endpoint.jvp({"x0": np.ones(columns)})
    return endpoint.vjp({"pose": np.ones(system.group.dim)})


if __name__ == "__main__":
    sys.exit(main())

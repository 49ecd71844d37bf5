"""Write the bitcode of compiled functions that the package ships.

Run `python tests/helpers/ship_code.py` after a change of the integrators or of any other compiled
function; `--check` compares instead.  It installs the compiler in a temporary folder, so every
machine writes the same bitcode.
"""

from __future__ import annotations

import argparse
import filecmp
import lzma
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

from pinred.analysis.phases.gait import Gait
from pinred.analysis.phases.phase import phase
from pinred.analysis.stability.linearised_flow import linearised_flow
from pinred.cli.installation_commands import warm_caches
from pinred.common.errors import InputError
from pinred.forces.kinds import Torque
from pinred.forces.signals.signal import Hold
from pinred.integrators.methods import DOP853, METHODS, Explicit, Tsit5
from pinred.integrators.stepping import shipped_code
from pinred.integrators.stepping.call_wrapper import ArgumentType, Bitcode
from pinred.judge.compare import compare
from pinred.kernels.device.device_code import bitcode_of_loop, loop_arguments
from pinred.kernels.device.few_rows import stepper_with_few_rows
from pinred.kernels.kernel import repeat, repeat_adjoint
from pinred.simulation.flow_map.flow import flow
from pinred.simulation.simulate import simulate
from pinred.simulation.simulate_many import simulate_many
from pinred.system.load import load
from pinred.system.system import System
from pinred.views.playback.colours_and_view_options import FILM_FPS, View
from pinred.views.playback.film import SIZE, Frames

# The compiler of all shipped bitcode.  Newer versions of LLVM read bitcode of this one, the oldest
# that pinred supports, but not conversely.
COMPILER = ("numba==0.65.1", "llvmlite==0.47.0")
_DURATION = 0.02  # of all simulations [s]


def main(words: list[str] | None = None) -> int:
    """Write the bitcode, or compare it with new bitcode.

    Args:
        words: Arguments; None for those of the process.
    Returns:
        0, or 1 if the shipped bitcode differs.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only compare with new bitcode")
    parser.add_argument("--into", type=Path, default=shipped_code.FOLDER, help="another folder")
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    if options.once:
        compile_missing(options.into)
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
    """Write the bitcode of all functions that common calls compile, with COMPILER.

    Args:
        folder: Folder of shipped bitcode.
    """
    with TemporaryDirectory() as cache, TemporaryDirectory() as compiler:
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--target", compiler]
        subprocess.run([*install, *COMPILER], check=True)
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join([compiler, package, os.environ.get("PYTHONPATH", "")])
        subprocess.run(
            [sys.executable, __file__, "--once", "--into", str(folder)],
            env={**os.environ, "PINRED_CACHE_DIR": cache, "PYTHONPATH": path}, check=True,
        )  # fmt: skip


def find_differences(new: Path, shipped: Path) -> list[str]:
    """Return the names of the files that only one of two folders has, or that differ."""
    names = {file.relative_to(root) for root in (new, shipped) for file in _files(root)}
    _, differing, missing = filecmp.cmpfiles(new, shipped, sorted(map(str, names)), shallow=False)
    return sorted([*differing, *missing])


def _files(root: Path) -> Iterator[Path]:
    return (file for file in root.glob("*") if file.is_file())


def compile_missing(folder: Path) -> None:
    """Run common calls, and write the bitcode of functions that they compile.

    Args:
        folder: Folder of shipped bitcode.
    """
    from pinred.integrators.stepping import numba_functions

    shipped_code.FOLDER = folder
    compile_bitcode = numba_functions.compile_bitcode

    def compile_and_write(function: Any, name: str, types: tuple[ArgumentType, ...]) -> Bitcode:
        bitcode = compile_bitcode(function, name, types)
        folder.mkdir(parents=True, exist_ok=True)
        text = f"{bitcode.result}\n".encode() + bitcode.module
        (folder / name).write_bytes(lzma.compress(text, preset=9 | lzma.PRESET_EXTREME))
        return bitcode

    numba_functions.compile_bitcode = compile_and_write
    system = load("falling_cat")
    for call in _calls(system):
        call()
    for _ in warm_caches(system):
        pass


def _calls(system: System) -> Iterator[Callable[[], Any]]:
    """Yield simulations, batches and derivatives with all methods."""
    for name, method_class in METHODS.items():
        method = name if method_class.adaptive else f"{name}(0.01)"
        yield partial(_between, system, method)
        yield partial(_in_parts, system, method)
        yield partial(simulate_many, system, seeds=range(8), times=[_DURATION], method=method)
        yield partial(_derivatives, system, method)
        yield partial(_without_variables, method)
    yield lambda: compare(simulate(system, seed=1, duration=_DURATION))
    for method_class in (DOP853, Tsit5):
        for tangent in (False, True):
            stepper = stepper_with_few_rows(method_class(), tangent=tangent)
            yield partial(stepper.loops.advance, *loop_arguments())
        stepper = stepper_with_few_rows(method_class(), group=True)
        yield partial(bitcode_of_loop, stepper.loops.advance)
        yield partial(_jacobians, system, method_class.__name__)
    yield partial(_uncommon, system)
    yield partial(_film, system)
    if find_spec("jax") is not None:
        yield partial(_jax_gradient, system)


def _between(system: System, method: str) -> Any:
    return simulate(system, seed=1, duration=_DURATION, method=method)(np.array([0.7 * _DURATION]))


def _in_parts(system: System, method: str) -> Any:
    """Hold a torque piecewise, so that the motion has two parts."""
    torque = Torque({system.space.names[0]: Hold([0.0, 0.5 * _DURATION], [1.0, 0.0])})
    return simulate(system, seed=1, duration=_DURATION, method=method, forces=[torque])


def _without_variables(method: str) -> Any:
    """Integrate a batch of a body that only translates."""
    cart = load("cartpole", lock=["pole_pivot"])
    return simulate_many(cart, xi0=[[1.0], [2.0]], duration=_DURATION, method=method)


def _uncommon(system: System) -> Any:
    """Read a batch, prescribe a joint, linearise a motion, and follow a gait, and more."""
    driven: dict[str, Any] = {
        "duration": _DURATION,
        "prescribed": {system.space.names[0]: "0.1*sin(t)"},
        "hold": "free",
    }
    compare(simulate(system, **driven))
    # The kernel of a rigid body is small enough for the larger number of lanes.
    body = load("rigid_body")
    for method in (name for name, kind in METHODS.items() if issubclass(kind, Explicit)):
        simulate_many(body, seeds=range(8), times=[_DURATION], method=method)
    corners = 0.1 * np.eye(3, system.m)
    simulate(system, seed=1, duration=_DURATION, method="Gauss(0.01, solver='Newton')")
    stops: Any = {system.shape_names[0]: (-3.0, 3.0)}
    flow(system, wrt=["x0"], seed=1, duration=_DURATION, stops=stops).jacobian()
    linearised_flow(simulate(system, seed=1, duration=_DURATION)).advance(_DURATION)
    differentiated = flow(system, wrt=["x0"], seed=1, duration=_DURATION)
    (solution,) = differentiated.run({}).solutions
    propagator, y, p = differentiated.propagator, solution.states[0].copy(), solution.params
    repeat(propagator.kernel.rate.address, p, y, 1)
    gradient = np.empty(len(y) + len(p))
    repeat_adjoint(propagator.field.adjoint(), y, p, np.ones(len(y)), gradient, 1)
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


def _jacobians(system: System, method: str) -> Any:
    """Differentiate several motions at once."""
    many = flow(system, wrt=["x0"], seed=1, duration=_DURATION, method=method)
    return many.columns().jacobians(np.zeros((2, system.m)))


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

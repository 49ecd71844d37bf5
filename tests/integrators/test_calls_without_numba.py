"""Shipped code runs without numba, with the bits that numba's own calls of it give."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import pinred
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping import shipped_code

ROOT = Path(pinred.__file__).parent.parent
# Call the wrappers of shipped code; with "bits", also numba's dispatchers, and compare the bits.
PROGRAM = """
import gc, sys
import numpy as np
sys.modules["numba"] = None  # importing it raises an error
import pinred
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping.compiled_function import CompiledFunction

cat, body = pinred.load("falling_cat"), pinred.load("rigid_body")
times, between = [0.0, 0.05, 0.1], np.array([0.03, 0.07])

def bits():
    arrays = []
    for name in sys.argv[2:]:
        kind = METHODS[name]
        method = name if kind.adaptive else f"{name}(0.01)"
        one = pinred.simulate(cat, seed=1, times=times, method=method)
        many = pinred.simulate_many(cat, seeds=range(3), times=times, method=method)
        small = pinred.simulate_many(body, seeds=range(3), times=times, method=method)
        arrays += [one.x, one.xi, one(between).x, many.x, small.xi]
        if name in ("DOP853", "Gauss"):
            end = pinred.flow(cat, wrt=["x0"], seed=1, duration=0.1, method=method)
            backward = end.vjp({"pose": np.ones(6)})
            arrays += [*end.jacobian().values(), backward["x0"]]
    driven = pinred.simulate(cat, duration=0.1, prescribed={cat.shape_names[0]: "0.1*sin(t)"})
    for traj in (pinred.simulate(cat, seed=1, times=times), driven):
        report = pinred.compare(traj)
        assert report.verdict == "PASSED", report
    return np.concatenate(arrays, axis=None).tobytes()

shipped = bits()
assert "scipy.integrate" not in sys.modules, "an integrator of SciPy was imported"
if sys.argv[1] != "bits":
    sys.exit()
del sys.modules["numba"]
for function in gc.get_objects():
    if isinstance(function, CompiledFunction) and function._shipped:
        function._call = function.dispatcher
assert shipped == bits()
assert "numba" in sys.modules
"""


@pytest.mark.skipif(
    not (shipped_code.FOLDER / shipped_code.environment()).is_dir(),
    reason=f"no code is shipped for {shipped_code.environment()}",
)
@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(["no bits", "DOP853"], id="DOP853"),
        pytest.param(["bits", *METHODS], id="all", marks=[pytest.mark.by_hand, pytest.mark.slow]),
    ],
)
def test_calls_with_shipped_code_do_not_import_numba(arguments: list[str], tmp_path: Path) -> None:
    """With an empty cache, numba is not imported; what numba compiles has the same bits."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "PINRED_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, f"run `python -m pinred.cli.ship_code`\n{done.stderr}"

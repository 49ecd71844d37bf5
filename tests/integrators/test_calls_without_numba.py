"""Calls with the methods of pinred run without numba, which need not be installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import pinred
from pinred.integrators.methods import METHODS

ROOT = Path(pinred.__file__).parent.parent
PROGRAM = """
import sys
sys.modules["numba"] = None  # importing it raises an error
import numpy as np
import pinred
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping import compiling
from pinred.integrators.stepping.shipped_code import is_shipped

load_code = compiling.load_code

def load_shipped(function, name, types):
    assert is_shipped(name), f"no code is shipped of {name}"  # a cache may have code of numba
    return load_code(function, name, types)

compiling.load_code = load_shipped
cat, body = pinred.load("falling_cat"), pinred.load("rigid_body")
times, between = [0.0, 0.05, 0.1], np.array([0.03, 0.07])
for name in sys.argv[1:]:
    method = name if METHODS[name].adaptive else f"{name}(0.01)"
    pinred.simulate(cat, seed=1, times=times, method=method)(between)
    pinred.simulate_many(cat, seeds=range(3), times=times, method=method).x
    pinred.simulate_many(body, seeds=range(3), times=times, method=method)
    try:
        end = pinred.flow(cat, wrt=["x0"], seed=1, duration=0.1, method=method)
        end.jvp({"x0": np.ones(end.jacobian()["x0"].shape[-1])})
    except pinred.InputError:
        continue  # the steps of some methods have no derivatives
    end.vjp({"pose": np.ones(6)})
pinred.simulate(cat, seed=1, times=times, method="Gauss(0.01, solver='Newton')")
# Structure constants and columns of impacts need not be contiguous.
pinred.Connection.mechanical(pinred.load("cartpole")).curvature([0.3])
pinred.Connection.mechanical(cat).curvature([0.1, 0.2, 0.3])
stops = {cat.shape_names[0]: (-0.01, 0.01)}
through = {"x0": [0, 0, 0], "xdot0": [3, -2, 1], "stops": stops, "method": "AdaptiveGauss"}
pinred.flow(cat, wrt=["xdot0"], duration=0.1, **through).jacobian()
cart = pinred.load("cartpole", lock=["pole_pivot"])
pinred.simulate_many(cart, xi0=[[1.0], [2.0]], duration=0.1)
driven = pinred.simulate(cat, duration=0.1, prescribed={cat.shape_names[0]: "0.1*sin(t)"})
for traj in (pinred.simulate(cat, seed=1, times=times), driven):
    report = pinred.compare(traj)
    assert report.verdict == "PASSED", report
assert "scipy.integrate" not in sys.modules, "an integrator of SciPy was imported"
"""
OWN_METHOD = """
import sys
sys.modules["numba"] = None
from dataclasses import dataclass
from functools import cache
import numpy as np
import pinred
from pinred.integrators.explicit.runge_kutta import Tableau
from pinred.integrators.methods import Explicit

@dataclass(frozen=True)
class Heun(Explicit):
    order, dense_order = 2, 2
    @classmethod
    @cache
    def tableau(cls):
        A = [[0, 0, 0], [1, 0, 0], [0.5, 0.5, 0]]
        return Tableau(np.array(A), np.array([[0.5, -0.5, 0]]), np.zeros((0, 3)))

cat = pinred.load("falling_cat")
pinred.simulate(cat, seed=1, duration=0.1, method=Heun(1e-3, 1e-3))
"""


def run(program: str, *arguments: str, cache: Path | None) -> subprocess.CompletedProcess[str]:
    """Run a program with a cache folder, or with the one of this run."""
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, **({} if cache is None else {"PINRED_CACHE_DIR": str(cache)})},
    )  # fmt: skip


@pytest.mark.by_hand("all")
@pytest.mark.parametrize(
    ("names", "is_empty"),
    [pytest.param(["DOP853"], False, id="DOP853"), pytest.param(METHODS, True, id="all")],
)
def test_methods_of_pinred_need_no_numba(
    names: list[str], *, is_empty: bool, tmp_path: Path
) -> None:
    """Bitcode is shipped of all machine code; with an empty cache, it is generated from that."""
    done = run(PROGRAM, *names, cache=tmp_path if is_empty else None)
    assert done.returncode == 0, f"run `python tests/helpers/ship_code.py`\n{done.stderr}"


def test_method_with_own_coefficients_names_the_extra(tmp_path: Path) -> None:
    """No code can be shipped of it."""
    done = run(OWN_METHOD, cache=tmp_path)
    assert "MissingPackageError: no machine code is shipped of 'Heun_" in done.stderr
    assert 'pip install "pinred[methods]"' in done.stderr

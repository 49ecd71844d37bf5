"""Cached machine code: each method loads its own, and later processes compile nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

import pinred
from pinred.analysis.phases import lift
from pinred.integrators import stepping
from pinred.integrators.methods import METHODS, Method
from pinred.integrators.stepping.call_wrapper import NumberType
from pinred.integrators.stepping.compiling import (
    SOURCES,
    bind_globals,
    compiled,
    inlined,
    stamp,
    stamp_of,
)
from pinred.integrators.stepping.shipped_code import shipped_name

PACKAGE = Path(pinred.__file__).parent
CASES: dict[str, Method] = {
    name: kind(1e-8, 1e-10) if kind.adaptive else kind(0.02)  # type: ignore[call-arg]
    for name, kind in METHODS.items()
}
# Runs every method once, its states between steps, and a batch; counts the codes it generated.
PROGRAM = """
import numpy as np
import pinred
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping import shipped_code
count, generate = 0, shipped_code._compile
def counted(*arguments):
    global count
    count += 1
    return generate(*arguments)
shipped_code._compile = counted
cat, times, between = pinred.load("falling_cat"), [0.0, 0.1, 0.2], np.array([0.05, 0.15])
exact = pinred.simulate(cat, seed=1, times=times, method=METHODS["DOP853"](1e-12, 1e-14))
for name, kind in METHODS.items():
    method = kind(1e-8, 1e-10) if kind.adaptive else kind(0.002)
    one = pinred.simulate(cat, seed=1, times=times, method=method)
    two = pinred.simulate_many(cat, seeds=[1, 2], threads=1, times=times, method=method)
    assert np.abs(one.x - exact.x).max() < 1e-4, name
    assert np.abs(two[0].x - one.x).max() < 1e-14, name  # in lanes, or one by one
    assert np.abs(one(between).x - exact(between).x).max() < 1e-4, name
print(count)
"""


@pytest.mark.by_hand
def test_second_process_loads_all_loops_from_cache() -> None:
    """All loops come from disk; the code of another method would give large errors."""
    counts = []
    for _ in range(3):  # others may write to the same folder meanwhile
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM],
            cwd=PACKAGE.parent, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        counts.append(int(done.stdout.split()[-1]))
        if len(counts) > 1 and counts[-1] == 0:
            break
    assert counts[-1] == 0, counts


def loops_of(method: Method) -> list[Any]:
    """The compiled loops of a method."""
    return list(vars(method._stepper().loops).values())


def test_each_loop_has_its_own_cache_key() -> None:
    """The bytecode of the loops is equal, so only their names distinguish the keys."""
    loops = [loop for method in CASES.values() for loop in loops_of(method)]
    codes = {loop.py_func.__code__.co_code for loop in loops}
    keys = {shipped_name(loop.py_func, (NumberType(float),), loop.stamp) for loop in loops}
    assert len(codes) == 4
    assert len(keys) == len(loops) == 4 * len(METHODS)


def one(x: float) -> float:
    """The identity, which `loop` looks up by name."""
    return x


def loop(x: float) -> float:
    """The function that the tests below bind."""
    return one(x) + 1.0


CODE = """
import sys, types
sys.path.insert(0, {tests!r})
import test_compiling as test
from pinred.integrators.stepping import compiling

def plain(function, name, **found):  # as `bound` would be without a name of its own
    return types.FunctionType(function.__code__, {{**function.__globals__, **found}})

bind = compiling.bind_globals if {named} else plain
double = compiling.inlined(lambda x: 2.0 * x)
half = compiling.inlined(lambda x: 0.5 * x)
chosen = bind(test.loop, {name!r}, one={name})
print(compiling.compiled(chosen)(3.0))
"""


@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.parametrize("named", [True, False])
def test_compiled_copies_need_distinct_names(named: bool, tmp_path: Path) -> None:
    """Two processes bind two copies of one function; with names each runs its own."""
    results = []
    for name in ("double", "half"):
        code = CODE.format(tests=str(Path(__file__).parent), named=named, name=name)
        done = subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PINRED_CACHE_DIR": str(tmp_path)},
            cwd=PACKAGE.parent, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        results.append(float(done.stdout))
    assert results == ([7.0, 2.5] if named else [7.0, 7.0])


def test_duplicate_name_is_rejected() -> None:
    """A second copy of the same name would load the first one's machine code."""
    bind_globals(loop, "test_duplicate_name_is_rejected")
    with pytest.raises(RuntimeError, match="two compiled functions have the name"):
        bind_globals(loop, "test_duplicate_name_is_rejected")


def test_cache_stamp_depends_on_all_sources() -> None:
    """A change in one file makes the machine code of all others stale."""
    for method in CASES.values():
        for compiled_loop in loops_of(method):
            assert compiled_loop.stamp == SOURCES


@pytest.mark.parametrize(
    ("name", "is_compiled"),
    {"implicit/gauss_stages.py": True, "stepping/step_loop.py": True,
     "explicit/runge_kutta.py": True, "methods/method.py": False, "integrate.py": False}.items(),
)  # fmt: skip
def test_stamp_covers_sources_of_compiled_functions(
    name: str, is_compiled: bool, tmp_path: Path
) -> None:
    """A change in the options of a method, or in a function of Python alone, compiles nothing."""
    assert stamp(PACKAGE / "integrators") == SOURCES
    folder = tmp_path / "integrators"
    copytree(PACKAGE / "integrators", folder)
    assert stamp(folder) == SOURCES
    (folder / name).write_text((folder / name).read_text(encoding="utf-8") + "#", encoding="utf-8")
    assert (stamp(folder) != SOURCES) == is_compiled
    assert Path(stepping.__file__).parent.parent == PACKAGE / "integrators"


CONSTANT = """
from pinred.integrators.stepping.compiling import compiled

@compiled
def scale(x: float) -> float:
    return {factor} * x
"""


@pytest.mark.slow
def test_changed_constant_of_module_elsewhere_is_compiled_again(tmp_path: Path) -> None:
    """Only a constant differs; name, line and bytecode are the same."""
    results = []
    for factor in (2.0, 3.0):
        (tmp_path / "other.py").write_text(CONSTANT.format(factor=factor), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-B", "-c", "import other; print(other.scale(1.0))"],
            env={**os.environ, "PINRED_CACHE_DIR": str(tmp_path / "cache"),
                 "PYTHONPATH": f"{tmp_path}:{PACKAGE.parent}"},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        results.append(float(done.stdout))
    assert results == [2.0, 3.0]


def test_modules_with_compiled_functions_have_stamps_of_their_own() -> None:
    """Machine code outside of the integrators is stale when its file changes."""
    found = lift._lift.stamp  # type: ignore[attr-defined]
    assert found == stamp_of(PACKAGE / "analysis/phases/lift.py")
    assert found.startswith(SOURCES)
    assert found != SOURCES
    assert stamp_of(PACKAGE / "integrators/implicit/gauss_stages.py") == SOURCES
    assert stamp_of(PACKAGE / "integrators/integrate.py") != SOURCES  # it would have its own


def allocate_array(n: int) -> float:
    """A function that allocates an array."""
    return float(np.zeros(n).sum())


def test_compiled_functions_cannot_allocate_arrays() -> None:
    """Compiled functions have no reference counts, so allocation is a compile error."""
    for decorator in (compiled, inlined):
        with pytest.raises(TypingError, match="zeros"):
            decorator(allocate_array)(3)

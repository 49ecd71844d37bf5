"""Shipped bitcode of the integrators: its key, its portability, and equal bits with compilation."""

from __future__ import annotations

import lzma
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from numba import float64, int64

import pinred
from pinred.cli.ship_code import find_differences
from pinred.common.object_cache import ObjectCache
from pinred.integrators.methods import METHODS
from pinred.integrators.radau import dense
from pinred.integrators.stepping import shipped_code, wrapped_code
from pinred.integrators.stepping.compiled_function import CompiledFunction
from pinred.integrators.stepping.compiling import compiled
from pinred.integrators.stepping.kernel_call import from_lanes
from pinred.integrators.stepping.portable_code import extract_bitcode, link_bitcode
from pinred.integrators.stepping.shipped_code import Bitcode
from pinred.integrators.stepping.step_loop import Stepper

ROOT = Path(pinred.__file__).parent.parent
FOLDER = shipped_code.FOLDER / shipped_code.environment()
REBUILD = "run `python -m pinred.cli.ship_code`"
needs_code = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no code is shipped for {shipped_code.environment()}; {REBUILD}"
)
# Print the bits of a run, a batch and a state between steps, and the number of compilations.
PROGRAM = """
import sys
from pathlib import Path
import numba.core.event as events
import numpy as np
from pinred.integrators.stepping import shipped_code
shipped_code.FOLDER = Path(sys.argv[2])
import pinred
cat, times, method = pinred.load("falling_cat"), [0.0, 0.1, 0.2], sys.argv[1]
with events.install_recorder("numba:compile") as record:
    one = pinred.simulate(cat, seed=1, times=times, method=method)
    two = pinred.simulate_many(cat, seeds=range(3), times=times, method=method)
    states = [one.x, one.xi, one(np.array([0.05, 0.15])).x, *(member.x for member in two)]
print(np.concatenate(states, axis=None).tobytes().hex(), len(record.buffer) // 2)
"""


def run(method: str, folder: Path, cache: Path) -> tuple[str, int]:
    """Run a method with the bitcode in a folder; return the bits and the compilations."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, method, str(folder)], cwd=ROOT, capture_output=True,
        env={**os.environ, "PINRED_CACHE_DIR": str(cache)}, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    bits, count = done.stdout.split()
    return bits, int(count)


def stepper_of(name: str) -> Stepper:
    """The stepper of a method, which is the same for all options."""
    kind: Any = METHODS[name]
    stepper: Stepper = (kind() if kind.adaptive else kind(0.01))._stepper()
    return stepper


@needs_code
@pytest.mark.slow
@pytest.mark.by_hand
@pytest.mark.parametrize("name", METHODS)
def test_bits_are_equal_with_and_without_shipped_code(name: str, tmp_path: Path) -> None:
    """With bitcode nothing is compiled; without it, all functions are, with equal results."""
    method = name if METHODS[name].adaptive else f"{name}(0.01)"
    shipped, none = run(method, shipped_code.FOLDER, tmp_path / "1")
    compiled, some = run(method, tmp_path / "nothing", tmp_path / "2")
    assert shipped == compiled
    assert none == 0 < some, REBUILD


@needs_code
def test_shipped_code_belongs_to_these_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """The code of a method is found for the types with which simulations call it."""

    def refuse(function: CompiledFunction) -> None:
        pytest.fail(f"no code is shipped of {function.py_func.__name__}; {REBUILD}")

    monkeypatch.setattr(CompiledFunction, "dispatcher", property(refuse))
    cat = pinred.load("falling_cat")
    for name, kind in METHODS.items():
        method = name if kind.adaptive else f"{name}(0.01)"
        pinred.simulate(cat, seed=1, duration=0.02, method=method)
        advance: Any = stepper_of(name).loops.advance
        assert advance._shipped, REBUILD


@needs_code
def test_rebuilt_function_is_the_shipped_one(shipped: Any) -> None:
    """One small function is compiled again in each run of the tests; all of them by hand."""
    rebuilt = shipped_code.read_shipped(name_of(shipped))
    data = lzma.decompress((FOLDER / name_of(shipped)).read_bytes())
    assert data == f"{rebuilt.result}\n".encode() + rebuilt.module, REBUILD


@needs_code
@pytest.mark.by_hand
def test_shipped_code_is_what_the_sources_compile_to() -> None:
    """A new build has the same files, bit for bit."""
    done = subprocess.run(
        [sys.executable, "-m", "pinred.cli.ship_code", "--check"], cwd=ROOT, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_find_differences_reports_changed_and_missing_files(tmp_path: Path) -> None:
    """Equal files are not reported."""
    for folder, texts in {"new": "abc", "old": "aBd"}.items():
        (tmp_path / folder / shipped_code.environment()).mkdir(parents=True)
        for text in texts:
            file = tmp_path / folder / shipped_code.environment() / text.lower()
            file.write_text(text, encoding="utf-8")
    names = [Path(name).name for name in find_differences(tmp_path / "new", tmp_path / "old")]
    assert names == ["b", "c", "d"]


@needs_code
def test_shipped_code_runs_on_every_cpu_and_python() -> None:
    """It calls only the C library, and names no CPU."""
    allowed = {"sqrt", "tan", "memcpy", "memset", "memmove"}
    files = [file for file in FOLDER.iterdir() if file.is_file()]
    assert files
    for file in files:
        bitcode = shipped_code.find_shipped(file.name)
        assert bitcode is not None
        module = llvm.parse_bitcode(bitcode.module)
        foreign = {value.name for value in (*module.functions, *module.global_variables)
                   if value.is_declaration}  # fmt: skip
        assert {name for name in foreign if not name.startswith("llvm.")} <= allowed
        assert not [name for name in foreign if name.startswith(("llvm.x86", "llvm.aarch64"))]
        assert "target-cpu" not in str(module)
        assert "target-features" not in str(module)


# --- the key ------------------------------------------------------------------------------------


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Ship the code of a copy of `from_lanes`, which is compiled here; return the copy."""
    monkeypatch.setattr(shipped_code, "FOLDER", tmp_path / "shipped")
    monkeypatch.setattr(wrapped_code, "STORE", ObjectCache(tmp_path / "cache"))
    copy: Any = compiled(vars(from_lanes)["py_func"]).dispatcher
    copy(np.zeros((1, 8)), np.zeros((1, 2)))
    bitcode = extract_bitcode(copy.overloads[types_of(copy)])
    assert bitcode is not None
    shipped_code.write_shipped(name_of(copy), bitcode)
    assert shipped_code.find_shipped(name_of(copy)) == bitcode
    shipped_code.environment.cache_clear()
    yield copy
    monkeypatch.undo()
    shipped_code.environment.cache_clear()


def types_of(function: Any) -> tuple[Any, ...]:
    """The types of the arguments with which a function was called."""
    (types,) = function.overloads
    return tuple(types)


def name_of(function: Any) -> str:
    """The name of the file with the code of a function."""
    return str(function._cache.shipped_name(types_of(function)))


@pytest.mark.parametrize("package", ["numba", "llvmlite"])
def test_code_of_other_versions_is_not_found(
    package: str, shipped: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The optimiser, and what it expects of its caller, are those of the versions."""
    monkeypatch.setattr(
        shipped_code, "version", lambda name: version(name) + ".1" * (name == package)
    )
    assert shipped_code.find_shipped(name_of(shipped)) is None


def test_code_of_another_platform_is_not_found(
    shipped: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Calling conventions and sizes differ between target triples."""
    monkeypatch.setattr(llvm, "get_process_triple", lambda: "riscv64-unknown-linux-gnu")
    assert shipped_code.find_shipped(name_of(shipped)) is None


def test_code_optimised_for_another_cpu_is_not_found(
    shipped: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiler optimises for one CPU on all machines, so that results are equal."""
    monkeypatch.setattr(shipped_code, "OPTIMISED_FOR", "x86-64-v4")
    assert shipped_code.find_shipped(name_of(shipped)) is None


def test_code_of_other_sources_is_not_found(shipped: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stamp is a digest of the sources."""
    monkeypatch.setattr(shipped._cache, "stamp", "other")
    assert shipped_code.find_shipped(name_of(shipped)) is None


def test_code_of_another_function_or_type_is_not_found(shipped: Any) -> None:
    """Functions of one file have the same stamp."""

    def other(lanes: Any, out: Any) -> None:
        """A function with the same types."""

    name = shipped._cache.shipped_name((float64, int64))
    assert shipped_code.find_shipped(name) is None
    name = shipped_code.shipped_name(other, types_of(shipped), shipped._cache.stamp)
    assert shipped_code.find_shipped(name) is None


def test_name_depends_on_constants_of_called_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy computes the slopes in Radau's dense output, with a round-off of its own."""
    function = vars(stepper_of("Radau").loops.advance)["py_func"]
    name = shipped_code.shipped_name(function, (), "stamp")
    changed = dense._SLOPE.copy()
    changed[0] = np.nextafter(changed[0], 9.0)
    assert name == shipped_code.shipped_name(function, (), "stamp")
    monkeypatch.setattr(dense, "_SLOPE", changed)
    assert name != shipped_code.shipped_name(function, (), "stamp")


def test_linked_code_computes_what_the_compiled_function_does(shipped: Any) -> None:
    """A wrapper is compiled for this Python; the function itself comes from bitcode."""
    bitcode = shipped_code.find_shipped(name_of(shipped))
    assert isinstance(bitcode, Bitcode)
    linked = link_bitcode(shipped, types_of(shipped), bitcode)
    lanes, out, expected = np.arange(16.0)[None], np.zeros((2, 3)), np.zeros((2, 3))
    linked.entry_point(lanes, out)
    shipped.py_func(lanes, expected)
    assert np.array_equal(out, expected)
    assert np.array_equal(out, [[0.0, 1.0, 2.0], [8.0, 9.0, 10.0]])


def test_objects_of_python_are_not_shipped() -> None:
    """Printing needs objects of the interpreter."""

    def show(x: float) -> None:
        print(x)

    function: Any = numba.njit(show)
    function(0.0)
    assert extract_bitcode(function.overloads[(float64,)]) is None

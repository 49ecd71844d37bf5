"""Shipped bitcode of the integrators: its key, its portability, and equal bits with compilation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase, digits
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from numba import float64
from ship_code import find_differences

import pinred
from pinred.common.errors import MissingPackageError
from pinred.common.machine_code import create_machine, parse_bitcode
from pinred.common.object_cache import ObjectCache
from pinred.integrators.implicit import radau_iia
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping import numba_functions, shipped_code
from pinred.integrators.stepping.call_wrapper import argument_type
from pinred.integrators.stepping.compiling import CompiledFunction, compiled
from pinred.integrators.stepping.intrinsics import from_lanes
from pinred.integrators.stepping.numba_functions import extract_bitcode
from pinred.integrators.stepping.step_loop import Stepper

ROOT = Path(pinred.__file__).parent.parent
REBUILD = "run `python tests/helpers/ship_code.py`"
ARGUMENTS = (np.zeros((1, 8)), np.zeros((1, 2)))  # of from_lanes
# Print the bits of a run, a batch and a state between steps, and whether numba was imported.
PROGRAM = """
import sys
from pathlib import Path
from string import ascii_lowercase, ascii_uppercase, digits
import numpy as np
from pinred.integrators.stepping import shipped_code
shipped_code.FOLDER = Path(sys.argv[2])
import pinred
cat, times, method = pinred.load("falling_cat"), [0.0, 0.1, 0.2], sys.argv[1]
one = pinred.simulate(cat, seed=1, times=times, method=method)
two = pinred.simulate_many(cat, seeds=range(3), times=times, method=method)
states = [one.x, one.xi, one(np.array([0.05, 0.15])).x, *(member.x for member in two)]
print(np.concatenate(states, axis=None).tobytes().hex(), "numba" in sys.modules)
"""


def run(method: str, folder: Path, cache: Path) -> tuple[str, bool]:
    """Run a method with a folder of bitcode; return bits, and whether numba was imported."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, method, str(folder)], cwd=ROOT, capture_output=True,
        env={**os.environ, "PINRED_CACHE_DIR": str(cache)}, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    bits, imported = done.stdout.split()
    return bits, imported == "True"


def stepper_of(name: str) -> Stepper:
    """The stepper of a method, which is the same for all options."""
    kind: Any = METHODS[name]
    stepper: Stepper = (kind() if kind.adaptive else kind(0.01))._stepper()
    return stepper


@pytest.mark.slow
@pytest.mark.by_hand
@pytest.mark.parametrize("name", METHODS)
def test_bits_are_equal_with_and_without_shipped_code(name: str, tmp_path: Path) -> None:
    """With bitcode nothing is compiled; without it, all functions are, with equal results."""
    method = name if METHODS[name].adaptive else f"{name}(0.01)"
    shipped, with_numba = run(method, shipped_code.FOLDER, tmp_path / "1")
    built, without_code = run(method, tmp_path / "nothing", tmp_path / "2")
    assert shipped == built
    assert (with_numba, without_code) == (False, True), REBUILD


def test_shipped_code_belongs_to_these_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """The code of a method is found for the types with which simulations call it."""

    def refuse(function: CompiledFunction, *_: Any) -> None:
        pytest.fail(f"no code is shipped of {function.py_func.__name__}; {REBUILD}")

    monkeypatch.setattr(numba_functions, "compile_bitcode", refuse)
    cat = pinred.load("falling_cat")
    for name, kind in METHODS.items():
        method = name if kind.adaptive else f"{name}(0.01)"
        pinred.simulate(cat, seed=1, duration=0.02, method=method)
        advance: Any = stepper_of(name).loops.advance
        names = [
            shipped_code.shipped_name(advance.py_func, types, advance.stamp)
            for types in advance._codes
        ]
        assert names
        assert all(map(shipped_code.is_shipped, names)), REBUILD


@pytest.mark.by_hand
def test_shipped_code_is_what_the_sources_compile_to() -> None:
    """A new build has the same files, bit for bit."""
    done = subprocess.run(
        [sys.executable, "tests/helpers/ship_code.py", "--check"], cwd=ROOT, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_find_differences_reports_changed_and_missing_files(tmp_path: Path) -> None:
    """Equal files are not reported."""
    for folder, texts in {"new": "abc", "old": "aBd"}.items():
        (tmp_path / folder).mkdir()
        for text in texts:
            (tmp_path / folder / text.lower()).write_text(text, encoding="utf-8")
    names = [Path(name).name for name in find_differences(tmp_path / "new", tmp_path / "old")]
    assert names == ["b", "c", "d"]


# --- every processor and every version ----------------------------------------------------------


def test_shipped_code_runs_on_every_cpu_and_python() -> None:
    """It calls only the C library, and names no CPU."""
    allowed = {"sqrt", "tan", "memcpy", "memset", "memmove"}
    files = list(shipped_code.FOLDER.iterdir())
    assert files
    for file in files:
        module = llvm.parse_bitcode(shipped_code.read_shipped(file.name).module)
        foreign = {value.name for value in (*module.functions, *module.global_variables)
                   if value.is_declaration}  # fmt: skip
        assert {name for name in foreign if not name.startswith("llvm.")} <= allowed
        assert not [name for name in foreign if name.startswith(("llvm.x86", "llvm.aarch64"))]
        text = str(module)
        assert "target-cpu" not in text
        assert "target-features" not in text


def writer_of(bitcode: bytes) -> str:
    """The version of LLVM that wrote a module, from its head: characters of six bits."""
    characters = f"{ascii_lowercase}{ascii_uppercase}{digits}._"
    head = int.from_bytes(bitcode[:64], "little") >> 134
    return "".join(characters[head >> 6 * k & 63] for k in range(6))


def test_shipped_code_is_written_by_the_oldest_llvm() -> None:
    """Newer versions of LLVM read bitcode of version 20, which llvmlite 0.45 has."""
    bitcode = llvm.parse_assembly("").as_bitcode()
    assert writer_of(bitcode) == f"LLVM{llvm.llvm_version_info[0]}"
    for file in shipped_code.FOLDER.iterdir():
        assert writer_of(shipped_code.read_shipped(file.name).module) == "LLVM20", file.name


@pytest.mark.parametrize(
    ("triple", "machine"),
    [
        ("x86_64-unknown-linux-gnu", 62), ("aarch64-unknown-linux-gnu", 183),
        ("arm64-apple-darwin", 0x0100000C),
    ],
)  # fmt: skip
def test_shipped_code_becomes_machine_code_of_all_platforms(triple: str, machine: int) -> None:
    """The head of an object file has the number of its processor, of ELF or of macOS."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple).create_target_machine(opt=0, jit=True)
    (file,) = shipped_code.FOLDER.glob("RKMK4_advance-*")
    module = llvm.parse_bitcode(shipped_code.read_shipped(file.name).module)
    module.triple, module.data_layout = triple, str(target.target_data)
    code = target.emit_object(module)
    place = slice(18, 20) if code.startswith(b"\x7fELF") else slice(4, 8)
    assert int.from_bytes(code[place], "little") == machine


def test_parsed_bitcode_has_the_target_of_this_machine() -> None:
    """The files name the machine of their build."""
    module = llvm.parse_assembly(
        'target triple = "riscv64-unknown-linux-gnu"\ntarget datalayout = "e-i64:32"'
    )
    parsed = parse_bitcode(module.as_bitcode(), llvm.create_context())
    assert parsed.triple == create_machine(1).triple
    assert parsed.data_layout == str(create_machine(1).target_data)


# --- the key ------------------------------------------------------------------------------------


def name_of(function: Any, stamp: str | None = None) -> str:
    """The name of the file with the code of `from_lanes`, or of a function with its types."""
    types = tuple(kind for kind in map(argument_type, ARGUMENTS) if kind is not None)
    return shipped_code.shipped_name(function.py_func, types, stamp or function.stamp)


def test_name_depends_on_sources_function_and_types() -> None:
    """Functions of one file have the same stamp."""
    lanes: Any = from_lanes
    assert shipped_code.is_shipped(name_of(lanes)), REBUILD
    assert not shipped_code.is_shipped(name_of(lanes, "other sources"))
    assert not shipped_code.is_shipped(shipped_code.shipped_name(lanes.py_func, (), lanes.stamp))
    other: Any = compiled(lambda lanes, out: None)  # noqa: ARG005
    assert not shipped_code.is_shipped(name_of(other, lanes.stamp))


def test_name_depends_on_constants_of_called_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy computes the slopes in Radau's dense output, with a round-off of its own."""
    function = vars(stepper_of("Radau").loops.advance)["py_func"]
    name = shipped_code.shipped_name(function, (), "stamp")
    changed = radau_iia._SLOPE.copy()
    changed[0] = np.nextafter(changed[0], 9.0)
    assert name == shipped_code.shipped_name(function, (), "stamp")
    monkeypatch.setattr(radau_iia, "_SLOPE", changed)
    assert name != shipped_code.shipped_name(function, (), "stamp")


def test_name_depends_on_variables_of_enclosing_functions() -> None:
    """Functions that one function makes have the same name and source."""

    def scaled_by(factor: float) -> Any:
        return lambda x: factor * x

    names = {shipped_code.shipped_name(scaled_by(factor), (), "stamp") for factor in (2.0, 3.0)}
    assert len(names) == 2


# --- without shipped code -----------------------------------------------------------------------


@pytest.fixture
def lanes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A copy of `from_lanes` for which no code is shipped or cached."""
    monkeypatch.setattr(shipped_code, "FOLDER", tmp_path / "shipped")
    monkeypatch.setattr(shipped_code, "STORE", ObjectCache(tmp_path / "cache"))
    return compiled(vars(from_lanes)["py_func"])


def test_function_without_shipped_code_is_compiled_once(
    lanes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next function finds the machine code in the cache."""
    for numbers in (np.arange(16.0)[None], 2.0 * np.arange(16.0)[None]):
        out = np.zeros((2, 3))
        lanes(numbers, out)
        assert np.array_equal(out, numbers[0, [[0, 1, 2], [8, 9, 10]]])
    monkeypatch.setattr(numba_functions, "compile_bitcode", lambda *_: pytest.fail("compiled"))
    compiled(lanes.py_func)(np.zeros((1, 8)), np.zeros((1, 2)))


def test_function_without_shipped_code_needs_numba(
    lanes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error names the extra."""
    monkeypatch.setitem(sys.modules, "numba", None)
    message = r"no machine code is shipped of 'from_lanes'.* pip install \"pinred\[methods\]\""
    with pytest.raises(MissingPackageError, match=message):
        lanes(*ARGUMENTS)


def test_objects_of_python_are_not_shipped() -> None:
    """Printing needs objects of the interpreter."""

    def show(x: float) -> None:
        print(x)

    function: Any = numba.njit(show)
    function(0.0)
    assert extract_bitcode(function.overloads[(float64,)]) is None
    printing: Any = compiled(show)
    with pytest.raises(TypeError, match="needs objects of Python"):
        printing(0.0)

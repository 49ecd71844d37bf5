"""Machine code of integrators that other threads generate ahead: its types, parts and bits."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path
from threading import Event, Thread
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest

import pinred
from pinred.common import object_cache
from pinred.common.errors import InputError
from pinred.common.machine_code import (
    _unlocked_library,
    archive_of,
    create_machine,
    emit_object,
    load_object,
)
from pinred.common.object_cache import ObjectCache
from pinred.integrators.methods import METHODS
from pinred.integrators.stepping import shipped_code
from pinred.integrators.stepping.call_wrapper import argument_type, plain_value
from pinred.integrators.stepping.compiling import CompiledFunction
from pinred.integrators.stepping.intrinsics import from_lanes
from pinred.simulation.compiled import code_ahead
from pinred.simulation.compiled.code_ahead import divide

FOLDER = shipped_code.FOLDER
TWO_FUNCTIONS = """
@factor = private constant double 3.0
define internal double @0(double %x) {
  %c = load double, ptr @factor
  %y = fmul double %x, %c
  ret double %y
}
define double @triple(double %x) #0 {
  %y = call double @0(double %x)
  ret double %y
}
attributes #0 = { nounwind }
"""


@pytest.mark.parametrize("name", ["DOP853", "Radau", "Gauss", "Tsit5"])
def test_calls_use_the_types_that_are_expected(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code that is generated ahead is the code that the calls load."""
    expected: list[tuple[Any, tuple[Any, ...]]] = []

    def record(function: Any, *arguments: Any) -> None:
        expected.append((function, tuple(argument_type(plain_value(a)) for a in arguments)))

    monkeypatch.setattr(code_ahead, "_requested", set())
    monkeypatch.setattr(code_ahead, "_expect", record)
    monkeypatch.setattr(code_ahead, "spare_processors", lambda: 1)
    cat = pinred.load("falling_cat")
    method = name if METHODS[name].adaptive else f"{name}(0.01)"
    pinred.simulate(cat, seed=1, duration=0.02, method=method)
    pinred.simulate_many(cat, seeds=range(3), times=[0.02], method=method)
    if name != "Radau":
        end = pinred.flow(cat, wrt=["x0"], seed=1, duration=0.02, method=method)
        along = {"x0": np.ones(end.jacobian()["x0"].shape[-1])}
        end.jvp(along)
        end.vjp({"pose": np.ones(cat.group.dim)})
    assert {function.__name__ for function, _ in expected}
    for function, types in expected:
        assert function.has_code(types), function.__name__
        assert shipped_code.is_shipped(
            shipped_code.shipped_name(function.py_func, types, function.stamp)
        )


@pytest.mark.parametrize("name", ["jacobian", "RKMK4_advance"])
def test_parts_have_the_instructions_of_the_whole(name: str) -> None:
    """Only the visibility of functions differs, which calls do not depend on."""
    (file,) = FOLDER.glob(f"{name}-*")
    bitcode = shipped_code.read_shipped(file.name).module
    whole = llvm.parse_bitcode(bitcode, llvm.create_context())
    for k, function in enumerate(f for f in whole.functions if not f.is_declaration):
        if function.linkage == llvm.Linkage.internal:
            function.name = f"part_{k}"
    expected = bodies(create_machine(3).emit_assembly(whole))
    texts = divide(llvm.parse_bitcode(bitcode, llvm.create_context()))
    found: dict[str, list[str]] = {}
    for text in texts:
        part = llvm.parse_assembly(text, llvm.create_context())
        found |= bodies(create_machine(3).emit_assembly(part))
    assert found == expected
    assert len(found) > 1


def bodies(assembly: str) -> dict[str, list[str]]:
    """Return the instructions of each function, without numbers of labels and constants."""
    pieces = re.split(r"^\t\.type\t(\w+),@function$", assembly, flags=re.MULTILINE)
    return {
        name: [
            re.sub(r"(\.L\w+?)\d+(_\d+)?", r"\1", line).split("#")[0].strip()
            for line in text.split(".Lfunc_end")[0].splitlines()[1:]
        ]
        for name, text in zip(pieces[1::2], pieces[2::2], strict=True)
    }


def test_parts_of_a_module_call_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """An archive of object codes is loaded like one object code."""
    monkeypatch.setattr("pinred.simulation.compiled.code_ahead._LENGTH", 1)
    texts = divide(llvm.parse_assembly(TWO_FUNCTIONS, llvm.create_context()))
    assert len(texts) == 2
    codes = [
        emit_object(create_machine(3), llvm.parse_assembly(text, llvm.create_context()))
        for text in texts
    ]
    code = load_object(archive_of(codes), "triple")
    assert ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(code.address)(2.0) == 6.0


def test_longest_part_is_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that compiles first should not wait for the longest part at the end."""
    monkeypatch.setattr("pinred.simulation.compiled.code_ahead._LENGTH", 1)
    lengths = [len(t) for t in divide(llvm.parse_assembly(TWO_FUNCTIONS, llvm.create_context()))]
    assert lengths == sorted(lengths, reverse=True)


def test_object_code_is_that_of_llvmlite() -> None:
    """Calls without llvmlite's lock generate the same bytes."""
    first, second = (llvm.parse_assembly(TWO_FUNCTIONS, llvm.create_context()) for _ in range(2))
    assert emit_object(create_machine(3), first) == create_machine(3).emit_object(second)


@pytest.mark.parametrize("error", [AttributeError, OSError])
def test_other_versions_of_llvmlite_generate_code_with_its_lock(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The functions without the lock are not part of llvmlite's interface."""

    def cannot_load(_name: str) -> Any:
        raise error

    monkeypatch.setattr("pinred.common.machine_code.ctypes.CDLL", cannot_load)
    monkeypatch.setattr(
        "pinred.common.machine_code._unlocked_library", _unlocked_library.__wrapped__
    )
    first, second = (llvm.parse_assembly(TWO_FUNCTIONS, llvm.create_context()) for _ in range(2))
    assert emit_object(create_machine(3), first) == create_machine(3).emit_object(second)


def test_code_is_generated_while_another_thread_holds_the_lock_of_llvmlite() -> None:
    """The lock of llvmlite allows one call at a time; a kernel and an integrator need two."""
    module = llvm.parse_assembly(TWO_FUNCTIONS, llvm.create_context())
    machine = create_machine(3)
    lock, held, go = llvm.ffi.lib._lock, Event(), Event()

    def hold() -> None:
        with lock:
            held.set()
            assert go.wait(10.0)

    codes: list[bytes] = []
    thread = Thread(target=hold)
    other = Thread(target=lambda: codes.append(emit_object(machine, module)))
    thread.start()
    assert held.wait(10.0)
    other.start()
    other.join(10.0)
    generated = list(codes)
    go.set()
    thread.join()
    other.join()
    assert generated


def test_archive_with_a_damaged_member_is_rejected() -> None:
    """LLVM would end the process."""
    module = llvm.parse_assembly(TWO_FUNCTIONS, llvm.create_context())
    code = emit_object(create_machine(3), module)
    with pytest.raises(InputError, match="not object code"):
        load_object(archive_of([code, b"damaged"]), "triple")


@pytest.mark.parametrize("cause", ["no code", "other objects"])
def test_code_that_calls_cannot_use_is_not_generated(
    cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is generated ahead without shipped code, or where Python has other objects."""
    begun: list[object] = []
    monkeypatch.setattr("pinred.common.object_cache.begin_ahead", begun.append)
    monkeypatch.setattr(ObjectCache, "_has_entry", lambda *_: False)
    for module in ("common.object_cache", "simulation.compiled.code_ahead"):
        monkeypatch.setattr(f"pinred.{module}.spare_processors", lambda: 1)
    function = CompiledFunction(vars(from_lanes)["py_func"], vars(from_lanes)["stamp"])
    arguments = np.zeros((1, 8)), np.zeros((1, 2))
    with monkeypatch.context() as patch:
        if cause == "no code":
            patch.setattr(shipped_code, "FOLDER", Path("/proc/nothing"))
        else:
            patch.setattr(code_ahead, "objects_are_as_expected", lambda: False)
        code_ahead.expect(function, *arguments)
    assert begun == []
    code_ahead.expect(function, *arguments)
    assert len(begun) == 1
    object_cache._ahead.clear()
    function(*arguments)
    code_ahead.expect(function, *arguments)
    assert len(begun) == 1


def test_threads_end_with_the_call_and_warm_calls_start_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With all code in the cache or in memory, nothing is generated ahead."""
    cat = pinred.load("falling_cat")
    pinred.simulate_many(cat, seeds=range(3), times=[0.02], threads=1)
    pinred.simulate(cat, seed=1, duration=0.02)
    object_cache.wait_for_workers()
    begun: list[object] = []
    monkeypatch.setattr(code_ahead, "_requested", set())
    monkeypatch.setattr("pinred.common.object_cache.begin_ahead", begun.append)
    monkeypatch.setattr(object_cache, "spare_processors", lambda: 1)
    other = pinred.load("falling_cat")
    pinred.simulate_many(other, seeds=range(3), times=[0.02], threads=1)
    pinred.simulate(other, seed=1, duration=0.02)
    assert begun == []
    assert not object_cache._workers

"""Wrappers of shipped functions: the arguments they accept, and calls without the GIL."""

from __future__ import annotations

import ctypes
import pickle
import threading
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
import pytest

from pinred.common.errors import UnsupportedOperationError
from pinred.common.machine_code import create_machine, load_object
from pinred.common.object_cache import ObjectCache
from pinred.integrators.stepping import (
    call_wrapper,
    numba_functions,
    shipped_code,
)
from pinred.integrators.stepping.call_wrapper import (
    argument_type,
    objects_are_as_expected,
    plain_value,
)
from pinred.integrators.stepping.compiling import CompiledFunction, compiled
from pinred.integrators.stepping.numba_functions import RESHAPE_CODE
from pinred.integrators.stepping.run_state import new_run

RECORD = np.dtype([("t", np.float64), ("n", np.int64)], align=True)


class Pair(NamedTuple):
    """A named tuple of an array and a number."""

    array: Any
    number: Any


class Other(NamedTuple):
    """Another named tuple with the same fields."""

    array: Any
    number: Any


def python_probe(
    run: Any, x: float, k: int, flag: bool, pair: Pair, sizes: tuple[int, int], out: Any
) -> float:
    """Use an argument of each type; return their sum, or raise an error where x is negative."""
    run[0].n += k
    if flag:
        out[1, 2] = pair.array[1] + out.shape[0]
    if x < 0.0:
        out[0, 0] = pair.array.reshape(3, 2)[0, 0]  # the sizes differ
    total: float = x + k + sizes[0] + 10 * sizes[1] + pair.number
    return total


def python_wait(flags: Any, limit: int) -> bool:
    """Count until another thread sets the first flag."""
    for _ in range(limit):
        flags[1] += 1
        if flags[0] != 0:
            return True
    return False


def arguments() -> list[Any]:
    """Return arguments that the compiled probe accepts."""
    pair = Pair(np.arange(4.0), 7)
    return [np.zeros(1, RECORD), 0.5, 3, True, pair, (1, 2), np.zeros((2, 3))]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Compile the probe and the wait; their machine code is in a cache."""
    folder = tmp_path_factory.mktemp("code")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shipped_code, "FOLDER", folder / "shipped")
        patch.setattr(shipped_code, "STORE", ObjectCache(folder / "cache"))
        for function, given in (
            (python_probe, arguments()), (python_wait, [np.zeros(2, np.int64), 0]),
        ):  # fmt: skip
            built: Any = compiled(function)
            built(*given)
        yield folder


@pytest.fixture
def probe(folders: Path, monkeypatch: pytest.MonkeyPatch) -> CompiledFunction:
    """Return the probe, which must not be compiled."""
    assert folders.is_dir()
    copy: Any = compiled(python_probe)

    def refuse(function: CompiledFunction, *_: Any) -> Any:
        raise AssertionError(f"{function} was compiled")

    monkeypatch.setattr(numba_functions, "compile_bitcode", refuse)
    return copy  # type: ignore[no-any-return]


def test_wrapper_passes_arguments_of_all_types(probe: CompiledFunction) -> None:
    """Records, numbers, truth values, tuples and arrays; the code comes from the cache later."""
    for call in range(2):
        given = arguments()
        assert probe(*given) == 0.5 + 3 + 1 + 20 + 7
        assert given[0]["n"] == 3
        assert np.array_equal(given[-1], [[0, 0, 0], [0, 0, 3]])
        given[3] = False
        given[-1][:] = 0.0
        assert probe(*given) == 31.5
        assert not given[-1].any(), call
        probe = CompiledFunction(probe.py_func, probe.stamp)  # loads the code from the cache


def unaligned() -> Any:
    """Return an array whose numbers are not aligned."""
    return np.zeros(49, np.uint8)[1:].view(np.float64).reshape(2, 3)


def read_only() -> Any:
    """Return an array that cannot be written."""
    array = np.zeros((2, 3))
    array.flags.writeable = False
    return array


class Subclass(np.ndarray[Any, Any]):
    """An array of another class."""


@pytest.mark.parametrize(
    ("index", "value"),
    [
        (6, np.zeros((1, 2, 3))),
        (6, np.zeros((2, 3), np.int64)),
        (6, np.zeros((2, 6))[:, ::2]),
        (6, np.zeros((3, 2)).T),
        (6, unaligned()),
        (6, np.zeros((2, 3)).view(Subclass)),
        (6, [[0.0] * 3] * 2),
        (0, np.zeros(1, [("t", np.float64), ("m", np.int64)])),
        (1, 1),
        (1, "1"),
        (1, True),
        (2, 1.0),
        (2, True),
        (2, 2**63),
        (3, 1),
        (4, (np.arange(4.0), 7)),
        (4, Other(np.arange(4.0), 7)),
        (4, Pair(np.arange(4.0), 7.0)),
        (5, [1, 2]),
        (5, (1, 2, 3)),
        (5, (1, 2.0)),
    ],
)
def test_wrapper_rejects_other_types(index: int, value: Any, probe: CompiledFunction) -> None:
    """They are compiled; machine code for another type would read wrong memory."""
    given = arguments()
    probe(*given)
    (wrapper,) = probe._codes.values()
    given[index] = value
    assert wrapper(*given) is NotImplemented
    assert wrapper(*given[:-1]) is NotImplemented
    assert wrapper(*arguments(), 1) is NotImplemented
    assert wrapper(*arguments()) == 31.5  # no Python exception is pending
    with pytest.raises((AssertionError, TypeError), match=r"was compiled|takes Python's numbers"):
        probe(*given)


def test_equal_arguments_of_other_classes_are_converted(
    probe: CompiledFunction, tmp_path: Path
) -> None:
    """Numbers of NumPy, arrays that were pickled, and mapped files share memory with the code."""
    mapped = np.memmap(tmp_path / "numbers", np.float64, "w+", shape=(2, 3))
    pickled = pickle.loads(pickle.dumps(np.zeros(1, RECORD)))
    pair = Pair(pickle.loads(pickle.dumps(np.arange(4.0))), np.int64(7))
    sizes = (np.int64(1), 2)
    given = [pickled, np.float64(0.5), np.int64(3), np.True_, pair, sizes, mapped]
    probe(*arguments())
    assert probe(*given) == 31.5
    assert (pickled["n"], mapped[1, 2]) == (3, 3.0)


def test_read_only_arrays_have_the_code_of_others(probe: CompiledFunction) -> None:
    """One code is shipped for both; the pair is not written."""
    given = arguments()
    probe(*given)
    given[4].array.flags.writeable = False
    assert probe(*given) == 31.5
    assert len(probe._codes) == 1
    assert argument_type(read_only()) == argument_type(np.zeros((2, 3)))


def test_failure_of_compiled_function_raises_error(probe: CompiledFunction) -> None:
    """The status of a function that fails is not ignored."""
    given = arguments()
    given[1] = -1.0
    with pytest.raises(RuntimeError, match="'python_probe' failed"):
        probe(*given)


@pytest.mark.usefixtures("folders")
def test_wrapper_releases_the_gil() -> None:
    """Another thread of Python runs during the call."""
    wait: Any = compiled(python_wait)
    flags = np.zeros(2, np.int64)
    assert wait(flags, 3) is False
    thread = threading.Timer(0.05, lambda: flags.__setitem__(0, 1))
    thread.start()
    assert wait(flags, 10**10) is True
    thread.join()
    assert len(wait._codes) == 1


# --- what wrappers cannot call ----------------------------------------------------------------


@pytest.mark.usefixtures("folders")
def test_bitcode_with_other_parameters_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code would read the arguments of its wrapper as others."""
    monkeypatch.setattr(shipped_code, "STORE", ObjectCache(Path("/proc/nothing")))
    monkeypatch.setitem(call_wrapper._NUMBERS, float, "float")
    copy: Any = compiled(python_probe)
    with pytest.raises(RuntimeError, match="but is passed"):
        copy(*arguments())


@pytest.mark.usefixtures("folders")
def test_python_with_other_objects_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrappers read objects in memory."""
    monkeypatch.setattr(shipped_code, "objects_are_as_expected", lambda: False)
    copy: Any = compiled(python_probe)
    with pytest.raises(UnsupportedOperationError, match='engine="pinocchio"'):
        copy(*arguments())


@pytest.mark.parametrize("name", ["_DATA", "_NDIM", "_DIMS", "_STRIDES", "_DTYPE", "_FLAGS"])
def test_other_structure_of_arrays_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrappers read arrays by the offsets of their fields."""
    assert objects_are_as_expected()
    objects_are_as_expected.cache_clear()
    monkeypatch.setattr(call_wrapper, name, getattr(call_wrapper, name) + 8)
    assert not objects_are_as_expected()
    objects_are_as_expected.cache_clear()


# --- names of types ---------------------------------------------------------------------------


def test_types_have_distinct_names() -> None:
    """Code is found by the names of the types of its arguments."""
    values: list[Any] = [
        1, 2.0, True, (1, 2), (1, 2.0), (1, (2, 3)), Pair(np.zeros(2), 1), Pair(1, 2),
        Other(1, 2), np.zeros(3), np.zeros((2, 3)), np.zeros((2, 3)).T, np.zeros((4, 4))[::2, ::2],
        np.zeros(2, np.int64), np.zeros(2, bool), np.zeros(2, np.uint8), new_run(),
        np.zeros(1, RECORD), (np.zeros(2), np.zeros(3)), (np.zeros(2), np.zeros(3), np.zeros(3)),
    ]  # fmt: skip
    assert len({str(argument_type(value)) for value in values}) == len(values)
    assert str(argument_type(np.zeros((1, 3)).T)) == "array(float64, 2d, C)"


@pytest.mark.parametrize(
    "value",
    [
        "text", [1.0], (), np.float32(1.0), np.zeros(2, ">f8"), np.zeros(2, complex), 1j,
        None, unaligned(), np.zeros(1, [("t", np.int8), ("n", np.int64)]), np.ma.zeros(2),
        (1, "text"),
    ],
)  # fmt: skip
def test_other_types_have_no_name(value: Any) -> None:
    """Compiled functions do not take them."""
    assert argument_type(plain_value(value)) is None


def test_equal_dtypes_become_identical() -> None:
    """The first dtype of a kind is kept, so that wrappers compare addresses alone."""
    first = plain_value(np.zeros(1, RECORD))
    copy = pickle.loads(pickle.dumps(first))
    assert plain_value(copy).dtype is first.dtype
    assert np.shares_memory(plain_value(copy), copy)


# --- reshaped arrays --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("array", "shape"),
    [
        (np.zeros((4, 6)), (2, 12)), (np.zeros(24), (2, 3, 4)), (np.zeros((1, 24)), (24,)),
        (np.zeros((4, 12))[:, :6], (24,)), (np.zeros((6, 4)).T, (24,)),
    ],
)  # fmt: skip
def test_reshape_code_computes_strides_of_numpy(array: Any, shape: tuple[int, ...]) -> None:
    """Arrays in C order get new strides; others need a copy, which compiled code cannot make."""
    module = llvm.parse_assembly(RESHAPE_CODE)
    code = load_object(create_machine(1).emit_object(module), "numba_attempt_nocopy_reshape")
    numbers = ctypes.c_int64 * 3
    new = numbers()
    function = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_int64, numbers, numbers, ctypes.c_int64, numbers, numbers,
        ctypes.c_int64, ctypes.c_int,
    )(code.address)  # fmt: skip
    given = array.ndim, numbers(*array.shape), numbers(*array.strides)
    done = function(*given, len(shape), numbers(*shape), new, 8, 0)
    assert bool(done) == array.flags.c_contiguous
    if done:
        assert tuple(new[: len(shape)]) == array.reshape(shape).strides

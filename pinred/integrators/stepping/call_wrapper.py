"""LLVM code of functions that Python calls, for functions with numba's calling convention.

A wrapper checks the types of its arguments, reads numbers and arrays from the Python objects, and
calls the function without the GIL.  It needs neither numba nor a C compiler.  NumPy guarantees the
structure of its arrays, because extensions read it too; `objects_are_as_expected` verifies it.

Addresses of objects differ between processes.  A wrapper therefore reads them from a table, the
array that Python passes as the object to which the function is bound.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ...common.machine_code import NativeCode


@dataclass(frozen=True)
class NumberType:
    """The type of a Python number.

    Attributes:
        kind: int, float or bool.
    """

    kind: type

    def __str__(self) -> str:
        return {int: "int64", float: "float64", bool: "bool"}[self.kind]


@dataclass(frozen=True)
class ArrayType:
    """The type of a NumPy array, which may be read-only.

    Attributes:
        dtype: Type of its entries.
        ndim: Number of axes.
        layout: C for contiguous rows, F for contiguous columns, A for others.
    """

    dtype: np.dtype[Any]
    ndim: int
    layout: str

    def __str__(self) -> str:
        return f"array({_entry_name(self.dtype)}, {self.ndim}d, {self.layout})"


@dataclass(frozen=True)
class TupleType:
    """The type of a tuple, or of a named tuple.

    Attributes:
        kind: The class.
        items: Types of the items.
    """

    kind: type
    items: tuple[ArgumentType, ...]

    def __str__(self) -> str:
        if len(set(self.items)) == 1:
            name = "UniTuple" if self.kind is tuple else self.kind.__name__
            return f"{name}({self.items[0]} x {len(self.items)})"
        name = "Tuple" if self.kind is tuple else self.kind.__name__
        return f"{name}({', '.join(map(str, self.items))})"


# The dtypes seen first; copies of them, such as those of unpickled arrays, are other objects.
_DTYPES: dict[Any, np.dtype[Any]] = {np.dtype(kind): np.dtype(kind) for kind in (float, np.int64)}

ArgumentType: TypeAlias = NumberType | ArrayType | TupleType


def argument_type(value: Any) -> ArgumentType | None:
    """Return the type of an argument.

    Args:
        value: The argument.
    Returns:
        The type, or None if compiled functions take no such arguments.
    """
    kind = type(value)
    if kind in (int, float, bool):
        return NumberType(kind)
    if kind is np.ndarray:
        return _array_type(value)
    if kind is tuple or (issubclass(kind, tuple) and hasattr(kind, "_fields")):
        items = tuple(map(argument_type, value))
        known = tuple(item for item in items if item is not None)
        return TupleType(kind, known) if known and len(known) == len(items) else None
    return None


def plain_value(value: Any) -> Any:
    """Return an argument with numbers of Python, and with arrays whose equal dtypes are identical.

    Args:
        value: An argument.
    Returns:
        The argument, or an equal one that shares its memory.
    """
    kind = type(value)
    if kind in (np.float64, np.int64, np.bool_):
        return value.item()
    if kind in (np.ndarray, np.memmap):
        dtype = _DTYPES.setdefault(value.dtype, value.dtype)
        same = dtype is value.dtype and kind is np.ndarray
        return value if same else value.view(dtype, np.ndarray)
    if kind is tuple:
        return tuple(map(plain_value, value))
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return kind(*map(plain_value, value))
    return value


def _array_type(array: Any) -> ArrayType | None:
    flags = array.flags
    if not (flags.aligned and _entry_name(array.dtype)):
        return None
    layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
    return ArrayType(array.dtype, array.ndim, layout)


def _entry_name(dtype: np.dtype[Any]) -> str:
    """Return the name of the type of entries, "" if compiled functions take no such arrays."""
    if dtype.kind in "biuf":  # numbers and truth values
        return str(dtype) if dtype.isnative else ""
    if dtype.fields is None or not dtype.isalignedstruct:
        return ""
    fields = sorted(dtype.fields.items(), key=lambda field: field[1][1])
    if not all(_entry_name(kind) for _, (kind, *_) in fields):
        return ""
    described = (
        f"{name}[type={_entry_name(kind)};offset={offset}]" for name, (kind, offset, *_) in fields
    )
    return f"Record({','.join(described)};{dtype.itemsize};True)"


WRAPPER, COMPILED = "wrapper", "compiled"  # names of the wrapper and of the function that it calls
RESULTS = ("none", "int64", "float64", "bool")

_HEAD = object.__basicsize__  # size of the head of an object, whose last field is its type
# Offsets in a NumPy array.
_DATA, _NDIM, _DIMS, _STRIDES, _DTYPE, _FLAGS = (_HEAD + k for k in (0, 8, 16, 24, 40, 48))
_C, _F, _ALIGNED, _WRITEABLE = 0x1, 0x2, 0x100, 0x400  # NumPy's flags of arrays
_LAYOUTS = {"C": (_C, _C), "F": (_C | _F, _F), "A": (_C | _F, 0)}  # flags to compare, and values
_NONE = -2  # numba's status of functions that return None
_FAST_CALL = 0x80  # METH_FASTCALL of Python

_FUNCTIONS = (
    "PyEval_SaveThread", "PyEval_RestoreThread", "PyLong_AsLongLong", "PyLong_FromLongLong",
    "PyFloat_AsDouble", "PyFloat_FromDouble", "PyBool_FromLong", "PyErr_Occurred", "PyErr_Clear",
    "PyErr_SetString", "PyTuple_Size", "PyTuple_GetItem", "Py_IncRef",
)  # fmt: skip
_NUMBERS = {int: "i64", float: "double", bool: "i8"}


class _Method(ctypes.Structure):
    """PyMethodDef, which describes a function to Python."""

    _fields_ = [
        ("name", ctypes.c_char_p),
        ("address", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    ]


class Bitcode(NamedTuple):
    """Optimised code of a function.

    Attributes:
        result: Name of the type of the result.
        module: LLVM bitcode.
    """

    result: str
    module: bytes


class CallWrapper:
    """The LLVM code of a wrapper, and the objects whose addresses it reads from its table.

    Attributes:
        parameters: LLVM types of the parameters of the function that it calls.
        text: The LLVM code.
    """

    def __init__(self, name: str, arguments: Sequence[ArgumentType], result: str) -> None:
        """Write the code of a wrapper.

        Args:
            name: Name of the function, for messages.
            arguments: Types of its arguments.
            result: Name of the type of its result, one of RESULTS.
        """
        message = f"the compiled function '{name}' failed".encode()
        self._message = ctypes.create_string_buffer(message)  # the table contains its address
        self._objects: list[Any] = []
        self._lines: list[str] = []
        self._count = 0
        self._table = self._load("ptr", "%self", _DATA)
        self._out, self._error = (self._add("alloca i64") for _ in range(2))
        values: list[tuple[str, str]] = []
        self._check(f"icmp eq i64 %count, {len(arguments)}")
        for k, argument in enumerate(arguments):
            values += self._values(self._load("ptr", "%arguments", 8 * k), argument)
        self.parameters = ["ptr", "ptr", *(kind for kind, _ in values)]
        self._call(values, result)
        body = "\n  ".join(self._lines)
        self.text = (
            f"declare i32 @{COMPILED}({', '.join(self.parameters)})\n"
            f"define ptr @{WRAPPER}(ptr %self, ptr %arguments, i64 %count) {{\nentry:\n  {body}\n}}"
        )

    def bind(self, code: NativeCode) -> Callable[..., Any]:
        """Return the Python function of a wrapper in memory, which stays in memory.

        Args:
            code: The machine code of the wrapper.
        Returns:
            The function; it returns NotImplemented for arguments of other types.
        """
        functions = [
            ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value
            for name in _FUNCTIONS
        ]
        numbers = [*functions, ctypes.addressof(self._message), *map(id, self._objects)]
        table = np.array(numbers, dtype=np.uint64)
        method = _Method(WRAPPER.encode(), code.address, _FAST_CALL, None)
        _KEPT.append((self, code, method))
        function: Callable[..., Any] = _new_function(ctypes.byref(method), table, None)
        return function

    # --- instructions ----------------------------------------------------------------------

    def _add(self, instruction: str) -> str:
        self._count += 1
        self._lines.append(f"%v{self._count} = {instruction}")
        return f"%v{self._count}"

    def _load(self, kind: str, pointer: str, offset: int) -> str:
        return self._add(f"load {kind}, ptr {self._at(pointer, offset)}")

    def _at(self, pointer: str, offset: int) -> str:
        return self._add(f"getelementptr i8, ptr {pointer}, i64 {offset}")

    def _entry(self, index: int) -> str:
        """Return an entry of the table."""
        return self._load("ptr", self._table, 8 * index)

    def _object(self, value: Any) -> str:
        """Return the address of a Python object."""
        self._objects.append(value)
        return self._entry(len(_FUNCTIONS) + len(self._objects))

    def _python(self, name: str, result: str, *arguments: str) -> str:
        """Call a function of Python, and return its result."""
        function = self._entry(_FUNCTIONS.index(name))
        call = f"call {result} {function}({', '.join(arguments)})"
        if result != "void":
            return self._add(call)
        self._lines.append(call)
        return ""

    def _check(self, condition: str) -> None:
        """Leave the wrapper unless a condition holds."""
        checked = self._add(condition)
        self._lines += [f"br i1 {checked}, label %next{checked[1:]}, label %other"]
        self._lines += [f"next{checked[1:]}:"]

    # --- arguments -------------------------------------------------------------------------

    def _values(self, value: str, argument: ArgumentType) -> list[tuple[str, str]]:
        """Return types and values of the parameters that an argument becomes."""
        if isinstance(argument, NumberType):
            return [(_NUMBERS[argument.kind], self._number(value, argument.kind))]
        kind = np.ndarray if isinstance(argument, ArrayType) else argument.kind
        self._check_kind(value, kind)
        if isinstance(argument, ArrayType):
            return self._array(value, argument)
        size = self._python("PyTuple_Size", "i64", f"ptr {value}")
        self._check(f"icmp eq i64 {size}, {len(argument.items)}")
        values: list[tuple[str, str]] = []
        for k, item in enumerate(argument.items):
            values += self._values(
                self._python("PyTuple_GetItem", "ptr", f"ptr {value}", f"i64 {k}"), item
            )
        return values

    def _check_kind(self, value: str, kind: type) -> None:
        self._check(f"icmp eq ptr {self._load('ptr', value, _HEAD - 8)}, {self._object(kind)}")

    def _number(self, value: str, kind: type) -> str:
        self._check_kind(value, kind)
        if kind is float:
            return self._python("PyFloat_AsDouble", "double", f"ptr {value}")
        if kind is bool:
            truth = self._add(f"icmp eq ptr {value}, {self._object(True)}")
            return self._add(f"zext i1 {truth} to i8")
        number = self._python("PyLong_AsLongLong", "i64", f"ptr {value}")
        error = self._python("PyErr_Occurred", "ptr")
        self._check(f"icmp eq ptr {error}, null")
        return number

    def _array(self, value: str, argument: ArrayType) -> list[tuple[str, str]]:
        self._check(f"icmp eq i32 {self._load('i32', value, _NDIM)}, {argument.ndim}")
        dtype = self._load("ptr", value, _DTYPE)
        self._check(f"icmp eq ptr {dtype}, {self._object(argument.dtype)}")
        compared, expected = _LAYOUTS[argument.layout]
        flags = self._load("i32", value, _FLAGS)
        masked = self._add(f"and i32 {flags}, {compared | _ALIGNED}")
        self._check(f"icmp eq i32 {masked}, {expected | _ALIGNED}")
        data = self._load("ptr", value, _DATA)
        dims, strides = (self._load("ptr", value, offset) for offset in (_DIMS, _STRIDES))
        shape = [self._load("i64", dims, 8 * k) for k in range(argument.ndim)]
        steps = [self._load("i64", strides, 8 * k) for k in range(argument.ndim)]
        size = "1"
        for length in shape:
            size = self._add(f"mul i64 {size}, {length}")
        itemsize = str(argument.dtype.itemsize)
        # Memory that numba manages, the Python object, size, bytes of an entry, data, and axes.
        return [
            ("ptr", "null"), ("ptr", "null"), ("i64", size), ("i64", itemsize), ("ptr", data),
            *(("i64", number) for number in (*shape, *steps)),
        ]  # fmt: skip

    # --- the call --------------------------------------------------------------------------

    def _call(self, values: list[tuple[str, str]], result: str) -> None:
        """Call the function; return its result, an error, or NotImplemented for other types."""
        state = self._python("PyEval_SaveThread", "ptr")
        given = ", ".join(f"{kind} {value}" for kind, value in values)
        status = self._add(f"call i32 @{COMPILED}(ptr {self._out}, ptr {self._error}, {given})")
        self._python("PyEval_RestoreThread", "void", f"ptr {state}")
        fine = self._add(f"icmp eq i32 {status}, 0")
        none = self._add(f"icmp eq i32 {status}, {_NONE}")
        either = self._add(f"or i1 {fine}, {none}")
        self._lines += [f"br i1 {either}, label %done, label %failed", "done:"]
        self._return(self._result(result))
        self._lines += ["failed:"]
        message = self._entry(len(_FUNCTIONS))
        kind = self._object(RuntimeError)
        self._python("PyErr_SetString", "void", f"ptr {kind}", f"ptr {message}")
        self._return("null")
        self._lines += ["other:"]
        self._python("PyErr_Clear", "void")
        self._return(self._new_reference(NotImplemented))

    def _result(self, result: str) -> str:
        out = self._out
        if result == "int64":
            return self._python("PyLong_FromLongLong", "ptr", f"i64 {self._load('i64', out, 0)}")
        if result == "float64":
            value = self._load("double", out, 0)
            return self._python("PyFloat_FromDouble", "ptr", f"double {value}")
        if result == "bool":
            value = self._add(f"zext i8 {self._load('i8', out, 0)} to i64")
            return self._python("PyBool_FromLong", "ptr", f"i64 {value}")
        return self._new_reference(None)

    def _new_reference(self, value: Any) -> str:
        address = self._object(value)
        self._python("Py_IncRef", "void", f"ptr {address}")
        return address

    def _return(self, value: str) -> None:
        self._lines.append(f"ret ptr {value}")


_KEPT: list[Any] = []  # what functions in memory refer to; they are never deleted
_new_function: Callable[..., Any] = ctypes.PYFUNCTYPE(
    ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p
)(("PyCFunction_NewEx", ctypes.pythonapi))


@cache
def objects_are_as_expected() -> bool:
    """Return whether Python objects and NumPy arrays have the structure that wrappers read."""
    if sys.implementation.name != "cpython" or ctypes.sizeof(ctypes.c_void_p) != 8:
        return False
    array = np.zeros((3, 5))[:, :2]
    array.flags.writeable = False

    def word(offset: int, kind: Any = ctypes.c_int64, address: int = id(array)) -> int:
        value: int = kind.from_address(address + offset).value
        return value

    read = (
        word(_HEAD - 8), word(_DATA), word(_NDIM, ctypes.c_int32), word(_DTYPE),
        word(_FLAGS, ctypes.c_int32) & (_C | _F | _ALIGNED | _WRITEABLE),
        *(word(8 * k, address=word(where)) for where in (_DIMS, _STRIDES) for k in range(2)),
    )  # fmt: skip
    return read == (
        id(np.ndarray), array.ctypes.data, 2, id(array.dtype), _ALIGNED, *array.shape,
        *array.strides,
    )  # fmt: skip

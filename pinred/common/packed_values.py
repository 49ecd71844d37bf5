"""Nested values as JSON text and binary buffers.

Values are None, booleans, numbers, texts, bytes, arrays, and lists and dictionaries of them.
Floats and arrays keep all bits. Lists of similar values become columns, so that long lists are
small. Reading executes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .errors import InputError


def pack(value: Any) -> tuple[Any, list[bytes | memoryview]]:
    """Return a value as data for JSON, and the buffers to which the data refers.

    Args:
        value: The value.
    Returns:
        Data and buffers, as `unpack` expects them.
    """
    buffers: list[bytes | memoryview] = []
    return _pack(value, buffers), buffers


def unpack(data: Any, buffers: Sequence[bytes | memoryview]) -> Any:
    """Return the value of data and buffers that `pack` returned; arrays are writable copies."""
    if not isinstance(data, dict):
        return data
    ((form, content),) = data.items()
    match form:
        case "bytes":
            return bytes(buffers[content])
        case "array":
            dtype, shape, k = content
            return np.frombuffer(bytearray(buffers[k]), dtype).reshape(shape)
        case "dict":
            return {key: unpack(entry, buffers) for key, entry in content.items()}
        case "list":
            return [unpack(entry, buffers) for entry in content]
        case "floats":
            return unpack(content, buffers).tolist()
        case "arrays":
            shapes, flat = (unpack(entry, buffers) for entry in content)
            ends = np.cumsum(shapes.prod(axis=1))
            pieces = np.split(flat, ends[:-1])
            return [piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True)]
        case "columns":
            columns = {key: unpack(entry, buffers) for key, entry in content.items()}
            return [
                dict(zip(columns, entries, strict=True))
                for entries in zip(*columns.values(), strict=True)
            ]
    raise InputError(f"expected a kind of packed values, got {form!r}")


def _pack(value: Any, buffers: list[bytes | memoryview]) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, bytes):
        buffers.append(value)
        return {"bytes": len(buffers) - 1}
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        buffers.append(array.reshape(-1).view(np.uint8).data)
        return {"array": [array.dtype.str, list(value.shape), len(buffers) - 1]}
    if isinstance(value, Mapping):
        return {"dict": {key: _pack(entry, buffers) for key, entry in value.items()}}
    return _pack_list(list(value), buffers)


def _pack_list(values: list[Any], buffers: list[bytes | memoryview]) -> Any:
    """Return a list as data, in columns if its entries are of one kind."""
    kinds = {type(value) for value in values}
    if kinds == {float}:
        return {"floats": _pack(np.array(values), buffers)}
    if kinds == {np.ndarray} and len({(array.dtype, array.ndim) for array in values}) == 1:
        shapes = np.array([array.shape for array in values], dtype=np.int64)
        flat = np.concatenate([array.reshape(-1) for array in values])
        return {"arrays": [_pack(shapes, buffers), _pack(flat, buffers)]}
    if kinds == {dict} and values[0] and len({tuple(value) for value in values}) == 1:
        columns = {key: [value[key] for value in values] for key in values[0]}
        return {"columns": {key: _pack_list(column, buffers) for key, column in columns.items()}}
    return {"list": [_pack(value, buffers) for value in values]}

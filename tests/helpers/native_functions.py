"""Compiled CasADi Functions that a test calls with arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import casadi as ca
import numpy as np

from pinred.common.arrays import Array
from pinred.kernels.machine.native import NativeCode, compile_object, load_object

POINTER = ctypes.POINTER(ctypes.c_double)


def callable_of(code: NativeCode, inputs: int, size: int) -> Callable[..., Array]:
    """Return a function of `inputs` arrays that gives `size` numbers.  It keeps `code`."""
    raw = ctypes.CFUNCTYPE(None, *[POINTER] * (inputs + 1))(code.address)

    def call(*arguments: Array) -> Array:
        assert code.address
        arrays = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        out = np.full(size + 1, 1234.5)
        raw(*(a.ctypes.data_as(POINTER) for a in (*arrays, out)))
        assert out[-1] == 1234.5
        return out[:-1]

    return call


def build(*outputs: ca.SX, inputs: list[ca.SX]) -> tuple[Callable[..., Array], ca.Function]:
    """Compile a function, and return it with CasADi's."""
    function = ca.Function("f", inputs, [ca.densify(ca.vertcat(*outputs))])
    code = load_object(compile_object(function, "f"), "f")
    return callable_of(code, len(inputs), function.numel_out(0)), function

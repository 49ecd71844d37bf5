"""Compiled CasADi functions that tests call with arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import casadi as ca
import numpy as np

from pinred.common.arrays import Array
from pinred.common.machine_code import NativeCode, load_object
from pinred.kernels.machine.native import compile_object

POINTER = ctypes.POINTER(ctypes.c_double)


def callable_of(code: NativeCode, inputs: int, size: int) -> Callable[..., Array]:
    """Return a Python function for compiled code with `inputs` inputs and `size` outputs.

    The function keeps the code in memory.
    """
    raw = ctypes.CFUNCTYPE(None, *[POINTER] * (inputs + 1))(code.address)

    def call(*arguments: Array) -> Array:
        assert code.address
        arrays = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        outputs = np.full(size + 1, 1234.5)
        raw(*(a.ctypes.data_as(POINTER) for a in (*arrays, outputs)))
        assert outputs[-1] == 1234.5
        return outputs[:-1]

    return call


def build(*outputs: ca.SX, inputs: list[ca.SX]) -> tuple[Callable[..., Array], ca.Function]:
    """Compile CasADi expressions; return the compiled function and the CasADi function."""
    function = ca.Function("f", inputs, [ca.densify(ca.vertcat(*outputs))])
    code = load_object(compile_object(function, "f"), "f")
    return callable_of(code, len(inputs), function.numel_out(0)), function

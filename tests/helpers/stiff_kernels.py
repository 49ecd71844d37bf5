"""Compile vector fields with derivatives for tests of integrators."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from typing import Any

import casadi as ca
import numba
from numba import types

from pinred.common.machine_code import load_object
from pinred.kernels.machine.native import compile_object

Field = Callable[..., None]  # f(y, p, d) or, along tangent directions, f(y, p, v, d)
_NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
_MOST = 64  # largest number of entries of an argument

_alive: list[Any] = []  # keeps compiled functions from being freed


def kernel(field: Field) -> int:
    """Compile a vector field, or its derivative, and return its address.

    CasADi traces the function.  It therefore has no conditions, writes no parameters, and has no
    products with zero, which would vanish.
    """
    *names, _ = signature(field).parameters
    inputs = [ca.SX.sym(name, _MOST) for name in names]
    rates: dict[int, ca.SX] = {}
    field(*(ca.vertsplit(column) for column in inputs), rates)
    column = ca.densify(ca.vertcat(*(rates[k] for k in range(len(rates)))))
    graph = ca.Function("field", inputs, [column], {"cse": True})
    code = load_object(compile_object(graph, "field"), "field")
    _alive.append(code)
    return code.address


def kernel_by_numba(field: Field) -> int:
    """Compile a function as it is written, which takes a third of a second."""
    arguments = len(signature(field).parameters)
    compiled: Any = numba.cfunc(types.void(*[_NUMBERS] * arguments))(field)
    _alive.append(compiled)
    return int(compiled.address)


def kernels(
    rate: Field, slope: Field, compile_field: Callable[[Field], int] = kernel
) -> tuple[int, Callable[[], int]]:
    """Compile a vector field and its derivative along eight tangent directions.

    Returns the address of the field, and a function that returns the address of the derivative.
    """
    addresses = compile_field(rate), compile_field(slope)
    return addresses[0], lambda: addresses[1]

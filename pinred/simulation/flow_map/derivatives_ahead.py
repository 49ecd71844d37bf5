"""Machine code of a flow's derivatives that other threads generate while the flow is integrated."""

from __future__ import annotations

import numpy as np

from ...integrators.methods import Explicit
from ...kernels.derived_code import expect_code
from ...kernels.differentiable import _call_in_batches
from ...kernels.flow_functions import Row, outcome_of
from ..compiled.code_ahead import expect, expect_cotangents, expect_tangents
from .propagator import Propagator


def expect_along(propagator: Propagator, rows: tuple[Row, ...], count: int) -> None:
    """Let other threads generate the machine code of Propagator.along.

    Args:
        propagator: The propagator.
        rows: Names of the outputs.
        count: Number of directions.
    """
    field, method = propagator.field, propagator.method
    outcome = outcome_of(propagator.kernel, rows)
    expect_tangents(method, count)
    column, matrix = np.empty(1), np.empty((1, 1))
    expect(_call_in_batches, 1, column, column, *[matrix] * 6)
    if isinstance(method, Explicit):
        expect_code(field.pair if count == 1 else field.tangent)
    else:
        expect_code(lambda: field.tangents(method.lanes))
    propagator.initial.expect_along()
    expect_code(lambda: outcome.value)
    expect_code(lambda: outcome.tangent)


def expect_back(propagator: Propagator, rows: tuple[Row, ...]) -> None:
    """Let other threads generate the machine code of Propagator.back.

    Args:
        propagator: The propagator.
        rows: Names of the outputs.
    """
    field, method = propagator.field, propagator.method
    outcome = outcome_of(propagator.kernel, rows)
    expect_cotangents(method)
    expect_code(lambda: outcome.value)
    expect_code(lambda: outcome.adjoint)
    if isinstance(method, Explicit):
        expect_code(field.adjoint)
    else:
        expect_code(lambda: field.adjoints(method.lanes))
    propagator.initial.expect_back()

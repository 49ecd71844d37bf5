"""Evaluation of CasADi Functions in fixed arrays."""

from __future__ import annotations

import gc

import casadi as ca
import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.forces.force_numbers import FunctionBuffers, Numeric


def matrix_function() -> ca.Function:
    """Return (t, x, p) → (t x pᵀ, no rows, x + 1) for x (3,) and p (2,)."""
    t, x, p = ca.SX.sym("t"), ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    outputs = [t * x @ p.T, ca.SX(0, 1), x + 1.0]
    return ca.Function("matrix", [t, x, p], [ca.densify(output) for output in outputs])


def test_function_lives_as_long_as_its_buffers() -> None:
    """CasADi's buffers do not keep their Function alive."""
    buffers = FunctionBuffers(matrix_function())
    gc.collect()
    values = [2.0], [1.0, 2.0, 3.0], [1.0, 10.0]
    for array, value in zip(buffers.inputs, values, strict=True):
        array[:] = value
    buffers.run()
    expected = [[2.0, 20.0], [4.0, 40.0], [6.0, 60.0]]
    assert [output.tolist() for output in buffers.outputs] == [expected, [], [[2.0], [3.0], [4.0]]]


def test_buffers_read_a_shared_array() -> None:
    """An array that belongs to another object is read at each run."""
    x = np.zeros(3)
    buffers = FunctionBuffers(matrix_function(), {1: x})
    x[:] = 4.0, 5.0, 6.0
    buffers.run()
    assert buffers.outputs[2][:, 0].tolist() == [5.0, 6.0, 7.0]


@pytest.mark.by_hand("255")
@pytest.mark.parametrize("count", [1, 255, 256, 700])
def test_evaluation_at_all_arguments_equals_single_evaluations(count: int) -> None:
    """Also for arguments that all evaluations share, and across several runs."""
    rng, function = np.random.default_rng(0), Numeric(matrix_function())
    t, x, p = rng.normal(size=(count, 1)), rng.normal(size=(count, 3)), rng.normal(size=2)
    results = function.at_all(t, x, p)
    for k in range(count):
        for result, expected in zip(results, function(t[k], x[k], p), strict=True):
            np.testing.assert_array_equal(result[k], expected)


def test_results_of_a_call_are_copies() -> None:
    """A later call must not change earlier results."""
    function, p = Numeric(matrix_function()), np.ones(2)
    first: Array = function(1.0, np.ones(3), p)[0]
    function(2.0, np.ones(3), p)
    assert (first == 1.0).all()

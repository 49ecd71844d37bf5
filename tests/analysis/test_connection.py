"""Connection.mechanical by machine code against Pinocchio's reduction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from assertions import close
from hypothesis import given, settings
from strategies import Case, cases

import pinred
from pinred.kernels.connection.connection_validation import trial_shapes


@settings(max_examples=4)
@given(case=cases(most=4))
def test_mechanical_connection_equals_reduction(case: Case) -> None:
    """A, M, B and −A ẋ against Pinocchio's CRBA and RNEA derivatives."""
    A, at = pinred.Connection.mechanical(case.system), pinred.Reduction(case.system).at(case.x)
    size = 1.0 + float(np.abs(at.curvature).max(initial=0.0))
    close(A.local(case.x), at.local_connection, 1e-11 * size)
    close(A.metric(case.x), at.reduced_metric, 1e-11 * size)
    close(A.curvature(case.x), at.curvature, 1e-10 * size)
    close(A.locked(case.x), at.locked_inertia, 1e-12 * size)
    close(A.velocity(case.x, case.xdot), -at.local_connection @ case.xdot, 1e-11 * size)


def test_grid_equals_single_shapes() -> None:
    """Leading axes come first, and both terms of the curvature add up."""
    system = pinred.load("falling_cat")
    A, red = pinred.Connection.mechanical(system), pinred.Reduction(system)
    shapes = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 4, system.m))
    field = A.grid(shapes)
    assert field.local.shape == (3, 4, 6, 3)
    at = red.at(shapes[2, 1])
    close(field.local[2, 1], at.local_connection, 1e-14)
    close(field.metric[2, 1], at.reduced_metric, 1e-14)
    close(field.curvature[2, 1], at.curvature, 1e-13)
    close(field.exterior[2, 1], np.swapaxes(at.dA, 1, 2) - at.dA, 1e-13)


@pytest.mark.parametrize("name", ["falling_cat", "three_rods"])
def test_horizontal_slopes_equal_derivatives_of_reduction(name: str) -> None:
    """The derivatives of ξ and ẋᵀ M ẋ by x and ẋ, from Pinocchio's exact dA and dM."""
    system = pinred.load(name)
    rng = np.random.default_rng(4)
    x, xdot = rng.uniform(-1.0, 1.0, system.m), rng.normal(size=system.m)
    at = pinred.Reduction(system).at(x)
    (found,) = pinred.Connection.mechanical(system).horizontal_slopes(x[None], xdot[None])
    r, m = system.r, system.m
    close(found[:r, :m], -np.einsum("iba,b->ia", at.dA, xdot), 1e-13)
    close(found[:r, m:], -at.local_connection, 1e-13)
    close(found[r, :m], np.einsum("bca,b,c->a", at.dM, xdot, xdot), 1e-13)
    close(found[r, m:], 2.0 * at.reduced_metric @ xdot, 1e-13)


def test_locked_derivatives_equal_derivatives_of_locked_inertia() -> None:
    """∂(I ω)/∂x at constant ω, from Pinocchio's exact dI."""
    system = pinred.load("falling_cat")
    rng = np.random.default_rng(5)
    x, omega = rng.uniform(-1.0, 1.0, (2, system.m)), rng.normal(size=(2, system.r))
    values = pinred.Connection.mechanical(system).code.locked_derivatives(x, omega)
    for k in range(2):
        dI = pinred.Reduction(system).at(x[k]).dI
        close(values[k], np.einsum("ijc,j->ic", dI, omega[k]), 1e-13)


@pytest.mark.parametrize(
    ("what", "call"),
    [
        ("A", lambda A, x: A.local(x)),
        ("velocity", lambda A, x: A.velocity(x, x)),
        ("curvature", lambda A, x: A.curvature(x)),
        ("slope", lambda A, x: A.horizontal_slopes(x[None], x[None])),
        ("P_b", lambda A, x: A.code.locked_derivatives(x[None], np.ones((1, 3)))),
    ],
)
def test_code_that_disagrees_with_reference_raises(what: str, call: object) -> None:
    """A reference that differs by 1e-4 in two entries is detected for each function."""
    system = pinred.load("three_rods")
    own = pinred.Connection.mechanical(system).form

    def wrong(x: np.ndarray) -> np.ndarray:
        G = own.reference(x).copy()
        G[2, 3] *= 1.0 + 1e-4 * (1.0 + np.sin(x[0]))
        G[3, 2] = G[2, 3]
        G[2, 2] *= 1.0 + 1e-4 * (1.0 + np.sin(x[0]))
        return G

    form = replace(own, reference=wrong)
    with pytest.raises(pinred.KernelMismatch, match=what):
        call(pinred.Connection.of(form), np.array([0.3, 0.4]))  # type: ignore[operator]


def test_trial_shapes_exist() -> None:
    """Validation without trial shapes would accept everything."""
    form = pinred.Connection.mechanical(pinred.load("falling_cat")).form
    assert len(list(trial_shapes(form))) == 2


def test_invalid_shapes_raise_and_name_joints() -> None:
    """By name, with the joints."""
    A = pinred.Connection.mechanical(pinred.load("three_rods"))
    with pytest.raises(pinred.ShapeError, match="alpha1, alpha2"):
        A.local([1.0, 2.0, 3.0])
    with pytest.raises(pinred.ShapeError, match="must be finite"):
        A.grid([[np.nan, 0.0]])
    with pytest.raises(pinred.InputError, match="differ in shape"):
        A.velocity(np.zeros((2, 2)), np.zeros(2))

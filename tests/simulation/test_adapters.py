"""A flow in other people's languages: values and derivatives are the flow's own."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from kicked_cat import AT, BATCH, flow_of

import pinred
from pinred import InputError, IntegrationError, ShapeError
from pinred.forces import Torque
from pinred.signals import Hold


@pytest.mark.parametrize("times", [None, [0.1, 0.3]])
def test_columns(times: Any) -> None:
    """Values of poses are their coordinates; differences and both modes agree."""
    columns = flow_of(times=times, rtol=1e-12).columns()
    jacobian = columns.jacobian(*AT)
    rng = np.random.default_rng(0)
    along = [rng.normal(size=size) for size in columns.sizes]
    forward = columns.jvp(AT, along)
    np.testing.assert_allclose(
        forward, sum(J @ v for J, v in zip(jacobian, along, strict=True)), atol=1e-12
    )
    low, high = (
        columns.value(*(a + s * 1e-4 * v for a, v in zip(AT, along, strict=True))) for s in (-1, 1)
    )
    np.testing.assert_allclose((high - low) / 2e-4, forward, atol=1e-5 * np.abs(forward).max())
    covector = rng.normal(size=columns.size)
    for found, J in zip(columns.vjp(AT, covector), jacobian, strict=True):
        np.testing.assert_allclose(found, covector @ J, atol=1e-11)


def test_many_columns() -> None:
    """Many in lanes are each by itself; of a batch, rows of one stand for all."""
    for options in ({}, {"times": [0.0, 0.1, 0.3]}, {"method": "AdaptiveGauss"}):
        columns = flow_of(rtol=1e-10, **options).columns()
        found = columns.values(BATCH, AT[1][None], AT[2][None])
        assert found.shape == (len(BATCH), columns.size)
        for row, x in zip(found, BATCH, strict=True):
            np.testing.assert_allclose(row, columns.value(x, *AT[1:]), rtol=1e-11, atol=1e-12)
    assert columns.values(BATCH[:0], AT[1][None], AT[2][None]).shape == (0, columns.size)
    with pytest.raises(ShapeError, match=r"equally many rows, or one, got \[2, 5\]"):
        columns.values(BATCH, np.ones((2, 1)), AT[2][None])
    with pytest.raises(ShapeError, match=r"inputs of many runs must have shape \(N, size\)"):
        columns.values(AT[0], AT[1][None], AT[2][None])


def test_many_columns_over_stops() -> None:
    """Tables with breaks, whose pieces lie between stops."""
    hold = Hold([0.0, 0.1, 0.2], [0.0, 1.0, -1.0])
    columns = flow_of(forces=[Torque({"bend": hold})], wrt=["x0"], times=[0.05, 0.3]).columns()
    found = columns.values(BATCH)
    for row, x in zip(found, BATCH, strict=True):
        np.testing.assert_allclose(row, columns.value(x), rtol=1e-9, atol=1e-10)


def test_a_member_that_fails() -> None:
    """It is named, with time and reason."""
    columns = flow_of(wrt=["xdot0"], method="Gauss(0.1)").columns()
    rates = np.zeros((3, 3))
    rates[1] = 1e5
    with pytest.raises(IntegrationError, match="member 1 of 3 stopped at t = "):
        columns.values(rates)


def test_directions_and_covectors_together() -> None:
    """Rows of directions and covectors give the rows of each."""
    columns = flow_of().columns()
    rng = np.random.default_rng(0)
    along = [rng.normal(size=(11, size)) for size in columns.sizes]
    for row, found in enumerate(columns.jvp(AT, along)):
        one = columns.jvp(AT, [each[row] for each in along])
        np.testing.assert_allclose(found, one, atol=1e-13)
    covectors = rng.normal(size=(3, columns.size))
    for found, name_of in zip(columns.vjp(AT, covectors), range(3), strict=True):
        for row in range(3):
            np.testing.assert_allclose(
                found[row], columns.vjp(AT, covectors[row])[name_of], atol=1e-13
            )


def test_casadi_both_ways() -> None:
    """Derivatives along directions and back, several at once, without the Jacobian."""
    flow = flow_of()
    callback, columns = flow.casadi(), flow.columns()
    J = np.hstack(columns.jacobian(*AT))
    rng = np.random.default_rng(0)
    forward, reverse = callback.forward(2), callback.reverse(3)
    y = columns.value(*AT)
    seeds = [rng.normal(size=(size, 2)) for size in columns.sizes]
    np.testing.assert_allclose(np.array(forward(*AT, y, *seeds)), J @ np.vstack(seeds), atol=1e-12)
    covectors = rng.normal(size=(columns.size, 3))
    found = np.vstack([np.array(each) for each in reverse(*AT, y, covectors)])
    np.testing.assert_allclose(found, J.T @ covectors, atol=1e-12)


def test_casadi_gradient_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gradient of a scalar costs one vjp, and no Jacobian."""
    flow = flow_of()
    callback = flow.casadi()
    x = ca.MX.sym("x", 3)
    gradient = ca.Function("g", [x], [ca.gradient(ca.sumsqr(callback(x, *AT[1:])), x)])
    columns = callback.columns
    expected = columns.vjp(AT, 2.0 * columns.value(*AT))[0]
    calls: list[Any] = []
    monkeypatch.setattr(columns, "jacobian", calls.append)
    np.testing.assert_allclose(np.array(gradient(AT[0]))[:, 0], expected, atol=1e-12)
    assert not calls


def test_casadi() -> None:
    """A Callback gives the flow and its Jacobian, also to what CasADi makes of it."""
    flow = flow_of()
    callback, columns = flow.casadi(), flow.columns()
    symbols = [ca.MX.sym(name, size) for name, size in zip("abc", columns.sizes, strict=True)]
    out = callback(*symbols)
    whole = ca.Function("whole", symbols, [out, ca.jacobian(out, ca.vertcat(*symbols))])
    value, slopes = whole(*AT)
    np.testing.assert_array_equal(np.array(value)[:, 0], columns.value(*AT))
    np.testing.assert_allclose(np.array(slopes), np.hstack(columns.jacobian(*AT)), atol=1e-14)


@pytest.mark.slow
def test_ipopt_finds_the_kick() -> None:
    """IPOPT finds the torque that brings a joint where it is wanted."""
    flow = flow_of(wrt=["kick"], of=["x"], rtol=1e-10)
    callback, kick = flow.casadi(), ca.MX.sym("kick")
    end = callback(kick)
    wanted = flow.columns().value(0.77)
    options: Any = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.hessian_approximation": "limited-memory",
    }
    problem: Any = {"x": kick, "f": ca.sumsqr(end - wanted)}
    solver = ca.nlpsol("solver", "ipopt", problem, options)
    found = solver(x0=0.1)
    assert float(found["x"]) == pytest.approx(0.77, abs=1e-4)


def test_refusals() -> None:
    """What is no function between vectors is refused, and so are packages that are not there."""
    with pytest.raises(InputError, match="pose0 is an element of a group"):
        flow_of(wrt=["pose0"]).columns()
    with pytest.raises(InputError, match="no inputs with derivatives"):
        flow_of(wrt=[]).columns()
    for package, method in (("jax", flow_of().jax), ("torch", flow_of().torch)):
        try:
            __import__(package)
        except ImportError:
            with pytest.raises(pinred.MissingPackageError, match=f"pip install {package}"):
                method()

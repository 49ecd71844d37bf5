"""A flow as functions of vectors and of CasADi: values and derivatives are those of the flow."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from perturbed_cat import AT, BATCH, flow_of

import pinred
from pinred import InputError, IntegrationError, ShapeError
from pinred.forces import Torque
from pinred.signals import Hold


@pytest.mark.parametrize("times", [None, [0.1, 0.3]])
@pytest.mark.sampled
def test_columns_derivatives_agree_with_differences(times: Any) -> None:
    """Poses are given by their coordinates; both modes agree with central differences."""
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
    for derivative, J in zip(columns.vjp(AT, covector), jacobian, strict=True):
        np.testing.assert_allclose(derivative, covector @ J, atol=1e-11)


def test_values_of_batch_agree_with_single_values() -> None:
    """Batches in SIMD lanes agree with single runs, and inputs of length one are shared."""
    for options in ({}, {"times": [0.0, 0.1, 0.3]}, {"method": "AdaptiveGauss"}):
        columns = flow_of(rtol=1e-10, **options).columns()
        outputs = columns.values(BATCH, AT[1][None], AT[2][None])
        assert outputs.shape == (len(BATCH), columns.size)
        for output, x in zip(outputs, BATCH, strict=True):
            np.testing.assert_allclose(output, columns.value(x, *AT[1:]), rtol=1e-11, atol=1e-12)
    assert columns.values(BATCH[:0], AT[1][None], AT[2][None]).shape == (0, columns.size)
    with pytest.raises(ShapeError, match=r"equally many rows, or one, got \[2, 5\]"):
        columns.values(BATCH, np.ones((2, 1)), AT[2][None])
    with pytest.raises(ShapeError, match=r"inputs of many runs must have shape \(N, size\)"):
        columns.values(AT[0], AT[1][None], AT[2][None])


def test_values_of_batch_agree_over_stops() -> None:
    """Batches agree with single runs for tables with breaks."""
    hold = Hold([0.0, 0.1, 0.2], [0.0, 1.0, -1.0])
    columns = flow_of(forces=[Torque({"bend": hold})], wrt=["x0"], times=[0.05, 0.3]).columns()
    outputs = columns.values(BATCH)
    for output, x in zip(outputs, BATCH, strict=True):
        np.testing.assert_allclose(output, columns.value(x), rtol=1e-9, atol=1e-10)


def test_failing_member_is_named() -> None:
    """The message states the member, the time and the reason."""
    columns = flow_of(wrt=["xdot0"], method="Gauss(0.1)").columns()
    rates = np.zeros((3, 3))
    rates[1] = 1e5
    with pytest.raises(IntegrationError, match="member 1 of 3 stopped at t = "):
        columns.values(rates)


def test_batches_of_directions_and_covectors() -> None:
    """Batches of directions and covectors give the same as single ones."""
    columns = flow_of().columns()
    rng = np.random.default_rng(0)
    along = [rng.normal(size=(11, size)) for size in columns.sizes]
    for row, found in enumerate(columns.jvp(AT, along)):
        one = columns.jvp(AT, [direction[row] for direction in along])
        np.testing.assert_allclose(found, one, atol=1e-13)
    covectors = rng.normal(size=(3, columns.size))
    for found, k in zip(columns.vjp(AT, covectors), range(3), strict=True):
        for row in range(3):
            np.testing.assert_allclose(found[row], columns.vjp(AT, covectors[row])[k], atol=1e-13)


def test_casadi_forward_and_reverse() -> None:
    """Several directions and covectors at once agree with the Jacobian."""
    flow = flow_of()
    callback, columns = flow.casadi(), flow.columns()
    J = np.hstack(columns.jacobian(*AT))
    rng = np.random.default_rng(0)
    forward, reverse = callback.forward(2), callback.reverse(3)
    y = columns.value(*AT)
    seeds = [rng.normal(size=(size, 2)) for size in columns.sizes]
    np.testing.assert_allclose(np.array(forward(*AT, y, *seeds)), J @ np.vstack(seeds), atol=1e-12)
    covectors = rng.normal(size=(columns.size, 3))
    result = np.vstack([np.array(part) for part in reverse(*AT, y, covectors)])
    np.testing.assert_allclose(result, J.T @ covectors, atol=1e-12)


def test_casadi_gradient_uses_vjp(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gradient of a scalar needs no Jacobian."""
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


def test_casadi_callback_agrees_with_flow() -> None:
    """A Callback gives the flow and its Jacobian, also inside other Functions."""
    flow = flow_of()
    callback, columns = flow.casadi(), flow.columns()
    symbols = [ca.MX.sym(name, size) for name, size in zip("abc", columns.sizes, strict=True)]
    out = callback(*symbols)
    function = ca.Function("whole", symbols, [out, ca.jacobian(out, ca.vertcat(*symbols))])
    value, slopes = function(*AT)
    np.testing.assert_array_equal(np.array(value)[:, 0], columns.value(*AT))
    np.testing.assert_allclose(np.array(slopes), np.hstack(columns.jacobian(*AT)), atol=1e-14)


# Every run has values and derivatives of the callback, which IPOPT calls.
@pytest.mark.by_hand
@pytest.mark.slow
def test_ipopt_recovers_torque() -> None:
    """IPOPT recovers the torque that moves a joint to a requested position."""
    flow = flow_of(wrt=["kick"], of=["x"], rtol=1e-10)
    callback, torque = flow.casadi(), ca.MX.sym("kick")
    end = callback(torque)
    requested = flow.columns().value(0.77)
    options: Any = {
        "ipopt.print_level": 0,
        "print_time": False,
        "ipopt.hessian_approximation": "limited-memory",
    }
    problem: Any = {"x": torque, "f": ca.sumsqr(end - requested)}
    solver = ca.nlpsol("solver", "ipopt", problem, options)
    solution = solver(x0=0.1)
    assert float(solution["x"]) == pytest.approx(0.77, abs=1e-4)


def test_invalid_columns_are_rejected() -> None:
    """Poses, missing inputs and missing packages are rejected."""
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

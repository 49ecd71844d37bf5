"""Derivatives of many flows at once, on the CPU and in device threads that the CPU executes."""

from __future__ import annotations

import re
from typing import Any

import casadi as ca
import numpy as np
import pytest
from ball_trees import ball_tree
from host_cuda_driver import host_driver
from loop_robots import four_bar

import pinred
from pinred import InputError, IntegrationError, Parameter
from pinred.common.arrays import Array
from pinred.forces import PD, Torque
from pinred.signals import Fourier, Hold
from pinred.simulation.flow_map import propagator
from pinred.simulation.flow_map.flow_columns import Columns

_COUNT = 3  # members of a batch


def _wave(t: ca.SX, *_: object) -> ca.SX:
    return 0.2 * ca.sin(3.0 * t)


def _case(name: str) -> tuple[Columns, list[Array]]:
    """Return a flow and inputs of members; some inputs are common to all."""
    rng, cat = np.random.default_rng(4), pinred.load("falling_cat")
    gain = Parameter("gain", 2.0)
    options: dict[str, Any] = {"seed": 1, "duration": 0.4, "method": "DOP853"}
    x0 = 0.3 * rng.normal(size=(_COUNT, 3))
    if name == "loose":  # so that the lengths of quaternions change during a step
        options |= {"rtol": 1e-4, "duration": 0.8, "times": [0.3, 0.8]}
        columns = pinred.flow(cat, wrt=["x0", "xi0"], **options).columns()
        return columns, [x0, rng.normal(size=(1, 6))]
    if name == "attitude":  # with times at the start, inside steps, and at the end
        options |= {"forces": [PD({"bend": 0.3}, kp=gain, kd=0.2)], "times": [0.0, 0.13, 0.4]}
        columns = pinred.flow(cat, wrt=["x0", "xi0", "gain"], **options).columns()
        gains = rng.uniform(1.0, 3.0, (_COUNT, 1))
        return columns, [x0, rng.normal(size=(1, 6)), gains]
    if name == "mass":  # which the inputs do not depend on linearly
        options |= {"seed": None, "x0": x0[0], "momentum": 0}
        columns = pinred.flow(cat, wrt=["xdot0", "back.mass"], **options).columns()
        return columns, [x0, rng.uniform(1.0, 3.0, (_COUNT, 1))]
    if name == "breaks":  # two spans, and the time as a state
        torque = Torque({"bend": Hold([0.0, 0.2], [0.5, -0.5]), "sway": _wave})
        options |= {"forces": [torque], "times": [0.1, 0.2, 0.3]}
        return pinred.flow(cat, wrt=["x0"], of=["x", "energy"], **options).columns(), [x0]
    if name == "prescribed":  # parameters that decide the initial state
        options |= {"prescribed": {"bend": Fourier(0.1, [gain], [0.1], 2.0)}}
        columns = pinred.flow(cat, wrt=["gain", "x0"], **options).columns()
        return columns, [rng.uniform(1.0, 3.0, (_COUNT, 1)), x0]
    assert name == "balls"
    system = ball_tree(3)
    columns = pinred.flow(system, wrt=["x0"], rtol=1e-10, **options).columns()
    shapes = np.tile(columns.starts[0], (_COUNT, 1))
    return columns, [shapes + 0.1 * rng.normal(size=shapes.shape)]


_CASES = ["attitude", "mass", "breaks", "prescribed", "balls"]


def _rows(batches: list[Array]) -> list[list[Array]]:
    return [[batch[k % len(batch)] for batch in batches] for k in range(_COUNT)]


# Differences judge these Jacobians, too.
@pytest.mark.by_hand("mass", "breaks", "balls", "prescribed")
@pytest.mark.parametrize("name", [*_CASES, "loose"])
def test_jacobians_are_those_of_single_flows(name: str) -> None:
    """Single flows propagate eight directions over stored steps, in other code."""
    columns, batches = _case(name)
    found = columns.jacobians(*batches)
    for k, row in enumerate(_rows(batches)):
        for slopes, expected in zip(found, columns.jacobian(*row), strict=True):
            bound = 1e-12 * np.abs(expected).max()
            np.testing.assert_allclose(slopes[k], expected, rtol=0, atol=bound)


@pytest.mark.by_hand("breaks", "prescribed")
@pytest.mark.parametrize("name", _CASES)
def test_jacobians_agree_with_differences(name: str) -> None:
    """Quaternions of balls may have any length, so that all entries of inputs can change."""
    columns, batches = _case(name)
    rng, h = np.random.default_rng(9), 1e-4
    along = [rng.normal(size=batch.shape) for batch in batches]
    found = columns.jacobians(*batches)
    sums = [
        np.einsum("nsk,nk->ns", slopes, np.broadcast_to(v, (_COUNT, v.shape[1])))
        for slopes, v in zip(found, along, strict=True)
    ]
    low, high = (
        columns.values(*(b + s * h * v for b, v in zip(batches, along, strict=True)))
        for s in (-1, 1)
    )
    expected = (high - low) / (2.0 * h)
    np.testing.assert_allclose(sum(sums), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


# The other cases have several times, time as a state and parameters of the initial state.
@pytest.mark.by_hand("attitude", "mass", "balls", "prescribed")
@pytest.mark.parametrize("name", _CASES)
def test_jacobians_on_a_device_are_those_of_the_cpu(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each direction of each member is a thread."""
    driver = host_driver(monkeypatch)
    columns, batches = _case(name)
    expected = columns.jacobians(*batches)
    found = columns.jacobians(*batches, device="cuda")
    assert sum(count for _, count in driver.launched) % (_COUNT * sum(columns.sizes)) == 0
    for slopes, cpu in zip(found, expected, strict=True):
        np.testing.assert_allclose(slopes, cpu, rtol=0, atol=1e-13 * np.abs(cpu).max())
    driver.launched.clear()
    values = columns.values(*batches, device="cuda")
    assert {count for _, count in driver.launched} == {_COUNT}
    np.testing.assert_allclose(values, columns.values(*batches), rtol=0, atol=1e-12)


def test_members_are_divided_to_limit_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of members at once changes no bit."""
    columns, batches = _case("attitude")
    expected = columns.jacobians(*batches)
    monkeypatch.setattr(propagator, "_NUMBERS_AT_ONCE", 1)
    for slopes, whole in zip(columns.jacobians(*batches), expected, strict=True):
        assert np.array_equal(slopes, whole)


def test_no_members_have_no_jacobians() -> None:
    """The shapes are those of other batches."""
    columns, (x0, xi0, gains) = _case("attitude")
    found = columns.jacobians(x0[:0], xi0, gains[:1])
    assert [slopes.shape for slopes in found] == [(0, columns.size, k) for k in columns.sizes]


def test_failing_member_of_jacobians_is_named() -> None:
    """A member has one run for each direction."""
    cat = pinred.load("falling_cat")
    options: dict[str, Any] = {"seed": 1, "duration": 0.4, "method": "DOP853(max_steps=20)"}
    columns = pinred.flow(cat, wrt=["xdot0"], **options).columns()
    rates = np.zeros((3, 3))
    rates[1] = 1e4
    with pytest.raises(IntegrationError, match=r"member 1 of 3 stopped at t = .*too many steps"):
        columns.jacobians(rates)


def test_derivative_that_is_not_finite_names_its_entry() -> None:
    """1/cosh is zero where cosh overflows, but its expression of the derivative is ∞/∞."""
    pulse = Torque({"bend": lambda t, *_: 0.5 / ca.cosh((t - 1.0) / 1e-3)})
    cat = pinred.load("falling_cat")
    options: dict[str, Any] = {"seed": 1, "duration": 0.1, "method": "DOP853", "forces": [pulse]}
    columns = pinred.flow(cat, wrt=["x0"], **options).columns()
    shapes = np.full((2, 3), 0.1)
    assert np.isfinite(columns.values(shapes)).all()
    with pytest.raises(IntegrationError, match=r"member 0 of 2 .* a derivative of the momentum of"):
        columns.jacobians(shapes)


_REFUSED: dict[str, dict[str, Any]] = {
    "the method is AdaptiveGauss": {"method": "AdaptiveGauss"},
    "joints come to rest at their stops": {"stops": {"bend": (-3.0, 3.0)}},
}


@pytest.mark.parametrize("why", _REFUSED)
def test_flows_without_such_derivatives_run_alone_or_are_refused(
    why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The CPU computes all derivatives that single flows have."""
    host_driver(monkeypatch)
    options: dict[str, Any] = {"seed": 1, "duration": 0.05, "method": "DOP853", **_REFUSED[why]}
    columns = pinred.flow(pinred.load("falling_cat"), wrt=["x0"], **options).columns()
    shapes = np.zeros((2, 3))
    shapes[1] = 0.1
    (found,) = columns.jacobians(shapes)
    for k in range(2):
        assert np.array_equal(found[k], columns.jacobian(shapes[k])[0])
    message = rf"device: expected a flow by DOP853 or Tsit5 .* but {re.escape(why)}"
    for method in (columns.values, columns.jacobians):
        with pytest.raises(InputError, match=message):
            method(shapes, device="cuda")


def test_closed_loops_are_refused_on_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loops are checked at each step, which devices do not store."""
    host_driver(monkeypatch)
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    columns = pinred.flow(system, wrt=["xdot0"], seed=1, duration=0.05, method="DOP853").columns()
    with pytest.raises(InputError, match="but closed loops are checked at each step"):
        columns.jacobians(np.zeros((2, system.m)), device="cuda")


def test_options_of_devices_are_checked() -> None:
    """Before a device is looked for."""
    columns, batches = _case("mass")
    wrong: Any = "gpu"
    for method in (columns.values, columns.jacobians):
        with pytest.raises(InputError, match="device: expected None or 'cuda', got 'gpu'"):
            method(*batches, device=wrong)
        with pytest.raises(InputError, match="threads: expected None with a device, got 2"):
            method(*batches, device="cuda", threads=2)

"""A flow as a JAX function: values and derivatives are those of the flow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from threading import Thread
from time import perf_counter
from typing import Any

import lazy_loader
import numpy as np
import pytest
from perturbed_cat import AT, BATCH, flow_of
from twelve_gains import OTHER, OWN, assert_same_bits, flow_pair

import pinred
from pinred import InputError, ShapeError
from pinred.common.arrays import Array
from pinred.simulation.flow_map import jax_adapter
from pinred.simulation.flow_map.flow_columns import Columns

jax: Any = lazy_loader.load("jax") if find_spec("jax") else pytest.importorskip("jax")
pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _double() -> Iterator[None]:
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.fixture(scope="module")
def function() -> Any:
    """Return the JAX function of one flow."""
    return flow_of().jax()


@pytest.fixture(scope="module")
def columns() -> Columns:
    """Return the same flow between vectors."""
    return flow_of().columns()


def slopes(columns: Columns, x: Array) -> list[Array]:
    """Return the gradients of |y|² at a shape."""
    return columns.vjp([x, *AT[1:]], 2.0 * columns.value(x, *AT[1:]))


def test_values_and_derivatives_agree_with_flow(function: Any, columns: Columns) -> None:
    """They agree with and without jit, in both modes, by position and by name."""
    expected = columns.value(*AT)
    np.testing.assert_array_equal(function(*AT), expected)
    np.testing.assert_array_equal(jax.jit(function)(*AT), expected)
    np.testing.assert_array_equal(function(AT[0], **{"back.mass": 2.1, "kick": 0.5}), expected)
    for mode in (jax.jacfwd, jax.jacrev):
        for made in (mode(function, (0, 1, 2)), jax.jit(mode(function, (0, 1, 2)))):
            for found, J in zip(made(*AT), columns.jacobian(*AT), strict=True):
                np.testing.assert_allclose(found, J, atol=1e-12)
    _, along = jax.jvp(function, tuple(AT), (np.ones(3), np.zeros(1), np.zeros(1)))
    np.testing.assert_allclose(along, columns.jacobian(*AT)[0].sum(axis=1), atol=1e-12)
    y, pull = jax.vjp(function, *AT)
    for found, part in zip(pull(2.0 * y), slopes(columns, AT[0]), strict=True):
        np.testing.assert_allclose(found, part, atol=1e-12)


def test_vmap_is_one_call(columns: Columns, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values run in SIMD lanes, and one run serves all rows of derivatives."""
    calls: list[tuple[str, Any]] = []
    for name in ("value", "values", "jvp", "vjp"):
        real = getattr(Columns, name)

        def counted(self: Any, *a: Any, _name: str = name, _real: Any = real, **k: Any) -> Any:
            calls.append((_name, a))
            return _real(self, *a, **k)

        monkeypatch.setattr(Columns, name, counted)
    function = flow_of().jax()
    entries: list[int] = []
    for number in range(3):
        k = max(jax_adapter._functions) - number
        real = jax_adapter._functions[k]

        def entered(given: Any, out: Any, _k: int = k, _real: Any = real) -> None:
            entries.append(_k)
            _real.many(given, out)

        monkeypatch.setitem(jax_adapter._functions, k, replace(real, many=entered))

    def of(x: Any) -> Any:
        return function(x, *AT[1:])

    result = jax.jit(jax.vmap(of))(BATCH)
    assert [name for name, _ in calls] == ["values"]
    assert len(entries) == 1
    for row, x in zip(result, BATCH, strict=True):
        np.testing.assert_allclose(row, columns.value(x, *AT[1:]), rtol=1e-10, atol=1e-11)
    for mode, way in ((jax.jacfwd, "jvp"), (jax.jacrev, "vjp")):
        calls.clear()
        entries.clear()
        result = jax.jit(mode(of))(AT[0])
        np.testing.assert_allclose(result, columns.jacobian(*AT)[0], atol=1e-12)
        assert [name for name, _ in calls].count(way) == 1, "one run, for all rows"
        assert len(entries) <= 2
        calls.clear()
        entries.clear()
        result = jax.jit(jax.vmap(mode(of)))(BATCH)
        assert [name for name, _ in calls].count(way) == len(BATCH)
        assert len(entries) <= 2
        for row, x in zip(result, BATCH, strict=True):
            np.testing.assert_allclose(row, columns.jacobian(x, *AT[1:])[0], atol=1e-10)


def test_vmap_and_grad_compose(function: Any, columns: Columns) -> None:
    """Vmap of grad, grad of vmap with shared inputs, nested vmap, and scan."""

    def loss(x: Any, kick: Any) -> Any:
        return (function(x, kick, AT[2]) ** 2).sum()

    for row, x in zip(jax.vmap(jax.grad(loss), (0, None))(BATCH, AT[1]), BATCH, strict=True):
        np.testing.assert_allclose(row, slopes(columns, x)[0], rtol=1e-9, atol=1e-9)
    shared = jax.grad(lambda kick: jax.vmap(loss, (0, None))(BATCH, kick).sum())(AT[1])
    total = sum(slopes(columns, x)[1] for x in BATCH)
    np.testing.assert_allclose(shared, total, rtol=1e-9)
    kicks = np.array([[0.1], [0.2], [0.3]])
    inner = jax.vmap(lambda x: jax.vmap(lambda k: function(x, k, AT[2]))(kicks))(BATCH)
    assert inner.shape == (5, 3, columns.size)
    expected = columns.value(BATCH[4], kicks[1], AT[2])
    np.testing.assert_allclose(inner[4, 1], expected, rtol=1e-10, atol=1e-11)
    _, many = jax.lax.scan(lambda carry, x: (carry, function(x, *AT[1:])), 0.0, BATCH)
    np.testing.assert_allclose(many[2], columns.value(BATCH[2], *AT[1:]), rtol=1e-12)
    assert jax.vmap(function, (0, None, None))(BATCH[:0], *AT[1:]).shape == (0, columns.size)


def test_single_precision_runs_in_double(function: Any, columns: Columns) -> None:
    """Without 64 bits in JAX, the flow runs in double precision."""
    jax.config.update("jax_enable_x64", False)
    output = function(*(value.astype(np.float32) for value in AT))
    assert output.dtype == np.float32
    rounded = [value.astype(np.float32).astype(float) for value in AT]
    np.testing.assert_array_equal(output, columns.value(*rounded).astype(np.float32))
    gradient = jax.grad(lambda x: (function(x, *AT[1:]) ** 2).sum())(AT[0].astype(np.float32))
    assert gradient.dtype == np.float32
    np.testing.assert_allclose(gradient, slopes(columns, AT[0])[0], rtol=1e-4)


def test_inputs_of_jax_are_copied(columns: Columns) -> None:
    """A run kept for its derivatives does not read memory that JAX has freed."""
    function = flow_of().jax()
    compiled = jax.jit(jax.value_and_grad(lambda m: function(**{"back.mass": m}).sum()))
    for mass in np.linspace(1.0, 3.0, 20):
        value, slope = compiled(mass)
        many = [jax.numpy.zeros(1) + k for k in range(50)]
        at = [*columns.starts[:2], mass]
        assert float(value) == pytest.approx(columns.value(*at).sum(), rel=1e-13)
        assert float(slope) == pytest.approx(columns.vjp(at, np.ones(columns.size))[2][0], rel=1e-9)
        del many


def test_threads_do_not_share_runs(function: Any, columns: Columns) -> None:
    """Concurrent threads get the results of their inputs."""
    expected = [columns.value(x, *AT[1:]) for x in BATCH]
    compiled, wrong = jax.jit(function), []

    def work() -> None:
        for _ in range(10):
            for x, y in zip(BATCH, expected, strict=True):
                wrong.extend([x] * (not np.array_equal(compiled(x, *AT[1:]), y)))

    threads = [Thread(target=work) for _ in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert not wrong


def test_invalid_inputs_are_rejected(function: Any) -> None:
    """Wrong types are rejected in tracing, and wrong values in evaluation."""
    with pytest.raises(InputError, match=r"3 inputs, x0, kick, back\.mass, and 4 were given"):
        function(*AT, 1.0)
    with pytest.raises(InputError, match=r"no input 'kik'.*kick"):
        function(kik=1.0)
    with pytest.raises(InputError, match="'x0' of a flow is given twice"):
        function(AT[0], x0=AT[0])
    with pytest.raises(ShapeError, match=r"x0 must have shape \(3,\), got \(2,\)"):
        jax.jit(function)(np.zeros(2), *AT[1:])
    with pytest.raises(InputError, match="x0 must be real numbers, got complex128"):
        function(np.zeros(3, complex))
    with pytest.raises(InputError, match="only have first derivatives"):
        jax.hessian(lambda x: function(x).sum())(AT[0])
    failed = (jax.errors.JaxRuntimeError, ValueError)  # which one, depends on when JAX looks
    for bad in (np.nan, np.inf):
        with pytest.raises(failed, match="finite"):
            function(np.full(3, bad)).block_until_ready()
    with pytest.raises(failed, match="must be above zero"):
        function(**{"back.mass": -1.0}).block_until_ready()
    assert np.isfinite(function(*AT)).all()  # and goes on


def test_old_jax_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Call frames of older versions have another layout."""
    monkeypatch.setattr(jax, "__version_info__", (0, 5, 0))
    with pytest.raises(pinred.MissingPackageError, match=r"0\.10 or newer"):
        flow_of().jax()


@pytest.mark.by_hand
def test_cost_of_a_call() -> None:
    """A direct XLA call costs less than pure_callback; the costs are printed."""
    system = pinred.load("planar_chain5")
    options: Any = {"seed": 1, "duration": 1.0, "rtol": 1e-8, "method": "DOP853"}
    flow = pinred.flow(system, **options, wrt=["x0", "xdot0"])
    columns = flow.columns()
    out = jax.ShapeDtypeStruct((columns.size,), float)
    by_callback = jax.jit(
        lambda *given: jax.pure_callback(columns.value, out, *given, vmap_method="sequential")
    )
    ways = {"columns": columns.value, "jax": jax.jit(flow.jax()), "callback": by_callback}
    rng, times = np.random.default_rng(0), {name: list[float]() for name in ways}
    for _ in range(500):
        for name, way in ways.items():
            given = jax.numpy.asarray(columns.starts[0] + 1e-6 * rng.normal(size=5))
            begin = perf_counter()
            np.asarray(way(given, columns.starts[1]))
            times[name].append(perf_counter() - begin)
    least = {name: 1e6 * min(each) for name, each in times.items()}
    print({name: f"{each:.0f} µs" for name, each in least.items()})
    assert least["jax"] < 0.8 * least["callback"]


# Vectors and scalars are compared in flows, which the adapter calls.
@pytest.mark.by_hand
def test_vector_has_the_bits_of_scalars_in_jax() -> None:
    """The JAX function has one array, and its derivatives are those of scalars."""
    one, many = flow_pair()
    f, g = one.jax(), many.jax()
    x, columns = np.array([0.1, 0.2, -0.1]), list(OTHER[:, None])
    assert_same_bits(f(OTHER, x), g(*columns, x))
    y, along = jax.jvp(lambda u: f(u, x), (OTHER,), (OWN,))
    _, scalar_along = jax.jvp(lambda *u: g(*u, x), tuple(columns), tuple(OWN[:, None]))
    assert_same_bits(along, scalar_along)
    (back,) = jax.vjp(lambda u: f(u, x), OTHER)[1](y)
    assert_same_bits(back, np.concatenate(jax.vjp(lambda *u: g(*u, x), *columns)[1](y)))
    with pytest.raises(ShapeError, match=r"u must have shape .*12.*got \(11,\)"):
        f(OTHER[:11], x)

"""Tests of machine code against CasADi's evaluation and extended precision."""

from __future__ import annotations

import re
import time
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from native_functions import build, callable_of
from strategies import examples

from pinred.common.arrays import Array
from pinred.common.errors import InputError, UnsupportedOperationError
from pinred.common.machine_code import cpu_target, load_object
from pinred.kernels.machine import lowering, native
from pinred.kernels.machine.native import compile_object
from pinred.reduction.tree.identical_branches import Lanes

INF, NAN = np.inf, np.nan
SPECIAL = [
    NAN, INF, -INF, 0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -3.0, 2.5, 1e-300, -1e300, 5e-324,
    0.1, 1e6, -2e7, 1e22, np.pi / 2, -np.pi,
]  # fmt: skip

# Operations whose results are equal to the last bit.
EXACT = [
    "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "FABS", "FLOOR", "CEIL",
    "COPYSIGN", "FMIN", "FMAX", "SIGN", "LT", "LE", "EQ", "NE", "NOT", "AND", "OR",
    "IF_ELSE_ZERO", "FMOD", "REMAINDER",
]  # fmt: skip
ROUNDED = [
    "EXP", "LOG", "LOG1P", "EXPM1", "POW", "CONSTPOW", "SIN", "COS", "TAN", "ASIN", "ACOS",
    "ATAN", "ATAN2", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "HYPOT", "ERF",
]  # fmt: skip
BINARY = {
    "ADD", "SUB", "MUL", "DIV", "COPYSIGN", "FMIN", "FMAX", "LT", "LE", "EQ", "NE", "AND", "OR",
    "IF_ELSE_ZERO", "FMOD", "REMAINDER", "POW", "CONSTPOW", "ATAN2", "HYPOT",
}  # fmt: skip


def apply(name: str, *arguments: ca.SX) -> ca.SX:
    """Return an SX node of the operation OP_<name>."""
    op = getattr(ca, f"OP_{name}")
    return ca.SX.binary(op, *arguments) if name in BINARY else ca.SX.unary(op, *arguments)


def reference(function: ca.Function, *arguments: Array) -> Array:
    """Evaluate a Function with CasADi's interpreter."""
    return np.array(function(*arguments)).ravel()


def ulps(got: Array, expected: Array) -> Array:
    """Return the distance in units of the last place; 0 if both are NaN or the same infinity."""
    same = (got == expected) | (np.isnan(got) & np.isnan(expected))
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.abs(got - expected) / np.spacing(np.abs(expected))
    return np.where(same, 0.0, np.where(np.isfinite(distance), distance, INF))


@pytest.mark.parametrize("name", EXACT + ROUNDED)
def test_operation_equals_casadi(name: str) -> None:
    """Each operation equals CasADi's, also for NaN, infinities and signed zeros."""
    x = ca.SX.sym("x", 2)
    fast, function = build(apply(name, *([x[0], x[1]] if name in BINARY else [x[0]])), inputs=[x])
    rng = np.random.default_rng(0)
    points = [(a, b) for a in SPECIAL for b in SPECIAL]
    points += [tuple(v) for v in rng.normal(size=(500, 2))]
    points += [tuple(v) for v in rng.uniform(-60, 60, size=(500, 2))]
    points += [tuple(v) for v in np.round(rng.normal(size=(200, 2)))]
    got = np.concatenate([fast(np.array(p)) for p in points])
    expected = reference(function, np.transpose(points))  # CasADi maps over the columns
    bound = 0.0 if name in EXACT else 2.0
    k = int(np.argmax(ulps(got, expected)))
    assert ulps(got, expected)[k] <= bound, (points[k], got[k], expected[k])
    if name not in {"FMIN", "FMAX"}:  # C leaves the sign of fmin(0, −0) open
        signed = ~np.isnan(expected)
        wrong = np.signbit(got[signed]) != np.signbit(expected[signed])
        assert not wrong.any(), np.array(points)[signed][wrong]


@pytest.mark.parametrize("exponent", [2.5, -1.5, 1 / 3, 7.0, 0.5])
def test_constant_power_equals_casadi(exponent: float) -> None:
    """A constant exponent is a separate operation of CasADi."""
    x = ca.SX.sym("x")
    fast, function = build(x**exponent, inputs=[x])
    for at in SPECIAL:
        got, expected = fast(np.array([at])), reference(function, np.array([at]))
        assert ulps(got, expected) <= 2.0, (at, got, expected)


@pytest.mark.parametrize("name", ["ERFINV", "PRINTME"])
def test_unsupported_operation_is_named_in_error(name: str) -> None:
    """The error names the operation that cannot be compiled."""
    x = ca.SX.sym("x")
    node = x.printme(x) if name == "PRINTME" else ca.erfinv(x)
    with pytest.raises(UnsupportedOperationError, match=rf"'{name.lower()}'"):
        compile_object(ca.Function("f", [x], [node]), "f")


def test_compile_rejects_calls_and_free_variables() -> None:
    """A Function that calls another, or has a free variable, has no machine code."""
    x = ca.SX.sym("x", 2)
    inner = ca.Function("inner", [x], [2 * x], {"never_inline": True})
    with pytest.raises(UnsupportedOperationError, match="'call'"):
        compile_object(ca.Function("f", [x], [inner(x)]), "f")
    free = ca.Function("f", [x], [x * ca.SX.sym("p")], {"allow_free": True})
    with pytest.raises(UnsupportedOperationError, match="'parameter'"):
        compile_object(free, "f")


def test_compile_rejects_invalid_functions_and_names() -> None:
    """Inputs and output must be dense SX columns, and the name valid in C."""
    x, y = ca.SX.sym("x", 2), ca.MX.sym("y", 2)
    good = ca.Function("f", [x], [x])
    wrong = [
        ca.Function("f", [y], [y]),
        ca.Function("f", [x], [x, x]),
        ca.Function("f", [x], [x.T]),
        ca.Function("f", [x], [ca.SX(2, 1)]),
        ca.Function("f", [ca.SX.sym("A", 2, 2)], [ca.SX(0.0)]),
    ]
    for function in wrong:
        with pytest.raises(InputError, match="'f'"):
            compile_object(function, "f")
    for name in ("", "2f", "a b", "sin", "pow", "ä", 'f" {'):
        with pytest.raises(InputError, match="name"):
            compile_object(good, name)


def test_constants_keep_all_bits() -> None:
    """Compiled constants equal the original ones."""
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 2**64, 200, dtype=np.uint64).view(float)
    values = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, INF, -INF, NAN, 1e-310, -7.0, 0.0]
    values += [float(v) for v in bits if np.isfinite(v)]
    x = ca.SX.sym("x", 0)
    fast, _ = build(*(ca.SX(v) for v in values), inputs=[x])
    np.testing.assert_array_equal(fast(np.empty(0)), values)


def test_empty_and_unused_inputs() -> None:
    """No inputs, no outputs, unused inputs, and inputs returned unchanged."""
    x, y, z = ca.SX.sym("x", 3), ca.SX.sym("y", 2), ca.SX.sym("z", 0)
    fast, _ = build(ca.SX(0, 1), inputs=[x, z])
    assert fast(np.zeros(3), np.zeros(0)).shape == (0,)
    fast, _ = build(ca.SX(4.0), ca.SX(0.0), inputs=[])
    np.testing.assert_array_equal(fast(), [4.0, 0.0])
    fast, _ = build(y[1], y[1], ca.sin(y[1]), ca.SX(2.0), inputs=[x, y, z])
    np.testing.assert_array_equal(
        fast(np.zeros(3), np.array([1.0, -0.0]), np.zeros(0)), [-0.0, -0.0, -0.0, 2.0]
    )


@pytest.mark.by_hand("True-2", "True-3", "True-4", "False-1", "False-5", "False-7", "False-12")
@pytest.mark.parametrize("angles", [1, 2, 3, 4, 5, 7, 12, 33])
@pytest.mark.parametrize("fma", [True, False])
def test_nested_sines_equal_casadi(angles: int, fma: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches of any size in sequence, of sines, cosines, or both."""
    if not fma:
        plain = cpu_target()._replace(fma=False)
        monkeypatch.setattr(native, "cpu_target", lambda: plain)
    x = ca.SX.sym("x", angles)
    sines, cosines = ca.sin(x), ca.cos(x[: (angles + 1) // 2])
    inner = sines * 3.0 + ca.sum1(cosines)
    fast, function = build(
        sines, cosines, ca.sin(inner), ca.cos(ca.sin(inner[0]) + cosines[0]), inputs=[x]
    )
    rng = np.random.default_rng(angles)
    for scale in (1.0, 100.0, 1e7):
        at = rng.uniform(-scale, scale, angles)
        np.testing.assert_allclose(fast(at), reference(function, at), rtol=1e-12, atol=1e-14)
    at[angles // 2] = NAN
    np.testing.assert_array_equal(np.isnan(fast(at)), np.isnan(reference(function, at)))
    ordinary = np.delete(np.arange(angles), angles // 2)
    np.testing.assert_allclose(fast(at)[ordinary], np.sin(at[ordinary]), rtol=4e-16, atol=0)


def multiples_of_half_pi(rng: np.random.Generator, most: int, count: int) -> Array:
    """Return the floats nearest to k π/2, |k| < most, or their neighbours, (count,)."""
    half_pi = np.longdouble("1.57079632679489661923132169163975144")
    k = rng.integers(-most, most, count)
    nearest = (np.longdouble(k) * half_pi).astype(float)
    neighbour = np.nextafter(nearest, rng.choice([-INF, INF], count))
    out: Array = np.where(rng.random(count) < 0.5, nearest, neighbour)
    return out


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 60, reason="no extended precision")
def test_sine_and_cosine_within_one_ulp() -> None:
    """Errors stay below 0.8 ulp, also near multiples of π/2 and far from zero."""
    width, count = 64, 64 * 500
    x = ca.SX.sym("x", width)
    fast, _ = build(ca.sin(x), ca.cos(x), inputs=[x])
    rng = np.random.default_rng(2)
    ranges = {
        "first octant": rng.uniform(-0.8, 0.8, count),
        "a few turns": rng.uniform(-20.0, 20.0, count),
        "1e5": rng.uniform(-1e5, 1e5, count),
        "to the branch": rng.uniform(-(2.0**20), 2.0**20, count),
        "beyond": rng.uniform(-1e9, 1e9, count),
        "all sizes": rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-300, 6, count),
        "multiples of half pi": multiples_of_half_pi(rng, 650_000, count),
        "multiples beyond": multiples_of_half_pi(rng, 2**36, count),
    }
    for name, at in ranges.items():
        rows = at.reshape(-1, width)
        got = np.array([fast(row) for row in rows]).reshape(-1, 2, width)
        wide = rows.astype(np.longdouble)
        for k, exact in enumerate((np.sin(wide), np.cos(wide))):
            unit = np.spacing(np.abs(exact.astype(float)))
            error = np.abs(got[:, k] - exact) / unit
            assert error.max() < 0.8, (name, ["sin", "cos"][k], float(error.max()))


def test_optimisation_keeps_nan() -> None:
    """No cancellation hides a NaN or an infinity."""
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    s, p, q = apply("ADD", a, b), apply("MUL", a, b), apply("DIV", a, b)
    # CasADi would simplify equal expressions; LLVM alone recognises these as equal.
    one, two = ((((a * b) * b) * a) * b for _ in range(2))
    expressions = [
        one - two, (one + b) - two, two - (one + b), two - (b + one), one / two, (one * b) / two,
        ca.sqrt(one) * ca.sqrt(two), apply("LT", one, two), apply("EQ", one, two) + b,
        ca.fmax(one, two), s - a, a - s, b + (a - b), p / a, q * b, a / b - 3 / b,
        ca.sqrt(a) ** 2 + b, ca.fabs(a) - a, (a * 2) * 3 - b, apply("NEG", s) + a, p - p * b,
        (one - b) * (two - b), ca.if_else(one < two, a, b), apply("NE", one, two),
    ]  # fmt: skip
    for k, expression in enumerate(
        expressions
    ):  # separately, so that no other expression needs the intermediate values
        fast, function = build(expression, inputs=[x])
        for at in [(u, v) for u in SPECIAL[:11] for v in SPECIAL[:11]]:
            got, expected = fast(np.array(at))[0], reference(function, np.array(at))[0]
            np.testing.assert_allclose(got, expected, rtol=1e-14, err_msg=f"{k} at {at}")


Recipe = list[tuple[str, int, int]]


def recipes(names: list[str], longest: int) -> st.SearchStrategy[Recipe]:
    """Return random programs: each line applies an operation to two earlier values."""
    line = st.tuples(st.sampled_from(names), st.integers(0, 10_000), st.integers(0, 10_000))
    return st.lists(line, min_size=1, max_size=longest)


def graph(recipe: Recipe, start: list[ca.SX]) -> list[ca.SX]:
    """Return all values of a program."""
    values = list(start)
    for name, i, j in recipe:
        pair = values[i % len(values)], values[j % len(values)]
        values.append(apply(name, *(pair if name in BINARY else pair[:1])))
    return values


INTEGER = [
    "ADD", "SUB", "MUL", "NEG", "TWICE", "SQ", "FABS", "FMIN", "FMAX", "SIGN", "LT", "LE", "EQ",
    "NE", "NOT", "AND", "OR", "IF_ELSE_ZERO", "COPYSIGN", "FLOOR", "CEIL",
]  # fmt: skip


@pytest.mark.slow
@examples(20, 60)
@given(
    recipe=recipes(INTEGER, 40),
    at=st.lists(st.integers(-9, 9), min_size=4, max_size=4),
    last=st.booleans(),
)
def test_random_integer_graphs_are_exact(recipe: Recipe, at: list[int], last: bool) -> None:
    """Integers below 2⁵³ are exact in any order of operations."""
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 2)
    values = graph(recipe, [x[0], x[1], y[0], y[1]])
    arguments = np.array(at[:2], dtype=float), np.array(at[2:], dtype=float)
    every = reference(ca.Function("all", [x, y], [ca.vertcat(*values)]), *arguments)
    assume(np.abs(every).max() < 2.0**53)
    fast, _ = build(*(values[-1:] if last else values), inputs=[x, y])
    np.testing.assert_array_equal(fast(*arguments), every[-1:] if last else every)


@pytest.mark.slow
@examples(20, 60)
@given(
    recipe=recipes(["ADD", "SUB", "MUL", "DIV", "NEG", "TWICE", "SQ", "SQRT", "INV"], 25),
    at=st.lists(st.sampled_from([NAN, INF, -INF, 0.0, 1.0, -1.0, 3.0]), min_size=3, max_size=3),
)
def test_random_graphs_have_nan_where_casadi_has(recipe: Recipe, at: list[float]) -> None:
    """A result is NaN or infinite exactly where CasADi's is."""
    x = ca.SX.sym("x", 3)
    values = graph(recipe, [x[0], x[1], x[2]])
    every = reference(ca.Function("all", [x], [ca.vertcat(*values)]), np.array(at))
    small = np.abs(every[np.isfinite(every) & (every != 0.0)])
    # Without rounding, a sum is zero in all orders or in none.
    assume(((small > 1e-6) & (small < 1e6) & (small * 64 % 1 == 0)).all())
    fast, function = build(values[-1], inputs=[x])
    np.testing.assert_array_equal(fast(np.array(at)), reference(function, np.array(at)))


@examples(20, 40)
@given(
    recipe=recipes(["SIN", "COS", "MEAN", "MUL", "TANH", "SQ"], 25),
    at=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
)
def test_random_smooth_graphs_equal_casadi(recipe: Recipe, at: list[float]) -> None:
    """With values within ±1 and slopes up to 2, round-off grows less than 2²⁵ times."""
    x = ca.SX.sym("x", 3)
    values = [x[0], x[1], x[2]]
    for name, i, j in recipe:
        a, b = values[i % len(values)], values[j % len(values)]
        mean = name == "MEAN"
        values.append(0.5 * (a + b) if mean else graph([(name, 0, 1)], [a, b])[-1])
    fast, function = build(*values, inputs=[x])
    np.testing.assert_allclose(fast(np.array(at)), reference(function, np.array(at)), atol=1e-8)


def ladder(rungs: int) -> ca.Function:
    """Return a graph of about 10 instructions per rung that cannot be simplified."""
    x = ca.SX.sym("x", 40)
    v = [x[k] for k in range(4)]
    outputs = []
    for k in range(rungs):
        c, s = ca.cos(x[k % 40]), ca.sin(x[k % 40])
        v = [c * v[0] + s * v[1] + 0.1 * k, c * v[1] - s * v[0], v[3] + v[0], v[2] / (2 + c)]
        outputs.append(v[3] * v[0] - v[1])
    return ca.Function("f", [x], [ca.vertcat(*outputs[-40:])], {"cse": True})


@pytest.mark.by_hand
def test_compile_time_grows_linearly_with_size() -> None:
    """Four times the instructions take about four times as long to compile."""
    seconds, sizes = [], []
    for rungs in (250, 1000):
        function = ladder(rungs)
        sizes.append(function.n_instructions())
        tries = []
        for _ in range(2):
            begun = time.perf_counter()
            compile_object(function, "f")
            tries.append(time.perf_counter() - begun)
        seconds.append(min(tries))
    assert seconds[1] < 3 * (sizes[1] / sizes[0]) * seconds[0]


@pytest.mark.slow
def test_large_function_agrees_with_casadi() -> None:
    """More than 10,000 instructions give the values of CasADi's evaluation."""
    function = ladder(1000)
    assert function.n_instructions() > 10_000
    fast = callable_of(load_object(compile_object(function, "f"), "f"), 1, function.numel_out(0))
    at = np.random.default_rng(3).normal(size=40)
    expected = reference(function, at)
    np.testing.assert_allclose(fast(at), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_code_can_be_loaded_repeatedly_and_in_threads() -> None:
    """Each loaded copy has an independent lifetime."""
    x = ca.SX.sym("x", 2)

    def work(k: int) -> float:
        function = ca.Function("f", [x], [ca.sin(x[0]) + k * x[1]])
        code = compile_object(function, "f")
        first, second = load_object(code, "f"), load_object(code, "f")
        assert first.address != second.address
        del first
        return float(callable_of(second, 1, 1)(np.array([0.0, 2.0]))[0])

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(work, range(16))) == [2.0 * k for k in range(16)]


def test_load_rejects_invalid_object_code() -> None:
    """Bytes that are no object code, and a missing function, raise errors."""
    x = ca.SX.sym("x")
    code = compile_object(ca.Function("f", [x], [2 * x]), "f")
    with pytest.raises(InputError, match="'g'"):
        load_object(code, "g")
    for bad in (b"", b"no object code at all"):
        with pytest.raises(InputError, match="'f'"):
            load_object(bad, "f")
    assert compile_object(ca.Function("f", [x], [2 * x]), "f") == code


@pytest.mark.sampled
@pytest.mark.parametrize("wide", [4, 8])
@pytest.mark.parametrize("name", EXACT + ROUNDED)
def test_wide_code_equals_casadi_in_each_lane(name: str, wide: int) -> None:
    """Each operation in each lane equals CasADi's scalar result."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    value = apply(name, x[0], x[1]) if name in BINARY else apply(name, x[0])
    function = ca.Function("f", [x, p], [ca.vertcat(value, p * value, p, ca.SX(2.0))])
    code = load_object(compile_object(function, "f", wide=wide), "f")
    call = callable_of(code, 2, 4 * wide)
    places = np.random.default_rng(3).uniform(0.1, 0.9, (2, wide))
    found = call(places.ravel(), np.array([1.5])).reshape(4, wide)
    for lane in range(wide):
        expected = reference(function, places[:, lane], np.array([1.5]))
        np.testing.assert_allclose(found[:, lane], expected, rtol=4e-16)
    places[0, 1] = np.nan
    again = call(places.ravel(), np.array([1.5])).reshape(4, wide)
    others = np.arange(wide) != 1
    assert np.array_equal(again[:, others], found[:, others], equal_nan=True)


@pytest.mark.parametrize(("wide", "is_divided"), [(1, True), (4, False)])
def test_code_is_divided_by_its_length_for_each_lane(
    wide: int, *, is_divided: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Code that is long for one lane stays one function in four, which evaluates faster."""
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.sin(x) * ca.cos(x)])
    monkeypatch.setattr(native, "LONG", function.n_instructions() // 2)
    monkeypatch.setattr(native, "PART", 1)
    text = native.lowered(lambda: compile_object(function, "f", wide=wide))
    assert ("define internal void @f." in text) == is_divided


@pytest.mark.parametrize("wide", [1, 4])
@pytest.mark.parametrize("part", [1, 7])
def test_divided_code_computes_the_same(
    part: int, wide: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Functions pass numbers and vectors to later ones, and all functions are called."""
    x = ca.SX.sym("x", 4)
    terms = [ca.sin(x[k]) * x[k - 1] for k in range(4)]
    outputs = [ca.vertcat(*terms), ca.cos(terms[0] + terms[1]) / x[2], x[3] ** 2 + terms[2]]
    function = ca.Function("f", [x], [ca.vertcat(*outputs)])
    monkeypatch.setattr(native, "LONG", 0)
    monkeypatch.setattr(native, "PART", part)
    text = native.lowered(lambda: compile_object(function, "f", wide=wide))
    assert text.count("define internal void @f.") == text.count("call void @f.") > 1
    points = np.array([0.3, -1.2, 0.7, 2.0])[:, None] + np.arange(float(wide))
    call = callable_of(load_object(compile_object(function, "f", wide=wide), "f"), 1, 6 * wide)
    found = call(points.ravel()).reshape(6, wide)
    for lane in range(wide):
        assert ulps(found[:, lane], reference(function, points[:, lane])).max() <= 4.0


@pytest.mark.parametrize("part", [0, 1])
def test_functions_align_the_vectors_that_they_spill(
    part: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stack of all functions is aligned to cache lines, also in divided code."""
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [ca.sin(x) * ca.cos(x)])
    monkeypatch.setattr(native, "LONG", 0 if part else 8000)
    monkeypatch.setattr(native, "PART", part)
    text = native.lowered(lambda: compile_object(function, "f", wide=8))
    functions = re.findall(r"^define .*@f[.(].*$", text, re.MULTILINE)
    assert len(functions) > part
    assert all("alignstack(64)" in line for line in functions)


def test_loads_and_packs_are_written_at_their_first_uses() -> None:
    """Numbers that only a later stage needs are not alive during the sines before it."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p", 2)
    lanes = Lanes()
    packed = lanes.pack([p[0], p[1]])
    product = packed * lanes.pack([ca.sin(x), ca.cos(x)])
    function = lanes.function("f", [x, p], lanes.sum(product, 2))
    text = native.lowered(lambda: compile_object(function, "f", lanes.marks["f"]))
    lines = text.split("define void @f(")[1].splitlines()
    (sines,) = (k for k, line in enumerate(lines) if "call {double, double}" in line)
    (first,) = (k for k, line in enumerate(lines) if "ptr %in0" in line and "getelement" in line)
    others = [k for k, line in enumerate(lines) if "ptr %in1" in line and "getelement" in line]
    assert first < sines < min(others)
    assert len(others) == 2


def test_short_code_is_one_function() -> None:
    """Kernels of most robots are not divided."""
    x = ca.SX.sym("x")
    text = native.lowered(lambda: compile_object(ca.Function("f", [x], [x * x]), "f"))
    assert "@f." not in text


def test_long_code_that_runs_rarely_is_not_optimised(monkeypatch: pytest.MonkeyPatch) -> None:
    """It compiles in one function, without fused multiply-adds."""
    x = ca.SX.sym("x", 3)
    function = ca.Function("f", [x], [x[0] * x[1] + x[2]])
    monkeypatch.setenv("PINRED_CODE_LEVEL", "1")
    short = compile_object(function, "f", rare=True)
    assert short == compile_object(function, "f")
    monkeypatch.setattr(native, "LONG", 0)
    long = compile_object(function, "f", rare=True)
    assert long == native.generate(lowering.lower(function, "f", fma=cpu_target().fma), 0)
    assert long != short
    assert callable_of(load_object(long, "f"), 1, 1)(np.array([2.0, 3.0, 4.0]))[0] == 10.0

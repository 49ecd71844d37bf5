"""Expressions from text, against Python's arithmetic on trees that are never parsed."""

from __future__ import annotations

import cmath
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from native_functions import build

from pinred.common.errors import InputError
from pinred.forces.signals.expressions import CONSTANTS, FUNCTIONS, parse

# Name: the function, and how much it amplifies an error of its argument.
SMOOTH: dict[str, tuple[Callable[[Any], Any], Callable[[float], float]]] = {
    "sin": (cmath.sin, lambda _: 1.0),
    "cos": (cmath.cos, lambda _: 1.0),
    "tanh": (cmath.tanh, lambda _: 1.0),
    "atan": (cmath.atan, lambda _: 1.0),
    "exp": (cmath.exp, lambda a: math.exp(a)),
    "sinh": (cmath.sinh, lambda a: math.cosh(a)),
    "cosh": (cmath.cosh, lambda a: math.cosh(a)),
}
ROUGH: dict[str, Callable[..., float]] = {
    "abs": abs,
    "min": min,
    "max": max,
    "hypot": math.hypot,
    "where": lambda c, a, b: a if c else b,
}
COMPARE: dict[str, Callable[[float, float], bool]] = {
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
}
ROUND = 1e-15


@dataclass(frozen=True)
class Tree:
    """An operation or a leaf, with its text."""

    text: str
    kind: str  # "number", "t", "negative", "power", an operator or a function
    parts: tuple[Tree, ...] = ()
    number: float = 0.0


def leaf() -> st.SearchStrategy[Tree]:
    """Numbers as Python formats them, and the name t."""
    number = st.floats(-3, 3).map(lambda v: float(f"{v:.4g}"))
    return st.one_of(
        number.map(lambda v: Tree(f"({v!r})" if v < 0 else repr(v), "number", (), v)),
        st.just(Tree("t", "t")),
    )


def grow(inner: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
    """Smooth operations on smaller trees."""
    return st.one_of(
        st.builds(
            lambda op, a, b: Tree(f"({a.text} {op} {b.text})", op, (a, b)),
            st.sampled_from("+-*/"), inner, inner,
        ),
        inner.map(lambda a: Tree(f"(-{a.text})", "negative", (a,))),
        st.builds(
            lambda a, n: Tree(f"({a.text})**{n}", "power", (a,), n), inner, st.integers(2, 5)
        ),
        st.builds(
            lambda f, a: Tree(f"{f}({a.text})", f, (a,)), st.sampled_from(sorted(SMOOTH)), inner
        ),
    )  # fmt: skip


def grow_rough(inner: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
    """Smooth operations, and those with kinks and jumps."""
    return st.one_of(
        grow(inner),
        st.builds(
            lambda f, a, b: Tree(f"{f}({a.text}, {b.text})", f, (a, b)),
            st.sampled_from(["min", "max", "hypot"]), inner, inner,
        ),
        st.builds(
            lambda op, a, b, c, d: Tree(
                f"where({a.text} {op} {b.text}, {c.text}, {d.text})",
                "where", (Tree("", op, (a, b)), c, d),
            ),
            st.sampled_from(sorted(COMPARE)), inner, inner, inner, inner,
        ),
    )  # fmt: skip


def evaluate(tree: Tree, t: complex) -> tuple[complex, float]:
    """Return the value of a tree, and a bound on its round-off error.

    Trees with large numbers, or whose branches round-off decides, are rejected.
    """
    if tree.kind == "number":
        return tree.number, 0.0
    if tree.kind == "t":
        return t, 0.0
    pairs = [evaluate(subtree, t) for subtree in tree.parts]
    values, errors = [p[0] for p in pairs], [p[1] for p in pairs]
    a, ea = values[0], errors[0]
    value: complex
    if tree.kind == "negative":
        value, error = -a, ea
    elif tree.kind == "power":
        n = int(tree.number)
        value = math.prod([a] * n)
        error = n * abs(a) ** (n - 1) * ea
    elif tree.kind in SMOOTH:
        assume(abs(a) < 10)
        function, factor = SMOOTH[tree.kind]
        if tree.kind == "atan" and abs(a.imag) > 0:
            assume(abs(a) < 1e3)
        value, error = function(a), factor(a.real) * ea
    elif tree.kind in COMPARE:
        assume(abs(a - values[1]) > 10 * sum(errors))
        value, error = float(COMPARE[tree.kind](a.real, values[1].real)), 0.0
    elif tree.kind in ROUGH:
        value, error = ROUGH[tree.kind](*[v.real for v in values]), max(errors) * 2
    else:
        b, eb = values[1], errors[1]
        if tree.kind == "/":
            assume(abs(b) > 1e-3)
            value = a / b
            error = (ea + abs(value) * eb) / abs(b)
        elif tree.kind == "*":
            value, error = a * b, abs(a) * eb + abs(b) * ea
        else:
            value, error = (a + b if tree.kind == "+" else a - b), ea + eb
    assume(abs(value) < 1e6)
    return value, 2 * error + ROUND * abs(value)


@pytest.mark.slow
@given(tree=st.recursive(leaf(), grow_rough, max_leaves=12), t=st.floats(-3, 3))
@settings(max_examples=50)
def test_expression_values_equal_python(tree: Tree, t: float) -> None:
    """Machine code and CasADi's interpreter agree with Python's floats."""
    value, error = evaluate(tree, t)
    symbol = ca.SX.sym("t")
    for function in build(parse(tree.text, {"t": symbol}), inputs=[symbol]):
        got = float(np.array(function(np.array([t]))).item())
        assert abs(got - value.real) <= 4 * error + 1e-300, tree.text


@pytest.mark.slow
@given(tree=st.recursive(leaf(), grow, max_leaves=8), t=st.floats(-2, 2))
@settings(max_examples=50)
def test_expression_derivatives_equal_complex_step(tree: Tree, t: float) -> None:
    """CasADi's derivative equals Im f(t + ih)/h."""
    step = 1e-30
    value, error = evaluate(tree, complex(t, step))
    assume(abs(value.imag) < 1e4 * step)
    assume(error < 1e-11)
    symbol = ca.SX.sym("t")
    rate = ca.densify(ca.gradient(parse(tree.text, {"t": symbol}), symbol))
    for function in build(rate, inputs=[symbol]):
        got = float(np.array(function(np.array([t]))).item())
        assert got == pytest.approx(value.imag / step, rel=1e-7, abs=1e-8), tree.text


T, X = ca.SX.sym("t"), ca.SX.sym("x", 2)
GIVEN: dict[str, Any] = {
    "t": T,
    "x": {"hinge": X[0], "left arm": X[1]},
    "column": X,
    "pair": [X[0], X[1]],
}
AT = (0.7, -1.25, 2.5)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-t**2", -(0.7**2)),
        ("2**-t**2", 2 ** (-(0.7**2))),
        ("2**3**0.5", 2 ** (3**0.5)),
        ("1 - 2 - 3*4/5", 1 - 2 - 3 * 4 / 5),
        ("1_000 * .5e-2 + 0x10", 21.0),
        ("+t", 0.7),
        ("t**t", 0.7**0.7),
        ("asin(t) + acos(t) - pi/2", 0.0),
        ("tan(t) - sin(t)/cos(t)", 0.0),
        ("log(e**t)", 0.7),
        ("sqrt(t)", math.sqrt(0.7)),
        ("atan2(x[0], -t)", math.atan2(-1.25, -0.7)),
        ("hypot(x[0], t)", math.hypot(-1.25, 0.7)),
        ("floor(x[0]) + 10*ceil(x[0])", -2 - 10.0),
        ("sign(x[0]) + 10*sign(t) + 100*sign(t - t)", 9.0),
        ("min(3, t, x['hinge'], 5)", -1.25),
        ("max(3, t, 5, x[0])", 5.0),
        ("x['hinge'] + 10*x[\"left arm\"] + 100*x[1]", -1.25 + 25 + 250),
        ("column[0] + 10*column[1]", -1.25 + 25),
        ("pair[0] + 10*pair[1]", -1.25 + 25),
        ("(t < 1) + 10*(t > 1) + 100*(t == t) + 1000*(t != x[0])", 1101.0),
        ("(0 < t < 1) + 10*(0 < t < 0.5) + 100*(2 > 1 >= t <= 1)", 101.0),
        ("where(t < 1, 3, 4) + 10*if_else(t > 1, 3, 4)", 43.0),
        ("where(x[0] > 0, sqrt(x[0]), 5)", 5.0),
        ("where(t > 0, t, log(-t))", 0.7),
        ("  (t +\r\n # a comment\n 1)\n", 1.7),
        (" + ".join(["t"] * 400), 280.0),
    ],
)
@pytest.mark.sampled
def test_documented_grammar_has_pythons_meaning(text: str, expected: float) -> None:
    """Each construct of the documentation has the value it has in Python."""
    value = parse(text, GIVEN)
    assert value.is_scalar()
    for function in build(value, inputs=[ca.vertcat(T, X)]):
        assert np.array(function(np.array(AT))).item() == pytest.approx(
            expected, rel=1e-13, abs=1e-14
        )


def test_inactive_branch_does_not_affect_derivative() -> None:
    """The other branch may have no derivative, or no value."""
    value = parse("where(t > 0, sqrt(t)*log(t), t**2)", {"t": T})
    for function in build(ca.gradient(value, T), inputs=[T]):
        assert np.array(function(np.array([-1.5]))).item() == -3.0
        assert np.array(function(np.array([1.0]))).item() == 1.0


def test_absolute_value_of_sine_compiles() -> None:
    """The modulus of a single sine or cosine has machine code."""
    for function in build(parse("abs(sin(t))", {"t": T}), inputs=[T]):
        assert np.array(function(np.array([-1.0]))).item() == pytest.approx(math.sin(1))


def test_given_names_take_precedence_over_constants() -> None:
    """A joint may be called e."""
    assert ca.is_equal(parse("e", {"e": T}), T)
    assert float(parse("e", {})) == math.e


DEEP = "nested more than 500 deep"


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("2*foo + t", 3, "foo is not a name"),
        ("__import__('os').system('x')", 1, "not a function"),
        ("t + __builtins__", 5, "__builtins__ is not a name"),
        ("t.__class__", 1, "not arithmetic"),
        ("t.real", 1, "not arithmetic"),
        ("(1).__class__.__bases__[0]", 1, "no entries"),
        ("sin.__call__(t)", 1, "not a function"),
        ("eval('1')", 1, "not a function"),
        ("open('a')", 1, "not a function"),
        ("t(1)", 1, "not a function"),
        ("sin(t)(t)", 1, "not a function"),
        ("(lambda: 1)()", 2, "not a function"),
        ("lambda: 1", 1, "not arithmetic"),
        ("[t for t in x]", 1, "not arithmetic"),
        ("sum(t for _ in x)", 1, "not a function"),
        ("{1: 2}", 1, "not arithmetic"),
        ("(t, t)", 1, "not arithmetic"),
        ("[t]", 1, "not arithmetic"),
        ("(t := 1)", 2, "not arithmetic"),
        ("max(*x)", 5, "one by one"),
        ("sin(**x)", 5, "one by one"),
        ("sin(t=1)", 5, "one by one"),
        ("*t", 1, "syntax"),
        ("f'{t}'", 1, "not arithmetic"),
        ("x[f'{t}']", 3, "an entry is"),
        ("'hinge'", 1, "text is allowed only"),
        ("b'1'", 1, "not a number"),
        ("1 if t else 2", 1, "not arithmetic"),
        ("t and t", 1, "not arithmetic"),
        ("not t", 1, "not arithmetic"),
        ("~t", 1, "not arithmetic"),
        ("await t", 1, "not arithmetic"),
        ("yield", 1, "syntax"),
        ("t = 1", 3, "syntax"),
        ("t; t", 2, "syntax"),
        ("1 +", 4, "syntax"),
        ("", 1, "no text"),
        (" \n ", 1, "no text"),
        ("# t", 4, "syntax"),
        ("2 + t % 2", 5, r"the operators are \+ - \* / \*\*"),
        ("t // 2", 1, "operators"),
        ("t ^ 2", 1, "operators"),
        ("t @ t", 1, "operators"),
        ("t << 2", 1, "operators"),
        ("t is t", 1, "comparisons"),
        ("t in x", 1, "comparisons"),
        ("1 + True", 5, "not a number"),
        ("None", 1, "not a number"),
        ("...", 1, "not a number"),
        ("1j", 1, "not a number"),
        ("nan", 1, "nan is not a name"),
        ("inf", 1, "inf is not a name"),
        ("t + 1e999", 5, "too large"),
        ("1" + "0" * 400, 1, "too large"),
        ("9" * 5000, 5001, "limit"),
        ("0x" + "f" * 9000, 1, "too large"),
        ("t + 1/0", 5, "inf"),
        ("0*log(-1)", 3, "nan"),
        ("9**9**9**9", 4, "inf"),
        ("(-8)**(1/3)", 1, "nan"),
        ("1e200*1e200*t", 1, "inf"),
        ("sin", 1, "sin is a function"),
        ("sin()", 1, "sin takes 1 arguments, got 0"),
        ("atan2(t)", 1, "atan2 takes 2 arguments, got 1"),
        ("min(t)", 1, "min takes 2 to 100"),
        ("where(t, 1)", 1, "where takes 3"),
        ("2 + x", 5, "x has entries"),
        ("t[0]", 1, "t is one number"),
        ("pi[0]", 1, "no entries"),
        ("x[0][0]", 1, "no entries"),
        ("x[2]", 3, "x has no entry 2"),
        ("x[-1]", 3, "an entry is"),
        ("x[0.0]", 3, "an entry is"),
        ("x[True]", 3, "an entry is"),
        ("x[t]", 3, "an entry is"),
        ("x[0:1]", 3, "an entry is"),
        ("x[0, 1]", 3, "an entry is"),
        ("x['hnge']", 3, "x has no entry 'hnge'"),
        ("column['hinge']", 8, "column has no entry 'hinge'"),
        ("column[2]", 8, "column has no entry 2"),
        ("pair[10**9]", 6, "an entry is"),
        ("pair[1000000000]", 6, "pair has no entry 1000000000"),
        ("t + \uff53\uff49\uff4e(t)", 5, "write sin in plain letters"),
        ("\U0001d461 + 1", 1, "write t in plain letters"),
        ("\u0455in(t)", 1, "not a function"),
        ("t \u2212 1", 3, "invalid character"),
        ("t\x00", 2, r"'\\x00' is not allowed"),
        ("t\u202e + 1", 2, "not allowed"),
        ("t +\u00a01", 4, "not allowed"),
        ("\ud800", 1, "not allowed"),
        ("2t", 1, "invalid decimal"),
        ("1if t else 2", 1, "invalid decimal"),
        ("x['\\d']", 3, "invalid escape"),
        ("(" * 150 + "t", 150, "never closed"),
        ("(" * 5000 + "t" + ")" * 4999, 201, "too many nested"),
        ("-" * 9999 + "t", 1, DEEP),
        ("-" * 600 + "t", 501, DEEP),
        ("t" + "+t" * 600, 203, DEEP),
        ("t" + "+t" * 4999, 1, DEEP),
        ("2" + "**2" * 3000, 1, DEEP),
        ("sin(" * 190 + "t" + ")" * 190 + "+y", 957 - 4, "y is not a name"),
    ],
    ids=lambda v: v[:20].encode("ascii", "backslashreplace").decode() if isinstance(v, str) else v,
)
def test_invalid_expressions_are_rejected_at_their_column(
    text: str, column: int, message: str
) -> None:
    """In linear time, with a short message."""
    calls = 0

    def count(*_: object) -> None:
        nonlocal calls
        calls += 1

    sys.setprofile(count)
    try:
        with pytest.raises(InputError, match=message) as caught:
            parse(text, GIVEN)
    finally:
        sys.setprofile(None)
    assert calls < 2000 + 100 * len(text)
    first, shown, marks, names, constants, functions = str(caught.value).split("\n")
    assert f"column {column}:" in first
    assert max(map(len, (first, shown, marks))) < 400
    assert len(shown) <= 80
    assert len(marks) <= 80
    assert marks.strip("^ ") == ""
    if column <= 30:
        assert marks.index("^") == 2 + column - 1
    assert names.startswith("names: t, x['hinge'], x['left arm'], column[0], column[1], pair[0]")
    assert constants == "constants: pi, e"
    assert all(name in functions for name in FUNCTIONS)


def test_error_in_long_text_shows_its_line() -> None:
    """The message shows the position and the surrounding text."""
    text = "(t +\n" + "t + " * 50 + "'schräg'" + " + t" * 50 + ")"
    with pytest.raises(InputError, match="line 2, column 201: text is allowed only") as caught:
        parse(text, GIVEN)
    shown, marks = str(caught.value).split("\n")[1:3]
    begin, end = marks.index("^"), len(marks)
    assert shown[begin:end] == "'schräg'"


def test_long_text_and_other_types_are_rejected() -> None:
    """Text that is too long is not parsed."""
    with pytest.raises(InputError, match="at most 10000 characters, got 10001"):
        parse("t" * 10_001, GIVEN)
    for other in (3, None, b"t", ["t"]):
        with pytest.raises(InputError, match="must be text"):
            parse(other, GIVEN)  # type: ignore[arg-type]
    assert parse("t" + " " * 9_999, GIVEN).is_scalar()


@given(text=st.text(alphabet=st.sampled_from("tx01.+-*/()[]<>=,'\"eE#\\\n :{}sin@_"), max_size=30))
@settings(max_examples=300)
def test_any_text_gives_expression_or_input_error(text: str) -> None:
    """Random text raises nothing but InputError."""
    try:
        value = parse(text, GIVEN)
    except InputError:
        return
    assert value.is_scalar()


def test_all_functions_compile_and_equal_python() -> None:
    """Each name of the tables has machine code."""
    arguments = {1: "t", 2: "t, x[0]", 3: "t > 0, t, x[0]"}
    python_functions: dict[str, Callable[..., float]] = {
        name: getattr(math, name) for name in FUNCTIONS if hasattr(math, name)
    }
    python_functions |= {**ROUGH, "if_else": ROUGH["where"], "sign": lambda a: math.copysign(1, a)}
    assert python_functions.keys() == FUNCTIONS.keys()
    given_values = {1: (AT[0],), 2: AT[:2], 3: (1.0, *AT[:2])}
    for name, (_, count, _) in FUNCTIONS.items():
        value = parse(f"{name}({arguments[count]})", GIVEN)
        expected = python_functions[name](*given_values[count])
        for function in build(value, inputs=[ca.vertcat(T, X)]):
            assert np.array(function(np.array(AT))).item() == pytest.approx(expected, rel=1e-14)
    assert (CONSTANTS["pi"], CONSTANTS["e"], len(CONSTANTS)) == (math.pi, math.e, 2)

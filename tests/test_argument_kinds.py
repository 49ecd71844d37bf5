"""Every public callable rejects arguments of a wrong kind by an error that names the argument."""

from __future__ import annotations

import inspect
import re
import timeit
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Literal

import api_index
import numpy as np
import pytest
from numpy.typing import ArrayLike

import pinred
from pinred.common.argument_kinds import checks_arguments, is_checked
from pinred.common.errors import InputError, PinredError, ShapeError

if TYPE_CHECKING:
    from decimal import Decimal

_TEXT = (
    r"\bstr\b|Literal|Outcome|Axes|Part$|Form$|Engine|Held|Kind\b|WantedOutputs|Method|Invalid|Sampler"
    r"|Quantity|Attitudes"
)
_NUMBERS = r"Array|float|Numbers|PerJoint|LimitsLike|Counts"
_ANY = r"^(Any|Hashable|T)$"
# Values, each with the annotations that may admit it.  All other parameters have to reject it.
ODD: list[tuple[Any, str]] = [
    (object(), _ANY),
    (1 + 2j, _ANY),
    (b"bytes", _ANY),
    (lambda: None, rf"{_ANY}|Callable|Action|Progress|Section"),
    (None, rf"{_ANY}|None"),
    ("text", rf"{_ANY}|{_TEXT}"),
    (True, rf"{_ANY}|bool"),
    (2.5, rf"{_ANY}|{_NUMBERS}"),
    (10**400, rf"{_ANY}|\bint\b|Direction"),
    ({}, rf"{_ANY}|Mapping|dict|PerJoint|Reference|LimitsLike|Springs"),
    ({1: object()}, r"^Any$|dict"),
    ([object()], r"^Any$|Numbers"),
    (np.array(["a"]), r"^Any$|Numbers|(Sequence|tuple|Iterable)\[(str|Outcome)"),
    (np.array([1.0, None], dtype=object), r"^Any$|Numbers"),
    (np.array([object()]), r"^Any$|Numbers"),
]


def functions() -> Iterator[tuple[str, Callable[..., Any], type | None]]:
    """Yield the name, function and class of all public functions, constructors and methods."""
    for name, value in api_index.public_names().items():
        if inspect.isfunction(value):
            yield name, value, None
        elif inspect.isclass(value) and not issubclass(value, Exception):
            yield from methods(name, value, dir(value))


def methods(
    name: str, kind: type, known: Sequence[str]
) -> Iterator[tuple[str, Callable[..., Any], type | None]]:
    """Yield the public methods of a class, and those with which other classes override them."""
    for attribute, member in inspect.getmembers_static(kind):
        function = getattr(member, "__func__", member)
        is_public = not attribute.startswith("_") or attribute in ("__init__", "__call__")
        is_function = inspect.isfunction(function) and _is_ours(function)
        if is_public and is_function and attribute in known:
            yield f"{name}.{attribute}", function, kind
    subclasses: list[type] = kind.__subclasses__()
    for derived in subclasses:
        if derived.__name__.startswith("_"):
            yield from methods(derived.__name__, derived, known)


def _is_ours(function: Callable[..., Any]) -> bool:
    return function.__module__.startswith("pinred")


VARIADIC = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)


@cache
def parameters_of(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Return the parameters of a function by name."""
    return inspect.signature(inspect.unwrap(function)).parameters


@cache
def checkable(function: Callable[..., Any]) -> list[str]:
    """Return the parameters of a function, in order, whose annotation excludes some values."""
    hints = inspect.get_annotations(function)
    parameters = parameters_of(function)
    return [
        name for name in parameters if not re.search(r"^(Any|Unpack.*)$", hints.get(name, "Any"))
    ]


def call(function: Callable[..., Any], wrong: str, value: Any, body: Callable[..., Any]) -> str:
    """Call a function of which one argument has a value, and another body; return the error.

    The checks of the other arguments are suspended, so that they need no values.
    """
    names = function.__globals__
    parameters = parameters_of(function)
    needed = {
        name: None
        for name, parameter in parameters.items()
        if parameter.default is parameter.empty and parameter.kind not in VARIADIC
    } | {wrong: value}
    plain = [n for n, p in parameters.items() if n in needed and p.kind is p.POSITIONAL_ONLY]
    check = names["_check_"]
    number = checkable(function).index(wrong)
    replaced = {
        "_function_": body,
        "_check_": lambda place, given: check(place, given) if place == number else None,
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, stub in replaced.items():
            patch.setitem(names, name, stub)
        try:
            function(*map(needed.pop, plain), **needed)
        except PinredError as error:
            return str(error)
        except Exception as error:
            return repr(error)
    return "accepted"


def test_every_public_callable_checks_its_arguments() -> None:
    """All callables with annotations that exclude values are decorated."""
    missing = [name for name, call, _ in functions() if checkable(call) and not is_checked(call)]
    assert missing == []


def test_arguments_of_wrong_kinds_are_rejected_by_name() -> None:
    """Each odd value is tried at each parameter that does not admit it; half the calls fail."""
    faults, count = [], 0
    for name, function, _ in functions():
        hints = inspect.get_annotations(function)
        for wrong in checkable(function) if is_checked(function) else ():
            for value in (odd for odd, admitted in ODD if not re.search(admitted, hints[wrong])):
                count += 1
                message = call(function, wrong, value, (accept, fail)[count % 2])
                if not message.startswith(f"{wrong}: expected "):
                    faults.append(f"{name}({wrong}={value!r}): {message}")
    assert not faults, "\n".join(faults[:20])
    assert count > 10_000


def accept(*_: Any, **__: Any) -> None:
    """Return, as a callable that ignores an argument of a wrong kind."""


def fail(*_: Any, **__: Any) -> None:
    """Raise, as a callable that uses an argument of a wrong kind.  Raises TypeError."""
    raise TypeError("a traceback")


def test_error_of_the_callable_has_precedence() -> None:
    """Its message says more about what is expected than the annotation."""

    def body(*_: Any, **__: Any) -> None:
        raise InputError("size: give the diameter in metres")

    assert call(example, "whole", "large", body) == "size: give the diameter in metres"


def test_calls_that_were_tracebacks_are_rejected() -> None:
    """Examples with real objects, each with the argument that the message names."""
    cat = pinred.load("falling_cat")
    flow = pinred.flow(cat, wrt=["x0"], x0=[0.0, 0.0, 0.0], xdot0=[0.0, 0.0, 1.0], duration=0.1)
    gait = pinred.Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
    connection = pinred.Connection.mechanical(cat)
    odd: Any = 5
    rows = np.zeros((2, 3))
    calls: dict[str, Callable[[], Any]] = {
        "x": lambda: connection.horizontal(np.zeros(3), rows),
        "xdot": lambda: connection.horizontal_slopes(rows, rows.astype(complex)),
        "x|locals": lambda: connection.locals_at([[1.0], [1.0, 2.0]]),  # type: ignore[arg-type]
        "x|shapes": lambda: connection.curvatures_at(np.zeros((2, 4))),
        "parameters": lambda: pinred.Scene(system=cat, parameters=np.zeros(3)),
        "of": lambda: pinred.flow(cat, of=odd),
        "along": lambda: flow.jvp("x0"),  # type: ignore[arg-type]
        "h": lambda: pinred.Reduction(cat).change_section("x"),  # type: ignore[arg-type]
        "moves": lambda: pinred.Gait.strokes([0, 0], odd, ["a", "b"]),
        "other": lambda: gait.then(odd),
        "f": lambda: pinred.poisson.bracket(None, odd),  # type: ignore[call-overload]
        "cost": lambda: pinred.optimise_gait(connection, cost=np.zeros(3)),  # type: ignore[arg-type]
    }
    for name, attempt in calls.items():
        with pytest.raises(InputError, match=rf"\b{name}\b"):
            attempt()


ENTRIES = [["a"], [None], [object()], [1.0, "a"]]


@pytest.mark.parametrize("entries", ENTRIES)
def test_arrays_are_checked_after_arrays_of_numbers(entries: list[Any]) -> None:
    """The type of an array says nothing about its entries."""
    for numbers in (np.zeros(2), np.zeros(2, dtype=int), np.array([1.0, 2], dtype=object)):
        assert example(numbers)
        for dtype in (None, object):
            with pytest.raises(ShapeError, match="numbers: expected numbers or None, got array"):
                example(np.array(entries, dtype=dtype))


ODD_NUMBERS = [np.array(["2020"], "M8[D]"), np.zeros(2, "m8[s]"), np.zeros(2, "V8"), 10**400]


@pytest.mark.parametrize("value", ODD_NUMBERS, ids=str)
def test_dates_durations_bytes_and_huge_numbers_are_rejected(value: Any) -> None:
    """Also after a number of the same type."""
    assert example(3)
    with pytest.raises(ShapeError, match="numbers: expected numbers or None, got"):
        example(value)


class Sized:
    """A class with a method of each form."""

    @checks_arguments
    def all_forms(
        self, a: int, /, b: float = 1.0, *rest: Any, c: str, d: bool = True, **more: Any
    ) -> Any:
        """Return all arguments."""
        return a, b, rest, c, d, more


def test_checked_function_receives_its_arguments_unchanged() -> None:
    """Positional, named, collected and omitted arguments arrive as without checks."""
    sized = Sized()
    assert sized.all_forms(1, c="x") == (1, 1.0, (), "x", True, {})
    assert sized.all_forms(1, 2.0, 3, 4, c="x", d=False, e=5) == (
        1,
        2.0,
        (3, 4),
        "x",
        False,
        {"e": 5},
    )
    with pytest.raises(TypeError, match="missing 1 required"):
        sized.all_forms(1)  # type: ignore[call-arg]
    assert inspect.signature(Sized.all_forms).parameters["b"].default == 1.0


@checks_arguments
def example(
    numbers: ArrayLike | None = None,
    *,
    whole: int = 0,
    real: float = 0.0,
    names: Sequence[str] = (),
    pair: tuple[int, float] = (0, 0.0),
    table: Mapping[str, Sequence[float]] | None = None,
    choice: Literal["a", 1] = "a",
    later: Decimal | None = None,
) -> tuple[Any, ...]:
    """Accept arguments of several kinds."""
    return numbers, whole, real, names, pair, table, choice, later


@pytest.mark.parametrize(
    "options",
    [
        {"numbers": [[1, 2.0], [np.float64(3), np.array(4)]]},
        {"numbers": range(3)},
        {"whole": np.int64(3), "real": np.array(2)},
        {"names": (name for name in "ab")},
        {"names": np.array(["a", "b"])},
        {"pair": np.array([1, 2])},
        {"table": {"a": range(2), "b": [1, 2.0]}},
        {"choice": "unknown"},  # callables reject wrong choices with hints of their own
    ],
)
def test_values_of_related_types_are_admitted(options: dict[str, Any]) -> None:
    """NumPy numbers, arrays, ranges and iterators are admitted where they work."""
    assert example(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"numbers": [1, "2"]}, r"numbers: expected numbers or None, got \[1, '2'\]"),
        ({"whole": 2.0}, "whole: expected a whole number, got 2.0"),
        ({"whole": np.array([2])}, "whole: expected a whole number, got array"),
        ({"whole": np.timedelta64(1)}, "whole: expected a whole number, got np.timedelta64"),
        ({"real": np.array([2.0])}, "real: expected a number, got array"),
        ({"real": np.array(True)}, "real: expected a number, got array"),
        ({"real": np.timedelta64(1)}, "real: expected a number, got np.timedelta64"),
        ({"names": "ab"}, "names: expected a sequence of text, got 'ab'"),
        ({"names": np.array("a")}, "names: expected a sequence of text, got array"),
        ({"table": {"a": [10**400, 1]}}, "table: expected a mapping from text to a sequence"),
        ({"names": ["a", 1]}, "names: expected a sequence of text, got"),
        ({"pair": (1, 2.0, 3)}, r"pair: expected \(a whole number, a number\), got"),
        ({"table": {"a": [1, None]}}, "table: expected a mapping from text to a sequence of"),
        ({"choice": None}, "choice: expected one of 'a', 1, got None"),
        ({"later": 1.0}, r"later: expected a Decimal or None, got 1.0. See help\(example\)"),
    ],
)
def test_message_states_the_kind_and_the_value(options: dict[str, Any], message: str) -> None:
    """Also after a call with right arguments, whose types are remembered."""
    assert example(
        **{name: inspect.signature(example).parameters[name].default for name in options}
    )
    with pytest.raises(ShapeError if "numbers" in options else InputError, match=message):
        example(**options)


def test_classes_known_by_name_admit_derived_classes() -> None:
    """Decimal is imported for type checkers only, so that the gate knows its name alone."""
    kind = type("Decimal", (), {})
    derived = type("Exact", (kind,), {})
    for value in (kind(), derived()):
        assert example(later=value)[-1] is value


def test_default_without_entries_is_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other tuples are checked at each call, because their entries vary."""
    checked: list[Any] = []
    check = example.__globals__["_check_"]

    def record(k: int, value: Any) -> Any:
        checked.append(value)
        return check(k, value)

    monkeypatch.setitem(example.__globals__, "_check_", record)
    example(names=("a",))
    checked.clear()
    example()
    example(names=("a",))
    assert checked == [(0, 0.0), ("a",), (0, 0.0)]


def test_check_of_known_types_costs_less_than_a_microsecond() -> None:
    """Compared with a bare call of a function, which takes some 0.05 µs, in the same run."""

    def bare(values: Any, *, real: float) -> None: ...

    @checks_arguments
    def gated(values: ArrayLike, *, real: float) -> None: ...

    x = np.zeros(3)
    fastest = {
        function: min(timeit.repeat(partial(function, x, real=1.0), number=1000, repeat=60))
        for function in (bare, gated)
    }
    assert fastest[gated] < 10.0 * fastest[bare]


def test_number_for_a_value_of_one_number_gets_the_construction_as_advice() -> None:
    """A bare number where a Limit is expected is likely its bound."""
    with pytest.raises(
        InputError, match=r"limit: expected a Limit or None, got 5\. Write Limit\(5\)\."
    ):
        pinred.forces.PD({"bend": 0.1}, kp=1.0, kd=1.0, limit=5)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"a Limit or None, got 'five'\. See"):
        pinred.forces.PD({"bend": 0.1}, kp=1.0, kd=1.0, limit="five")  # type: ignore[arg-type]

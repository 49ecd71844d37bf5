"""Rejection of arguments of a wrong kind, with checks derived from annotations.

A kind is what an annotation states: a number, text, a mapping from text to numbers, a System.
Ranges, lengths and names are checked by the callables themselves.  If a callable raises an
exception for an argument of a wrong kind, an error that names the argument replaces it, unless the
exception is a PinredError.

Further decorators list in a signature the options that a function accepts as `**options`.

Type checkers and editors use `**options: Unpack[…]`.  For `help` and `inspect.signature`, the
decorators below derive the signature and the descriptions from the same dataclass.

Texts such as "Gauss(0.01, 8)" are parsed into objects, and never executed.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from functools import wraps
from inspect import Parameter
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ForwardRef, Literal, TypeVar, Union, get_args, get_origin, get_overloads

import numpy as np
from numpy.typing import ArrayLike

from .errors import InputError, PinredError, ShapeError, hide_frames_between
from .names import brief, nearest, plain, quoted

_LARGEST = int(np.finfo(float).max)
_COMMON = frozenset({int, float, np.float64, np.int64})  # frequent types of entries of lists


def is_number(value: Any) -> bool:
    """Return whether a value is a real number that a float can represent."""
    if type(value) is int:
        return -_LARGEST < value < _LARGEST
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "fiu"
    # np.timedelta64 counts as a whole number, and without a unit it converts to a float.
    if not isinstance(value, Real) or isinstance(value, (bool, np.timedelta64)):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number."""
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iu"
    return isinstance(value, Integral) and not isinstance(value, (bool, np.timedelta64))


def are_numbers(value: Any) -> bool:
    """Return whether a value is an array, a number, or a nested list of arrays and numbers."""
    if isinstance(value, (list, tuple)):
        return _COMMON.issuperset(map(type, value)) or all(map(are_numbers, value))
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "O":
            return all(map(_is_entry, value.flat))
        return value.dtype.kind not in "mMSUV"
    if isinstance(value, np.generic):
        return is_number(value)
    return is_number(value) or isinstance(value, range) or hasattr(type(value), "__array__")


def _is_entry(value: Any) -> bool:
    """Return whether an entry of an array of objects is a number or an expression."""
    is_expression = hasattr(type(value), "__array__") and not isinstance(value, np.generic)
    return is_expression or is_number(value)


def has_fixed_entries(value: Any) -> bool:
    """Return whether the type of numbers, or the dtype of an array, decides that it is admitted."""
    if isinstance(value, np.ndarray):
        return bool(value.dtype.kind != "O")
    return not isinstance(value, (list, tuple, int))


class Default(float):
    """A default value of an option.  Its type marks it as a default; it behaves as a float."""

    __slots__ = ()


def is_given(value: Any) -> bool:
    """Return whether the caller set an option, that is, its value is not a Default."""
    return not isinstance(value, Default)


T = TypeVar("T")
_SOURCE = "<checks"  # start of the file name of generated code


@dataclass(frozen=True)
class Kind:
    """The values that an annotation admits.

    Attributes:
        expected: Description for messages.
        admits: Predicate of values.
        settled: Predicate of admitted values: whether all values of the same type are admitted;
            for arrays, all arrays of the same dtype.
        error: Type of the error for a rejected value.
        remedy: Function from a rejected value to a sentence that ends in a blank, or "".
    """

    expected: str
    admits: Callable[[Any], bool]
    settled: Callable[[Any], bool] = lambda _: True
    error: type[InputError] = InputError
    remedy: Callable[[Any], str] = lambda _: ""


def checks_arguments(thing: T) -> T:
    """Decorate a function, or all public methods of a class, to reject arguments of a wrong kind.

    Args:
        thing: A function with annotations, or a class, which is changed in place.
    Returns:
        The function with checks, or the class.
    """
    if not inspect.isclass(thing):
        return _checked(thing, None)  # type: ignore[arg-type, return-value]
    for name, member in list(vars(thing).items()):
        if not name.startswith("_") or name in ("__init__", "__call__"):
            if inspect.isfunction(member):
                setattr(thing, name, _checked(member, thing))
            elif isinstance(member, (classmethod, staticmethod)):
                setattr(thing, name, type(member)(_checked(member.__func__, thing)))
    return thing


def _checked(function: Callable[..., Any], owner: type | None) -> Callable[..., Any]:
    """Return a function that checks the arguments and calls the original function.

    The generated function has the same parameters, so a call costs one lookup per argument.
    """
    checks = _Checks(function, owner)
    if not checks.names:
        return function
    plain = inspect.unwrap(function)
    declared, passed = _signature(plain)
    # A default that is an empty tuple needs no check, but tuples in general need one at each call.
    skip = {name: f"{name} is not _empty_ and " for name in checks.names if name in checks.empty}
    tests = [
        f"    if {skip.get(name, '')}({name}.dtype if type({name}) is _array_ else type({name})) "
        f"not in _types_[{k}]: wrong_ = wrong_ or _check_({k}, {name})"
        for k, name in enumerate(checks.names)
    ]
    body = f"_function_({passed})"
    reject = f"    if wrong_ is not None:\n        with _rejected_(wrong_): {body}"
    run = f"    try: return {body}"
    hide = "    except Exception as error_:\n        _hide_(error_)\n        raise"
    lines = [f"def call({declared}):", "    wrong_ = None", *tests, reject, run, hide]
    values: dict[str, Any] = {"_types_": checks.types, "_check_": checks.check, "_empty_": ()}
    values |= {"__name__": __name__, "_hide_": hide_frames_between}
    values |= {"_array_": np.ndarray, "_rejected_": _rejected, "_function_": function}
    exec(compile("\n".join(lines), f"{_SOURCE} of {function.__qualname__}>", "exec"), values)
    call: Callable[..., Any] = wraps(function)(values["call"])
    call.__defaults__, call.__kwdefaults__ = plain.__defaults__, plain.__kwdefaults__
    return call


@contextmanager
def _rejected(error: InputError) -> Iterator[None]:
    """Run a call with a wrong argument, then raise `error` unless the call rejects the argument.

    Many callables check their arguments, and their messages are more specific.
    """
    try:
        yield
    except Exception as fault:
        if isinstance(fault, PinredError):
            raise
        raise error from fault
    raise error


def is_checked(function: Callable[..., Any]) -> bool:
    """Return whether a function checks its arguments."""
    return function.__code__.co_filename.startswith(_SOURCE)


def _signature(function: Callable[..., Any]) -> tuple[str, str]:
    """Return the source of a function's parameters, and of the arguments of a call with them."""
    code = function.__code__
    names = list(code.co_varnames)
    count, total = code.co_argcount, code.co_argcount + code.co_kwonlyargcount
    plain, only, star_names = names[:count], names[count:total], names[total:]
    first = count - len(function.__defaults__ or ())
    declared = [f"{name}=0" if i >= first else name for i, name in enumerate(plain)]
    if code.co_posonlyargcount:
        declared.insert(code.co_posonlyargcount, "/")
    star = f"*{star_names.pop(0)}" if code.co_flags & inspect.CO_VARARGS else "*" * bool(only)
    options = [f"**{star_names[0]}"] if code.co_flags & inspect.CO_VARKEYWORDS else []
    defaults = function.__kwdefaults__ or {}
    declared += [star] * bool(star) + [f"{n}=0" if n in defaults else n for n in only] + options
    passed = [*plain, *[star] * (star > "*"), *(f"{name}={name}" for name in only), *options]
    return ", ".join(declared), ", ".join(passed)


def call_function(function: Callable[..., Any], what: str, *arguments: Any) -> Any:
    """Call a function of the user.

    Args:
        function: The function.
        what: Name of the function, for messages.
        *arguments: Its arguments.
    Returns:
        Its result.
    Raises:
        InputError: The function raises another exception than an error of pinred.
    """
    try:
        return function(*arguments)
    except Exception as error:  # The user's function may raise any exception.
        if isinstance(error, PinredError):
            raise
        text = plain(f"{type(error).__name__}: {error}", 300)
        raise InputError(f"{what} raised {text}") from error


class _Checks:
    """Checks of a function's arguments, derived from its annotations at the first call.

    Attributes:
        names: Names of the checked parameters.
        types: Types of each parameter whose values are all admitted; for arrays their dtypes.
        empty: Names of the parameters whose default is an empty tuple.
    """

    def __init__(self, function: Callable[..., Any], owner: type | None) -> None:
        hints = inspect.get_annotations(function)
        code = inspect.unwrap(function).__code__
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        self.names = [name for name in names if hints.get(name, "Any") != "Any"]
        defaults = inspect.signature(inspect.unwrap(function)).parameters
        # A marker, such as that of a default factory, is admitted independent of the annotation.
        markers = [type(defaults[name].default) for name in self.names]
        self.types: list[set[Any]] = [
            {marker} if marker.__name__.startswith("_") else set() for marker in markers
        ]
        # An array has no truth value, so the type is compared first.
        empty = [type(defaults[n].default) is tuple and not defaults[n].default for n in self.names]
        self.empty = {name for name, is_empty in zip(self.names, empty, strict=True) if is_empty}
        self._function, self._owner = function, owner
        self._kinds: list[Kind | None] = []
        self._open: set[tuple[int, Any]] = set()  # types whose values are checked at each call

    def check(self, number: int, value: Any) -> InputError | None:
        """Return an error that names the parameter if the value is of a wrong kind."""
        if not self._kinds:
            self._kinds = list(parameter_kinds(self._function, self.names, self._owner).values())
        kind = self._kinds[number]
        if kind is not None and not kind.admits(value):
            return kind.error(
                f"{self.names[number]}: expected {kind.expected}, got {brief(value)}. "
                f"{kind.remedy(value)}See help({self._function.__qualname__})."
            )
        same = value.dtype if type(value) is np.ndarray else type(value)
        if kind is None or ((number, same) not in self._open and kind.settled(value)):
            self.types[number].add(same)
        else:
            self._open.add((number, same))
        return None


def parameter_kinds(
    function: Callable[..., Any], names: Iterable[str], owner: type | None = None
) -> dict[str, Kind | None]:
    """Return the kinds of parameters; None if every value is admitted.

    Args:
        function: A function with annotations.
        names: Names of parameters.
        owner: Its class.  Annotations of fields may be those of base classes in other modules.
    Returns:
        Kinds by name.
    """
    scope = _Names(inspect.unwrap(function).__globals__)
    for base in reversed(owner.__mro__ if owner else ()):
        scope.update(vars(sys.modules[base.__module__]))
    scope["ArrayLike"] = _Numbers
    hints = inspect.get_annotations(function)
    return {name: kind_of(hints[name], scope) for name in names}


class _Names(dict[str, Any]):
    """Names in annotations.  An unknown name represents all classes of this name."""

    def __missing__(self, name: str) -> type:
        if hasattr(builtins, name):
            raise KeyError(name)
        return _ByName(name, (), {})


class _ByName(type):
    """A class that is imported for type checkers only, so that its name alone is known."""

    def __getattr__(cls, name: str) -> type:
        return _ByName(name, (), {})

    def __instancecheck__(cls, value: object) -> bool:
        return any(base.__name__ == cls.__name__ for base in type(value).__mro__)


class _Numbers:
    """Placeholder for ArrayLike, whose members would be lost in a union."""


def kind_of(annotation: Any, names: _Names) -> Kind | None:
    """Return the kind that an annotation states; None if every value is admitted."""
    if isinstance(annotation, (str, ForwardRef)):
        text = annotation if isinstance(annotation, str) else annotation.__forward_arg__
        return kind_of(eval(text, {}, names), names)
    if annotation in _SIMPLE:
        return _SIMPLE[annotation]
    origin, args = get_origin(annotation) or annotation, get_args(annotation)
    if origin in (Union, UnionType):
        return _union(_without_array_like(args), names)
    if origin is Literal:
        return _literal(args)
    if not inspect.isclass(origin) or not _has_instances(origin):
        return None
    if issubclass(origin, np.ndarray):
        return _NUMBERS
    if issubclass(origin, Mapping):
        return _mapping(*(kind_of(arg, names) for arg in args))
    if origin is tuple and args and args[-1] is not Ellipsis:
        return _tuple([kind_of(arg, names) for arg in args])
    if issubclass(origin, Iterable) and args:
        return _sequence(kind_of(args[0], names))
    return Kind(
        _description(origin),
        lambda value: isinstance(value, origin),
        remedy=lambda value: _wrapping(origin, value),
    )


def _wrapping(kind: Any, value: Any) -> str:
    """Return the advice to construct a dataclass of a number, if it consists of one number."""
    if not (hasattr(kind, "__dataclass_fields__") and is_number(value)):
        return ""
    try:
        kind(value)
    except (TypeError, ValueError):
        return ""
    return f"Write {kind.__name__}({brief(value)}). "


def _has_instances(kind: type) -> bool:
    """Return whether isinstance works, which most protocols do not support."""
    attributes = vars(kind)
    return "_is_runtime_protocol" in attributes or not attributes.get("_is_protocol", False)


def _without_array_like(args: tuple[Any, ...]) -> tuple[Any, ...]:
    """Replace the members of ArrayLike, which an alias of a union contains, by its placeholder."""
    members = get_args(ArrayLike)
    if not set(members) <= set(args):
        return args
    return (_Numbers, *(arg for arg in args if arg not in members))


def _description(kind: type) -> str:
    if kind.__name__ == "Callable":
        return "a function"
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"


def _union(args: tuple[Any, ...], names: _Names) -> Kind | None:
    kinds = [kind_of(arg, names) for arg in args]
    members = [member for member in kinds if member is not None]
    if len(members) < len(kinds):
        return None

    def settled(value: Any) -> bool:
        return any(member.admits(value) and member.settled(value) for member in members)

    return Kind(
        " or ".join(dict.fromkeys(member.expected for member in members)),
        lambda value: any(member.admits(value) for member in members),
        settled,
        ShapeError if _NUMBERS in members else InputError,
        lambda value: next(filter(None, (member.remedy(value) for member in members)), ""),
    )


def _literal(values: tuple[Any, ...]) -> Kind:
    """Return the kind of a choice.  Callables themselves reject wrong choices, with a hint."""
    types = tuple({*map(type, values)})
    return Kind(
        f"one of {', '.join(map(repr, values))}",
        lambda value: isinstance(value, types) and not (isinstance(value, bool) > (bool in types)),
    )


def _is_sequence(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Iterable) and not isinstance(value, (*_TEXT, Mapping))


def _sequence(entry: Kind | None) -> Kind:
    if entry is None:
        return Kind("a sequence", _is_sequence)

    def admits(value: Any) -> bool:
        if not (_is_sequence(value) and isinstance(value, _STORED)):
            return _is_sequence(value)  # entries of iterators cannot be checked in advance
        if isinstance(value, range):  # may be long, and has entries of one type
            value = value[:1]
        # Check one entry of each type, because usually the type decides, as in long lists of
        # numbers.
        examples = {type(item): item for item in value}.values()
        if all(entry.admits(item) and entry.settled(item) for item in examples):
            return True
        return all(map(entry.admits, value))

    return Kind(f"a sequence of {entry.expected}", admits, _never)


def _tuple(entries: list[Kind | None]) -> Kind:
    def admits(value: Any) -> bool:
        if not (_is_sequence(value) and isinstance(value, _STORED)):
            return _is_sequence(value)
        return len(value) == len(entries) and all(
            entry is None or entry.admits(item) for entry, item in zip(entries, value, strict=True)
        )

    listed = ", ".join(entry.expected if entry else "a value" for entry in entries)
    return Kind(f"({listed})", admits, _never)


def _mapping(key: Kind | None, entry: Kind | None) -> Kind:
    def admits(value: Any) -> bool:
        return isinstance(value, Mapping) and (
            (key is None or all(map(key.admits, value)))
            and (entry is None or all(map(entry.admits, value.values())))
        )

    listed = " to ".join(side.expected if side else "values" for side in (key, entry))
    return Kind(f"a mapping from {listed}", admits, _never)


def _never(_: object) -> bool:
    return False


_TEXT = (str, bytes, bytearray, memoryview)
_STORED = (Sequence, np.ndarray)
_NUMBERS = Kind("numbers", are_numbers, has_fixed_entries, ShapeError)
_SIMPLE: dict[Any, Kind | None] = {
    Any: None,
    object: None,
    None: Kind("None", lambda value: value is None),
    NoneType: Kind("None", lambda value: value is None),
    str: Kind("text", lambda value: isinstance(value, str)),
    bool: Kind("True or False", lambda value: isinstance(value, (bool, np.bool_))),
    int: Kind("a whole number", is_whole),
    float: Kind("a number", is_number, lambda value: not isinstance(value, (int, np.ndarray))),
    Path: Kind("a path", lambda value: isinstance(value, os.PathLike)),
    _Numbers: _NUMBERS,
}


def build_from_text(
    text: str, kinds: Mapping[str, type], what: str, others: str, example: str
) -> Any:
    """Return the object that a text describes: the name of a class, and its options.

    Args:
        text: A name with options in Python notation, or a name alone.
        kinds: Dataclasses by name.
        what: Kind of object, for messages.
        others: Text that is appended to the list of names in messages.
        example: An example of a text, for messages.
    Returns:
        The object.
    Raises:
        InputError: The text has another form, or the name or an option is unknown.
    """
    name, positional, named = parse_call(text, kinds, what, others, example)
    if name not in kinds:
        raise InputError(
            f"unknown {what} {quoted(name)}; {nearest(name, list(kinds))}"
            f"the {what}s are {', '.join(kinds)}{others}"
        )
    chosen = kinds[name]
    options = {entry.name: entry.default for entry in fields(chosen)}
    unknown = [key for key in named if key not in options]
    if unknown or len(positional) > len(options):
        excess = f"option {quoted(unknown[0])}" if unknown else f"{len(positional)} options"
        raise InputError(f"{what} {name} has no {excess}; its options are {', '.join(options)}")
    repeated = [key for key in list(options)[: len(positional)] if key in named]
    if repeated:
        raise InputError(f"{what} {quoted(text)} sets {repeated[0]} twice; set it once")
    named |= dict(zip(options, positional, strict=False))
    missing = [key for key, default in options.items() if default is MISSING and key not in named]
    if missing:
        options_shown = example[example.index("(") :]
        raise InputError(f"{what} {quoted(text)} needs a {missing[0]}, as in {name}{options_shown}")
    return chosen(**named)


def parse_call(
    text: str, kinds: Mapping[str, type], what: str, others: str, example: str
) -> tuple[str, list[Any], dict[str, Any]]:
    """Parse a text NAME or NAME(1, key=2).

    Args:
        text: The text.
        kinds: Classes by name, for messages.
        what: Kind of object, for messages.
        others: Text that is appended to the list of names in messages.
        example: An example of a text, for messages.
    Returns:
        The name, the positional options and the named options.
    Raises:
        InputError: The text has another form.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Treat syntax warnings as errors.
            node = ast.parse(text.strip(), mode="eval").body
        if isinstance(node, ast.Name):
            return node.id, [], {}
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return (
                node.func.id,
                [_value(argument) for argument in node.args],
                {str(word.arg): _value(word.value) for word in node.keywords},
            )
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        pass
    raise InputError(
        f"{what} {quoted(text)} must be a name, or a name with options such as {example}; "
        f"the {what}s are {', '.join(kinds)}{others}"
    )


def _value(node: ast.expr) -> Any:
    """Return the number or text of a syntax node; inf and nan are numbers, as in repr."""
    if isinstance(node, ast.Name) and node.id in ("inf", "nan"):
        return float(node.id)
    return ast.literal_eval(node)


F = TypeVar("F", bound=Callable[..., Any])


def shows_fields(kind: type, **defaults: Any) -> Callable[[F], F]:
    """Create a decorator that replaces **options in a signature by dataclass fields.

    Args:
        kind: The dataclass.  Fields without a default are not shown.
        defaults: Defaults of the function that differ from the dataclass.
    Returns:
        The decorator.
    """
    options = []
    for entry in fields(kind):
        default = defaults.get(entry.name, entry.default)
        if entry.default_factory is not MISSING:
            default = entry.default_factory()
        if default is not MISSING:
            options.append(
                Parameter(
                    entry.name, Parameter.KEYWORD_ONLY, default=default, annotation=entry.type
                )
            )

    def decorate(function: F) -> F:
        _describe_options(function, kind, [option.name for option in options])
        return _set_options(function, options)

    return decorate


def shows_overloads(function: F) -> F:
    """Replace **options in a function's signature by the keyword arguments of its overloads."""
    options: dict[str, Parameter] = {}
    for overload in get_overloads(function):
        for parameter in inspect.signature(overload).parameters.values():
            if parameter.kind is Parameter.KEYWORD_ONLY:
                options.setdefault(parameter.name, parameter)
    return _set_options(function, options.values())


def _describe_options(function: Callable[..., Any], kind: type, names: Iterable[str]) -> None:
    """Replace the entry `options` under Args by the entries of the dataclass's Attributes."""
    doc, attributes = function.__doc__ or "", inspect.getdoc(kind) or ""
    entry = r"^    ((\w+): .*(?:\n {5,}.*)*)"
    entries = {match[2]: match[1] for match in re.finditer(entry, attributes, re.MULTILINE)}
    lines = [
        f"        {entries[name]}".replace("\n", "\n    ") for name in names if name in entries
    ]
    pattern = r"^        options: .*(?:\n {9,}.*)*$"
    if lines:
        text = "\n".join(lines)
        function.__doc__ = re.sub(pattern, lambda _: text, doc, count=1, flags=re.MULTILINE)


def _set_options(function: F, options: Iterable[Parameter]) -> F:
    """Replace **options in a function's signature with explicit keyword arguments."""
    signature = inspect.signature(function)
    plain = [p for p in signature.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    function.__signature__ = signature.replace(parameters=[*plain, *options])  # type: ignore[attr-defined]
    return function

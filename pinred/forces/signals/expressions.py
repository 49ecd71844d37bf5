"""Arithmetic from text, such as "0.3*sin(2*t) - k*x['hinge']", as a CasADi expression.

Python parses the text into a syntax tree, which is read and never executed. Any syntax that `parse`
does not list (attributes, other calls, comprehensions, strings except as a subscript, …) is
rejected with an error that shows its position in the text.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from ...common.errors import InputError

if TYPE_CHECKING:
    import casadi as ca

Names: TypeAlias = "Mapping[str, ca.SX | Mapping[str, ca.SX] | Sequence[ca.SX]]"

LONGEST = 10_000  # largest number of characters in a formula
DEEPEST = 500  # largest number of nested levels in a formula; a sum of n terms has n levels

CONSTANTS = {"pi": math.pi, "e": math.e}
# Each entry: name, CasADi's name, and the smallest and largest number of arguments.
_MANY = 100
FUNCTIONS = {
    **{
        name: (name, 1, 1)
        for name in (
            *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
            *("exp", "log", "sqrt", "sign", "floor", "ceil"),
        )
    },
    "abs": ("fabs", 1, 1),
    "atan2": ("atan2", 2, 2),
    "hypot": ("hypot", 2, 2),
    "min": ("fmin", 2, _MANY),
    "max": ("fmax", 2, _MANY),
    "where": ("if_else", 3, 3),
    "if_else": ("if_else", 3, 3),
}
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_TOO_DEEP = f"nested more than {DEEPEST} deep; put brackets round parts of a long sum"
_SHOWN = 72  # largest number of characters of the formula that an error message shows
_LISTED = 12  # largest number of entries of a name that an error message lists


def parse(text: str, names: Names, number: Callable[[float], Any] | None = None) -> ca.SX:
    """Convert the text of a formula to a scalar CasADi expression.

    The text may contain: numbers, + - * / ** and parentheses; comparisons, also chained, with
    values 1 or 0; where(c, a, b) or if_else(c, a, b); sin cos tan asin acos atan atan2 sinh cosh
    tanh exp log sqrt abs min max sign floor ceil hypot; pi and e; and the names in `names`, which
    take precedence over pi and e. The value of `where` is that of the selected branch, even if the
    other branch is NaN.

    Args:
        text: The formula, at most LONGEST characters.
        names: Further names: scalars (`t`), sequences or columns (`x[0]`), or mappings
            (`x['hinge']`, or `x[0]` for its first entry).
        number: Converts the numbers in the text, except exponents, to symbols; None to keep them.
    Returns:
        The expression.
    Raises:
        InputError: The text is not a valid formula, or its value is not finite. The message shows
            the position and the valid names.
    """
    reader = _Reader(text, names, number)
    done: dict[ast.expr, ca.SX] = {}
    for node in reader.nodes():
        done[node] = reader.value(node, [done[child] for child in reader.parts(node)])
    return done[node]  # the last node is the root


class _Reader:
    """Converter of one formula: the text, its syntax tree, and the names that it may use."""

    def __init__(self, text: str, names: Names, number: Callable[[float], Any] | None) -> None:
        if not isinstance(text, str):
            raise InputError(f"an expression must be text, like '0.3*sin(2*t)', got {text!r}")
        if len(text) > LONGEST:
            raise InputError(
                f"an expression has at most {LONGEST} characters, got {len(text)}: "
                f"{text[:_SHOWN]}… (use a table, such as Spline, for long functions of time)"
            )
        self.text = text.replace("\r\n", "\n").replace("\r", "\n").strip()
        self.lines = self.text.split("\n")
        self.names = names
        self._symbol = number
        self._exponents: set[ast.expr] = set()  # exponents and their sub-expressions

    def nodes(self) -> list[ast.expr]:
        """Return all nodes of the syntax tree in post-order, from left to right."""
        ordered = []
        waiting = [(self._tree(), 1)]
        while waiting:
            node, depth = waiting.pop()
            if depth > DEEPEST:
                self._fail(_TOO_DEEP, node)
            ordered.append(node)
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
                self._exponents.add(node.right)
            if node in self._exponents:
                self._exponents |= set(self.parts(node))
            waiting += [(child, depth + 1) for child in self.parts(node)]
        return ordered[::-1]

    def parts(self, node: ast.expr) -> list[ast.expr]:
        """Return the children of a node; reject nodes that are not arithmetic."""
        match node:
            case ast.BinOp():
                if type(node.op) not in _OPERATORS:
                    self._fail("the operators are + - * / **", node)
                return [node.left, node.right]
            case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
                return [node.operand]
            case ast.Compare():
                if any(type(op) not in _COMPARISONS for op in node.ops):
                    self._fail("the comparisons are < <= > >= == !=", node)
                return [node.left, *node.comparators]
            case ast.Call():
                return self._arguments(node)
            case ast.Constant() | ast.Name() | ast.Subscript():
                return []
        return self._fail("this is not arithmetic", node)

    def value(self, node: ast.expr, parts: list[ca.SX]) -> ca.SX:
        """Return the expression of a node, computed from the expressions of its children."""
        import casadi as ca

        match node:
            case ast.Constant():
                value = self._number(node)
                free = self._symbol is not None and node not in self._exponents
                result = ca.SX(self._symbol(value) if free and self._symbol else value)
            case ast.Name():
                result = self._name(node)
            case ast.Subscript():
                result = self._entry(node)
            case ast.BinOp():
                result = _OPERATORS[type(node.op)](*parts)
            case ast.UnaryOp():
                result = -parts[0] if isinstance(node.op, ast.USub) else parts[0]
            case ast.Compare():
                tests = [
                    _COMPARISONS[type(op)](a, b)
                    for op, a, b in zip(node.ops, parts, parts[1:], strict=False)
                ]
                result = tests[0]
                for test in tests[1:]:
                    result = ca.logic_and(result, test)
            case ast.Call(func=ast.Name(id=name)):
                function = getattr(ca, FUNCTIONS[name][0])
                least = FUNCTIONS[name][1]
                result = function(*parts[:least])
                for argument in parts[least:]:
                    result = function(result, argument)
        if result.is_constant() and not math.isfinite(float(result)):
            self._fail(f"this is {float(result)}, which is not a finite number", node)
        return result

    def _tree(self) -> ast.expr:
        """Return Python's syntax tree, or reject text that Python cannot parse."""
        for row, line in enumerate(self.lines):
            for column, letter in enumerate(line):
                if not letter.isprintable() and letter != "\t":
                    self._fault(f"the character {letter!r} is not allowed", row, column)
        if not self.text:
            self._fault("there is no text", 0, 0)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # Python's syntax warnings are errors here
                tree = ast.parse(self.text, mode="eval")
        except SyntaxError as error:
            row = min(max((error.lineno or 1) - 1, 0), len(self.lines) - 1)
            end = len(self.lines[row])  # without a reported position, the text ended too early
            column = min(error.offset - 1, end) if error.offset else end
            self._fault(error.msg, row, column)
        except (RecursionError, MemoryError):
            self._fault(_TOO_DEEP, 0, 0)
        return tree.body

    def _arguments(self, node: ast.Call) -> list[ast.expr]:
        if not (isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS):
            self._fail("this is not a function", node.func)
        name = node.func.id
        self._check_spelling(node.func)
        _, least, most = FUNCTIONS[name]
        starred = [part for part in node.args if isinstance(part, ast.Starred)]
        wrong: list[ast.expr | ast.keyword] = [*node.keywords, *starred]
        if wrong:
            self._fail(f"write the arguments of {name} one by one, without names", wrong[0])
        if not least <= len(node.args) <= most:
            count = f"{least}" if least == most else f"{least} to {most}"
            self._fail(f"{name} takes {count} arguments, got {len(node.args)}", node)
        return node.args

    def _number(self, node: ast.Constant) -> float:
        if type(node.value) not in (int, float):
            text = isinstance(node.value, str)
            self._fail(
                "text is allowed only in x['name']" if text else "this is not a number", node
            )
        try:
            number = float(node.value)  # type: ignore[arg-type]
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self._fail("this number is too large", node)
        return number

    def _name(self, node: ast.Name) -> ca.SX:
        import casadi as ca

        self._check_spelling(node)
        if node.id in self.names:
            value: Any = self.names[node.id]
            if _has_entries(value):
                self._fail(f"{node.id} has entries; say which", node)
            return ca.SX(value)
        if node.id not in CONSTANTS:
            problem = "a function; give its arguments" if node.id in FUNCTIONS else "not a name"
            self._fail(f"{_short(node.id)} is {problem}", node)
        return ca.SX(CONSTANTS[node.id])

    def _entry(self, node: ast.Subscript) -> ca.SX:
        import casadi as ca

        if not (isinstance(node.value, ast.Name) and node.value.id in self.names):
            self._fail("this has no entries", node.value)
        self._check_spelling(node.value)
        name, which = node.value.id, node.slice
        value: Any = self.names[name]
        if not _has_entries(value):
            self._fail(f"{name} is one number and has no entries", node)
        if not (isinstance(which, ast.Constant) and type(which.value) in (int, str)):
            self._fail("an entry is a whole number from 0 or a name in quotes", which)
        key: Any = which.value
        if isinstance(key, str) and isinstance(value, Mapping):
            exists = key in value
        else:
            value = list(value.values()) if isinstance(value, Mapping) else value
            exists = isinstance(key, int) and key < _length(value)
        if not exists:
            self._fail(f"{name} has no entry {_short(repr(key))}", which)
        return ca.SX(value[key])

    def _check_spelling(self, node: ast.Name) -> None:
        """Reject characters that Python normalises to others, such as full-width letters."""
        line = self.lines[node.lineno - 1].encode()
        if line[node.col_offset : node.end_col_offset] != node.id.encode():
            self._fail(f"write {_short(node.id)} in plain letters", node)

    def _fail(self, problem: str, node: ast.expr | ast.keyword) -> NoReturn:
        """Raise the error for a node."""
        row = node.lineno - 1
        line = self.lines[row].encode()  # encoded, because Python's offsets count bytes of UTF-8
        column = len(line[: node.col_offset].decode())
        end = len(line[: node.end_col_offset].decode()) if node.end_lineno == node.lineno else None
        self._fault(problem, row, column, end)

    def _fault(self, problem: str, row: int, column: int, end: int | None = None) -> NoReturn:
        """Raise the error for a position in the text."""
        line = self.lines[row]
        first = max(0, column - _SHOWN // 2)
        window = "".join(c if c.isprintable() else " " for c in line[first : first + _SHOWN])
        marks = "^" * max(1, min((end or column + 1) - column, first + _SHOWN - column))
        prefix, suffix = "…" * (first > 0), "…" * (first + _SHOWN < len(line))
        where = f"line {row + 1}, column {column + 1}" if row else f"column {column + 1}"
        raise InputError(
            f"the expression cannot be used, {where}: {problem}\n"
            f"  {prefix}{window}{suffix}\n"
            f"  {' ' * (len(prefix) + column - first)}{marks}\n"
            f"names: {', '.join(map(self._listed, self.names)) or 'none'}\n"
            f"constants: {', '.join(CONSTANTS)}\n"
            f"functions: {', '.join(FUNCTIONS)}"
        )

    def _listed(self, name: str) -> str:
        """Return a name with its entries in the notation that users write, for messages."""
        value: Any = self.names[name]
        if not _has_entries(value):
            return name
        keys = list(value) if isinstance(value, Mapping) else list(range(_length(value)))
        more = ", …" if len(keys) > _LISTED else ""
        return ", ".join(f"{name}[{key!r}]" for key in keys[:_LISTED]) + more


def _length(value: Any) -> int:
    """Return the number of entries of a sequence or a CasADi column."""
    return int(value.numel()) if hasattr(value, "numel") else len(value)


def _has_entries(value: Any) -> bool:
    """Return whether a value has several entries instead of being one scalar."""
    return isinstance(value, (Mapping, Sequence)) or (
        hasattr(value, "is_scalar") and not value.is_scalar()
    )


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:39]}…"

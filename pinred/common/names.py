"""Formatting of names and values in messages: short, printable, and on one line.

A mapping of results by name has an error that lists the names.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from typing import NoReturn, TypeVar

from .errors import InputError

_LONGEST = 60  # maximum number of characters of a name
_LONGEST_PATH = 200  # maximum number of characters of a path
_MOST = 8  # maximum number of names that a list shows


def plain(name: str, longest: int = _LONGEST) -> str:
    """Shorten a name to one printable line.

    Each run of whitespace becomes one space, and unprintable characters become escapes.  In a long
    name, the middle is omitted.

    Args:
        name: The name.
        longest: Maximum number of characters.
    Returns:
        The printable name.
    """
    # Drop the middle of huge names early, because only both ends are shown.
    if len(name) > 8 * longest:
        name = f"{name[: 4 * longest]}…{name[-4 * longest :]}"
    shown = "".join(c if c.isprintable() else _escaped(c) for c in " ".join(name.split()))
    if len(shown) <= longest:
        return shown
    head = (longest - 1) // 2
    return f"{shown[: longest - 1 - head]}…{shown[-head:]}"


def quoted(name: str) -> str:
    """Return a name as `plain` formats it, in quotes."""
    return f"'{plain(name)}'"


def plain_path(path: object) -> str:
    """Return a path as `plain` formats it, with a larger maximum length."""
    return plain(str(path), _LONGEST_PATH)


def quoted_path(path: object) -> str:
    """Return a path as `plain_path` formats it, in quotes."""
    return f"'{plain_path(path)}'"


def brief(value: object) -> str:
    """Return the repr of a value, shortened to one line."""
    try:
        return plain(repr(value), _LONGEST_PATH)
    except Exception:  # a custom __repr__ may raise any exception
        return f"a {type(value).__name__}"


def one_of(value: object, choices: Collection[str]) -> bool:
    """Return whether a value is a string and one of the choices; False for arrays and lists."""
    return isinstance(value, str) and value in choices


def listed(names: Collection[str], most: int = _MOST) -> str:
    """Join names with commas.

    Args:
        names: The names.
        most: Maximum number of listed names; the number of omitted names is appended.
    Returns:
        The list as text.
    """
    shown = [plain(name) for name, _ in zip(names, range(most), strict=False)]
    more = len(names) - len(shown)
    return ", ".join([*shown, f"… ({more} more)"] if more > 0 else shown)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "backslashreplace").decode("ascii")


_COMPARED = 200  # number of characters of a name that are compared
_MOST_JOINTS = 60  # maximum number of joints listed in a message


def nearest(name: str, known: Sequence[str]) -> str:
    """Return a question that suggests the most similar known name; empty if none is similar."""
    near = most_similar(name, known)
    return "" if near is None else f"did you mean {quoted(near)}? "


def most_similar(name: str, known: Collection[str]) -> str | None:
    """Return the known name that is most similar to a name; None if none is similar."""
    near = difflib.get_close_matches(name[:_COMPARED], known, n=1)
    return near[0] if near else None


def component_index(name: str, components: Mapping[str, int], what: str) -> int:
    """Return the index of a component of a pose, twist or momentum.

    Args:
        name: Name of the component.
        components: Index of each component by all its names, as `Group.components` returns them.
        what: Name of the argument, for messages.
    Returns:
        The index.
    Raises:
        InputError: There is no such component.  The message lists the first name of each.
    """
    if name in components:
        return components[name]
    first = list(components)[: 1 + max(components.values(), default=-1)]
    raise InputError(
        f"{what}: no component {quoted(name)}; {nearest(name, list(components))}the components are "
        f"{listed(first)}"
    )


def joint_index(name: str, joints: Sequence[str], what: str) -> int:
    """Return the index of a shape joint.

    Args:
        name: Name of the joint.
        joints: Names of all shape joints.
        what: Name of the argument, for messages.
    Returns:
        The index.
    Raises:
        InputError: No shape joint has this name.  The message lists the joints.
    """
    if name in joints:
        return joints.index(name)
    raise InputError(
        f"{what}: no shape joint {quoted(str(name))}; {nearest(str(name), joints)}"
        f"the joints are {listed(joints, _MOST_JOINTS) or 'none'}"
    )


T = TypeVar("T")


class NamedResults(dict[str, T]):
    """Results by name."""

    def __init__(self, kind: str, results: Mapping[str, T]) -> None:
        """Copy results.

        Args:
            kind: What the names are names of, such as "event".
            results: Results by name.
        """
        super().__init__(results)
        self._kind = kind

    def __missing__(self, name: str) -> NoReturn:
        names = [*self]
        hint = f"the {self._kind}s are {listed(names)}" if names else f"there is no {self._kind}"
        raise KeyError(f"no {self._kind} {quoted(str(name))}; {nearest(str(name), names)}{hint}")

    def __reduce__(self) -> tuple[type, tuple[str, dict[str, T]]]:
        return type(self), (self._kind, dict(self))


def is_number(word: str) -> bool:
    """Return whether a word denotes a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True

"""Names that come from outside, as messages show them: of links, joints, robots and files."""

from __future__ import annotations

from collections.abc import Collection

_LONGEST = 60  # characters of a name
_LONGEST_PATH = 200  # of the name of a file, with its folders
_MOST = 8  # names in a list


def plain(name: str, longest: int = _LONGEST) -> str:
    """Return a name in one short line that can be printed.

    Blanks and line breaks become one blank, what cannot be printed an escape; what is too long
    is cut in its middle.
    """
    if len(name) > 8 * longest:  # however long it is, only its ends will be seen
        name = f"{name[: 4 * longest]}…{name[-4 * longest :]}"
    shown = "".join(c if c.isprintable() else _escaped(c) for c in " ".join(name.split()))
    if len(shown) <= longest:
        return shown
    head = (longest - 1) // 2
    return f"{shown[: longest - 1 - head]}…{shown[-head:]}"


def quoted(name: str) -> str:
    """Return a name as `plain` does, in quotes."""
    return f"'{plain(name)}'"


def plain_path(path: object) -> str:
    """Return the name of a file or folder as `plain` does; it may be longer than others."""
    return plain(str(path), _LONGEST_PATH)


def quoted_path(path: object) -> str:
    """Return the name of a file or folder as `plain_path` does, in quotes."""
    return f"'{plain_path(path)}'"


def brief(value: object) -> str:
    """Return what Python shows of a value, in one short line."""
    try:
        return plain(repr(value), _LONGEST_PATH)
    except Exception:  # of any type: a number of thousands of digits, somebody's own __repr__
        return f"a {type(value).__name__}"


def one_of(value: object, choices: Collection[str]) -> bool:
    """Return whether a value is one of some words; arrays and lists are none."""
    return isinstance(value, str) and value in choices


def listed(names: Collection[str], most: int = _MOST) -> str:
    """Return names in a row, the first few of many."""
    shown = [plain(name) for name, _ in zip(names, range(most), strict=False)]
    more = len(names) - len(shown)
    return ", ".join([*shown, f"… ({more} more)"] if more > 0 else shown)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "backslashreplace").decode("ascii")

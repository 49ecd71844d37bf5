"""Numbers that hold where nobody gave one, told apart from the same numbers where somebody did."""

from __future__ import annotations

from typing import Any


class Default(float):
    """The value of an option that was left out; as a number it is like any other."""

    __slots__ = ()


def is_given(value: Any) -> bool:
    """Return whether the value of an option is not what holds where it is left out."""
    return not isinstance(value, Default)

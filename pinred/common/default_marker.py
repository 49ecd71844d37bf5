"""Markers that distinguish default values from equal values set by the caller."""

from __future__ import annotations

from typing import Any


class Default(float):
    """A default value of an option.  Its type marks it as a default; it behaves as a float."""

    __slots__ = ()


def is_given(value: Any) -> bool:
    """Return whether the caller set an option, that is, its value is not a Default."""
    return not isinstance(value, Default)

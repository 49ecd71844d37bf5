"""Default values of options, distinguishable from equal values that the caller set."""

from __future__ import annotations

from typing import Any


class Default(float):
    """A default value of an option; it is a normal float otherwise."""

    __slots__ = ()


def is_given(value: Any) -> bool:
    """Return whether the caller set an option, as opposed to its default."""
    return not isinstance(value, Default)

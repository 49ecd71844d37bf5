"""Results by name, whose error for an unknown name lists the names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn, TypeVar

from .names import listed, nearest, quoted

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
        known = f"the {self._kind}s are {listed(names)}" if names else f"there is no {self._kind}"
        raise KeyError(f"no {self._kind} {quoted(str(name))}; {nearest(str(name), names)}{known}")

    def __reduce__(self) -> tuple[type, tuple[str, dict[str, T]]]:
        return type(self), (self._kind, dict(self))

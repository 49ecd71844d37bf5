"""Values made once: for the object they belong to, as long as it lives, or for the process."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cache, wraps
from threading import RLock, get_ident
from typing import Any, ParamSpec, TypeVar

_T = TypeVar("_T")
_P = ParamSpec("_P")


def once(owner: object, key: Hashable, make: Callable[[], _T]) -> _T:
    """Return the value that `make` gave when this owner and key were first asked for.

    It is kept in the owner, to which it may refer: a table of weak references would keep both
    alive for ever.  Of two threads that come at once, both make a value, and the first one's
    serves both.
    """
    kept: dict[Hashable, Any] = vars(owner).setdefault("_once", {})
    found: _T = kept[key] if key in kept else kept.setdefault(key, make())
    return found


def once_a_thread(owner: object, key: Hashable, make: Callable[[], _T]) -> _T:
    """Return the value made for this owner, key and thread: for values that own work space."""
    return once(owner, (get_ident(), key), make)


def once_for_all(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Make a function give the same object for the same arguments, to all threads.

    functools.cache lets two threads that come at once both call the function.
    """
    kept, lock = cache(function), RLock()

    @wraps(function)
    def found(*args: _P.args, **options: _P.kwargs) -> _T:
        with lock:
            return kept(*args, **options)  # type: ignore[arg-type]

    return found

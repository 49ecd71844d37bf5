"""Caches of computed values, stored in an owner object or for the whole process."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import cache, wraps
from threading import Lock, RLock, get_ident
from typing import Any, ParamSpec, TypeVar

_T = TypeVar("_T")
_P = ParamSpec("_P")
_LOCK = Lock()


def once(owner: object, key: Hashable, make: Callable[[], _T]) -> _T:
    """Return a value that is computed at the first call for an owner and key.

    The value is stored in the owner.  A table with weak references would not work: a value that
    refers to its owner would keep both alive forever.  If two threads call at once, both compute a
    value, and both receive the value that was stored first.

    Args:
        owner: Object that stores the value.
        key: Key of the value in this owner.
        make: Function that computes the value.
    Returns:
        The value.
    """
    values: dict[Hashable, Any] = vars(owner).setdefault("_once", {})
    value: _T = values[key] if key in values else values.setdefault(key, make())
    return value


def is_first(owner: object, key: Hashable) -> bool:
    """Return whether this is the first call for an owner and key."""
    mark = object()
    return once(owner, key, lambda: mark) is mark


def recent(owner: object, key: Hashable, make: Callable[[], _T], most: int, kind: Hashable) -> _T:
    """Return a value that is computed once for a key while it is among the most recently used.

    Values of the same kind share a limit.  A value that is dropped lives on as long as others
    refer to it; the next call computes another one.

    Args:
        owner: Object that stores the values.
        key: Key of the value in this owner.
        make: Function that computes the value.
        most: Largest number of stored values of this kind.
        kind: Key of the values that share the limit.
    Returns:
        The value.
    """
    values: OrderedDict[Hashable, Any] = once(owner, (recent, kind), OrderedDict)
    value: _T
    with _LOCK:
        if key in values:
            values.move_to_end(key)
            value = values[key]
            return value
    computed = make()
    with _LOCK:
        value = values.setdefault(key, computed)  # another thread may have been faster
        values.move_to_end(key)
        while len(values) > most:
            values.popitem(last=False)
    return value


def once_a_thread(owner: object, key: Hashable, make: Callable[[], _T]) -> _T:
    """Return a value computed once per owner, key and thread.

    Use this function for values with work arrays, which threads must not share.

    Args:
        owner: Object that stores the value.
        key: Key of the value in this owner.
        make: Function that computes the value.
    Returns:
        The value.
    """
    return once(owner, (get_ident(), key), make)


def once_for_all(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Cache a function's results, with one call for each argument list across all threads.

    With functools.cache alone, two concurrent threads could both call the function.

    Args:
        function: The function.
    Returns:
        The cached function.
    """
    cached, lock = cache(function), RLock()

    @wraps(function)
    def locked(*args: _P.args, **options: _P.kwargs) -> _T:
        with lock:
            return cached(*args, **options)  # type: ignore[arg-type]

    return locked

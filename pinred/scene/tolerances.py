"""The tolerances an integrator works to: its own, or the scene's."""

from __future__ import annotations

from dataclasses import replace

from ..common.defaults import is_given
from ..common.errors import InputError
from ..integrators.methods import DOP853_LEAST, AdaptiveGauss, ErrorControl, Method


def check_tolerances(method: Method, rtol: float, atol: float) -> None:
    """Raise InputError if both a scene and its method were given tolerances."""
    given = [name for name, value in (("rtol", rtol), ("atol", atol)) if is_given(value)]
    if given and _has_own(method):
        raise InputError(
            f"{given[0]} is given beside a method with tolerances of its own, {method}; give "
            f"{method.name} without rtol and atol to have the scene's, or the scene none"
        )


def with_tolerances(method: Method, rtol: float, atol: float) -> Method:
    """Return a method with these tolerances where it has step control and none of its own.

    Below the least that the method can keep, rtol is raised to that.
    """
    if not isinstance(method, ErrorControl) or _has_own(method):
        return method
    least = 0.0 if isinstance(method, AdaptiveGauss) else DOP853_LEAST
    return replace(method, rtol=max(rtol, least), atol=atol)


def _has_own(method: Method) -> bool:
    return isinstance(method, ErrorControl) and (is_given(method.rtol) or is_given(method.atol))

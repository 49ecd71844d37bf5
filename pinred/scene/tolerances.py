"""Tolerances of a scene: limits, and the tolerances that its integrator gets.

The default values are in integrators/methods/default_tolerances.py.
"""

from __future__ import annotations

from dataclasses import replace

from ..common.default_marker import is_given
from ..common.errors import InputError
from ..integrators.methods import DOP853_LEAST, AdaptiveGauss, ErrorControl, Method

TIGHTEST = 1e-14  # smallest relative tolerance; below it, round-off determines the step size
# The integrated quantities are momenta, but users need accurate rates.  If a light joint is
# attached to heavy links, a relative error of a momentum causes a larger relative error of the
# light joint's rate.
MOMENTUM_MARGIN = 10.0


def check_tolerances(method: Method, rtol: float, atol: float) -> None:
    """Reject tolerances that both the scene and its method state.

    Args:
        method: Integrator of the scene.
        rtol: Relative tolerance of the scene.
        atol: Absolute tolerance of the scene.
    Raises:
        InputError: the scene and the method both have tolerances.
    """
    options = [name for name, value in (("rtol", rtol), ("atol", atol)) if is_given(value)]
    if options and _has_tolerances(method):
        raise InputError(
            f"{options[0]} conflicts with the tolerances of the method {method}. Give tolerances "
            f"either to the scene or to {method.name}."
        )


def with_tolerances(method: Method, rtol: float, atol: float) -> Method:
    """Return a method with the tolerances of its scene.

    Args:
        method: Integrator.  It stays unchanged if it has equal steps or its own tolerances.
        rtol: Relative tolerance; increased to the smallest tolerance that the method can satisfy.
        atol: Absolute tolerance.
    Returns:
        The method with tolerances.
    """
    if not isinstance(method, ErrorControl) or _has_tolerances(method):
        return method
    least = 0.0 if isinstance(method, AdaptiveGauss) else DOP853_LEAST
    return replace(method, rtol=max(rtol, least), atol=atol)


def _has_tolerances(method: Method) -> bool:
    return isinstance(method, ErrorControl) and (is_given(method.rtol) or is_given(method.atol))

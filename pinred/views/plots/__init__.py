"""Figures of motions, as matplotlib Figures that are returned and never shown.

    pinred.plot(traj, "shape").savefig("shape.png")
    pinred.plots.curvature(system, joints=("bend", "sway")).savefig("curvature.pdf")

Functions are imported when they are first used; they need the extra `plots`.  pyplot is not
imported, and no GUI is touched.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ...common.errors import InputError, MissingPackageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .conserved import energy, momentum
    from .curvature_field import curvature
    from .full_error import error
    from .momentum_sphere import sphere
    from .phase_portrait import phase
    from .poincare_section import poincare
    from .time_series import base, shape
    from .work import work_precision

INSTALL = 'pip install "pinred[plots]"'
KINDS = {  # name of a function: the module it stands in
    "shape": "time_series",
    "base": "time_series",
    "momentum": "conserved",
    "energy": "conserved",
    "error": "full_error",
    "phase": "phase_portrait",
    "sphere": "momentum_sphere",
    "curvature": "curvature_field",
    "poincare": "poincare_section",
    "work_precision": "work",
}

__all__ = [
    "INSTALL",
    "KINDS",
    "base",
    "curvature",
    "energy",
    "error",
    "momentum",
    "phase",
    "plot",
    "poincare",
    "shape",
    "sphere",
    "work_precision",
]


def plot(source: Any, kind: str, **options: Any) -> Figure:
    """Return the figure of a kind: the function of that name in this module.

    source: what the function takes, a Trajectory for all but work_precision.
    Raises InputError for a kind or option that there is not, listing those there are;
    MissingPackageError if matplotlib is not installed.
    """
    known = options_of(kind)
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise InputError(f"plot '{kind}' has no option '{option}'; {has}")
    figure: Figure = __getattr__(kind)(source, **options)
    return figure


def options_of(kind: str) -> tuple[str, ...]:
    """Return the names of the options that a kind of plot takes.  Raises as `plot`."""
    if kind not in KINDS:
        raise InputError(f"no plot of kind {kind!r}; the kinds are {', '.join(KINDS)}")
    return tuple(__getattr__(kind).__wrapped__.__kwdefaults__ or ())


def __getattr__(name: str) -> Any:
    if name not in KINDS:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    try:
        value = getattr(import_module(f"{__name__}.{KINDS[name]}"), name)
    except ModuleNotFoundError as missing:
        if (missing.name or "").split(".")[0] not in ("matplotlib", "mpl_toolkits"):
            raise
        raise MissingPackageError(f"plots need matplotlib: {INSTALL}") from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__

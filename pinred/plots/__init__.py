"""Figures of motions, as matplotlib Figures that are returned and never shown.

    traj.plot("shape").savefig("shape.png")
    pinred.plots.curvature(system, joints=("bend", "sway")).savefig("curvature.pdf")

Functions are imported when they are first used; they need the extra `plots`.  pyplot is not
imported, and no GUI is touched.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..errors import InputError, MissingPackageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .conserved import energy, momentum
    from .full_error import error
    from .recording import Recording, read_recording
    from .time_series import base, shape

INSTALL = 'pip install "pinred[plots]"'
KINDS = {  # name of a function: the module it stands in
    "shape": "time_series",
    "base": "time_series",
    "momentum": "conserved",
    "energy": "conserved",
    "error": "full_error",
}
_HOME = {**KINDS, **dict.fromkeys(("Recording", "read_recording"), "recording")}

__all__ = [
    "INSTALL",
    "KINDS",
    "Recording",
    "base",
    "energy",
    "error",
    "momentum",
    "plot",
    "read_recording",
    "shape",
]


def plot(source: Any, kind: str, **options: Any) -> Figure:
    """Return the figure of a kind: the function of that name in this module.

    source: what the function takes, a Trajectory for all but work_precision.
    Raises InputError for a kind or option that there is not, listing those there are;
    MissingPackageError if matplotlib is not installed.
    """
    if kind not in KINDS:
        raise InputError(f"no plot of kind {kind!r}; the kinds are {', '.join(KINDS)}")
    function = __getattr__(kind)
    known = function.__wrapped__.__kwdefaults__ or {}
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise InputError(f"plot '{kind}' has no option '{option}'; {has}")
    figure: Figure = function(source, **options)
    return figure


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    try:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    except ModuleNotFoundError as missing:
        if (missing.name or "").split(".")[0] not in ("matplotlib", "mpl_toolkits"):
            raise
        raise MissingPackageError(f"plots need matplotlib: {INSTALL}") from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__

"""Figures of motions, as matplotlib Figures that are returned and never shown.

    pinred.plot(traj, "shape").savefig("shape.png")
    pinred.plots.curvature(system, joints=("bend", "sway")).savefig("curvature.pdf")

Functions are imported on first use; they need the extra `plots`. Neither pyplot nor a GUI is
imported. The stub `__init__.pyi` lists the modules of the functions.
"""

import lazy_loader

from ...common.errors import MissingPackageError, install_command

_imported, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

KINDS = tuple(name for name in __all__ if name not in ("options_of", "plot"))


def __getattr__(name: str) -> object:
    try:
        return _imported(name)
    except ModuleNotFoundError as missing:
        if (missing.name or "").split(".")[0] not in ("matplotlib", "mpl_toolkits"):
            raise
        raise MissingPackageError(f"plots need matplotlib: {install_command('plots')}") from None

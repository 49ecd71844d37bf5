"""Forces on a system: torques, wrenches, potentials, controllers, and the signals they follow.

The same expressions serve all routes to the dynamics. This package imports `reduction` and packages
below it. Its public names are those of `kinds`, imported when first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .kinds import *  # noqa: F403


def __getattr__(name: str) -> Any:
    kinds = import_module(f"{__name__}.kinds")
    if name == "__all__" or name in kinds.__all__:
        return getattr(kinds, name)
    raise AttributeError(f"No {__name__} attribute {name}")


def __dir__() -> list[str]:
    return sorted(import_module(f"{__name__}.kinds").__all__)

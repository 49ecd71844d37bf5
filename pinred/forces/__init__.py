"""Everything that acts on a system: forces, controllers, and the signals they follow.

One set of expressions serves every route.  Imports `reduction` and what lies below it.
The names are those that `kinds` lists, imported when they are first used.
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

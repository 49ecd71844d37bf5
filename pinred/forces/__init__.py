"""What acts on a system: forces, controllers, and the signals they follow.

One set of expressions serves every route.  Imports `reduction` and what lies below it.
Names are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .kinds import PD as PD
    from .kinds import Action as Action
    from .kinds import ComputedTorque as ComputedTorque
    from .kinds import Controller as Controller
    from .kinds import Damper as Damper
    from .kinds import Force as Force
    from .kinds import Limit as Limit
    from .kinds import PotentialEnergy as PotentialEnergy
    from .kinds import Spring as Spring
    from .kinds import Torque as Torque
    from .kinds import Wrench as Wrench

_NAMES = [
    "Action",
    "ComputedTorque",
    "Controller",
    "Damper",
    "Force",
    "Limit",
    "PD",
    "PotentialEnergy",
    "Spring",
    "Torque",
    "Wrench",
]


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        return getattr(import_module(".kinds", __name__), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return _NAMES

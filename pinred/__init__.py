"""pinred: reduction of multibody systems with symmetry, backed by Pinocchio.

    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    traj = pinred.simulate(system, duration=10.0)
    print(pinred.compare(traj))

Names are imported when they are first used, so that `import pinred` is light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import equations, forces, lie, plots, signals
    from .balance import EnergyBalance, MomentumBalance
    from .comparison import Report, compare
    from .errors import (
        InputError,
        IntegrationError,
        KernelMismatch,
        LoadError,
        MissingPackageError,
        ModelError,
        OutputError,
        PinredError,
        ShapeError,
        SingularInertiaError,
        SymmetryError,
    )
    from .grid import ShapeField
    from .inspection import Inspection, inspect
    from .integrators.method import DOP853, RKMK4, AdaptiveGauss, Gauss, Radau, Variational
    from .loading import load
    from .many import Failure, Trajectories, simulate_many
    from .recording import Recording, read_recording
    from .reduction import ReducedShape, Reduction
    from .scene import Scene
    from .scene_file import load_scene
    from .scene_keys import scene_schema
    from .simulation import simulate
    from .state import ShapeState, State
    from .system import Configuration, InitialState, System, Velocity
    from .trajectory import Trajectory

__version__ = "0.1.0"

_HOME = {
    **dict.fromkeys(("Report", "compare"), "comparison"),
    **dict.fromkeys(
        (
            *(
                "InputError",
                "IntegrationError",
                "KernelMismatch",
                "LoadError",
                "MissingPackageError",
                "ModelError",
                "OutputError",
            ),
            *("PinredError", "ShapeError", "SingularInertiaError", "SymmetryError"),
        ),
        "errors",
    ),
    "ShapeField": "grid",
    **dict.fromkeys(("Inspection", "inspect"), "inspection"),
    "load": "loading",
    **dict.fromkeys(("Failure", "Trajectories", "simulate_many"), "many"),
    **dict.fromkeys(("Recording", "read_recording"), "recording"),
    **dict.fromkeys(("ReducedShape", "Reduction"), "reduction"),
    "Scene": "scene",
    "load_scene": "scene_file",
    "scene_schema": "scene_keys",
    "simulate": "simulation",
    **dict.fromkeys(("Configuration", "InitialState", "System", "Velocity"), "system"),
    **dict.fromkeys(("ShapeState", "State"), "state"),
    "Trajectory": "trajectory",
    **dict.fromkeys(("EnergyBalance", "MomentumBalance"), "balance"),
    **dict.fromkeys(
        ("DOP853", "RKMK4", "AdaptiveGauss", "Gauss", "Radau", "Variational"), "integrators.method"
    ),
}
_MODULES = ("equations", "forces", "lie", "plots", "signals")

__all__ = [
    "DOP853",
    "RKMK4",
    "AdaptiveGauss",
    "Configuration",
    "EnergyBalance",
    "Failure",
    "Gauss",
    "InitialState",
    "InputError",
    "Inspection",
    "IntegrationError",
    "KernelMismatch",
    "LoadError",
    "MissingPackageError",
    "ModelError",
    "MomentumBalance",
    "OutputError",
    "PinredError",
    "Radau",
    "Recording",
    "ReducedShape",
    "Reduction",
    "Report",
    "Scene",
    "ShapeError",
    "ShapeField",
    "ShapeState",
    "SingularInertiaError",
    "State",
    "SymmetryError",
    "System",
    "Trajectories",
    "Trajectory",
    "Variational",
    "Velocity",
    "compare",
    "equations",
    "forces",
    "inspect",
    "lie",
    "load",
    "load_scene",
    "plots",
    "read_recording",
    "scene_schema",
    "signals",
    "simulate",
    "simulate_many",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _HOME:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'pinred' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]

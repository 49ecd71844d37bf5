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

from .common.version import __version__ as __version__

if TYPE_CHECKING:
    from . import equations, forces, lie, plots, signals
    from .analysis.inspection import Inspection, inspect
    from .common.errors import (
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
    from .integrators.methods import DOP853, RKMK4, AdaptiveGauss, Gauss, Radau, Variational
    from .kernels.casadi_functions import casadi_functions
    from .reduction.reduction import ReducedShape, Reduction
    from .reduction.shape_field import ShapeField
    from .scene.scene import Scene
    from .scene.toml.keys import scene_schema
    from .scene.toml.reader import load_scene
    from .simulation.balances import EnergyBalance, MomentumBalance
    from .simulation.recording import Recording, read_recording
    from .simulation.simulate import simulate
    from .simulation.simulate_many import Failure, Trajectories, simulate_many
    from .simulation.state import ShapeState, State
    from .simulation.trajectory import Trajectory
    from .system.load import load
    from .system.system import Configuration, InitialState, System, Velocity
    from .verification.compare import Report, compare
    from .views.motions import play, plot, save_film, save_html


_HOME = {
    "casadi_functions": "kernels.casadi_functions",
    **dict.fromkeys(("play", "plot", "save_film", "save_html"), "views.motions"),
    **dict.fromkeys(("Report", "compare"), "verification.compare"),
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
        "common.errors",
    ),
    "ShapeField": "reduction.shape_field",
    **dict.fromkeys(("Inspection", "inspect"), "analysis.inspection"),
    "load": "system.load",
    **dict.fromkeys(("Failure", "Trajectories", "simulate_many"), "simulation.simulate_many"),
    **dict.fromkeys(("Recording", "read_recording"), "simulation.recording"),
    **dict.fromkeys(("ReducedShape", "Reduction"), "reduction.reduction"),
    "Scene": "scene.scene",
    "load_scene": "scene.toml.reader",
    "scene_schema": "scene.toml.keys",
    "simulate": "simulation.simulate",
    **dict.fromkeys(("Configuration", "InitialState", "System", "Velocity"), "system.system"),
    **dict.fromkeys(("ShapeState", "State"), "simulation.state"),
    "Trajectory": "simulation.trajectory",
    **dict.fromkeys(("EnergyBalance", "MomentumBalance"), "simulation.balances"),
    **dict.fromkeys(
        ("DOP853", "RKMK4", "AdaptiveGauss", "Gauss", "Radau", "Variational"), "integrators.methods"
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
    "casadi_functions",
    "compare",
    "equations",
    "forces",
    "inspect",
    "lie",
    "load",
    "load_scene",
    "play",
    "plot",
    "plots",
    "read_recording",
    "save_film",
    "save_html",
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

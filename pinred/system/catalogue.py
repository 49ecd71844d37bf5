"""Robots that can be loaded by name: bundled robots and those of example-robot-data."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..common.errors import LoadError
from ..common.optional_packages import install_command
from .loops.loop import Constraint, parse_loops

INSTALL_ROBOTS = install_command("robots")


@dataclass(frozen=True)
class BundledRobot:
    """A robot that is bundled with pinred: one entry of robots/robots.toml.

    Attributes:
        name: Name of the robot.
        path: Path of its URDF file.
        group: Name of its symmetry group.
        description: Description of the robot in one line.
        gravity: Gravity in the world frame, (3,) [m/s²].
        initial: Generic initial state, with the keys x, xdot, xi and duration.
        balls: Whether hinges that meet at one point are merged into balls (see `load`).
        closed_form: Results that are known in closed form.
        source: Publication that describes the problem.
        loops: Closed kinematic loops.
    """

    name: str
    path: Path
    group: str
    description: str
    gravity: tuple[float, float, float]
    initial: dict[str, Any]
    balls: bool = False
    closed_form: str = ""
    source: str = ""
    loops: tuple[Constraint, ...] = ()


@dataclass(frozen=True)
class ExampleRobot:
    """A robot of example-robot-data.

    Attributes:
        urdf: Path of its URDF file.
        rotors: SRDF file with the rotor inertias, if the robot has one.
        build: Loader of the model, if the URDF file alone is not enough; the loader reads meshes.
    """

    urdf: Path
    rotors: Path | None
    build: Callable[[], Any] | None


def bundled_folder() -> Path:
    """Return the folder of bundled robots, in the installed package or in the checkout."""
    package = Path(__file__).parent.parent
    installed = package / "robots"
    return installed if installed.is_dir() else package.parent / "robots"


def bundled_robots() -> dict[str, BundledRobot]:
    """Return the bundled robots by name."""
    folder = bundled_folder()
    table = tomllib.loads((folder / "robots.toml").read_text(encoding="utf-8"))
    robots = {}
    for name, entry in table.items():
        path, gravity = folder / entry.pop("file"), tuple(entry.pop("gravity"))
        loops = parse_loops(entry.pop("loops", ()))
        robots[name] = BundledRobot(name=name, path=path, gravity=gravity, loops=loops, **entry)
    return robots


def has_example_robots() -> bool:
    """Return whether example-robot-data with its Python loaders is installed."""
    return find_spec("example_robot_data") is not None


def example_robots() -> tuple[str, ...]:
    """Return the names of the robots in example-robot-data; empty if it is not installed."""
    return tuple(sorted(_loaders())) if has_example_robots() else ()


def example_robot(name: str) -> ExampleRobot:
    """Return the files of a robot in example-robot-data.  Raises LoadError if it has no URDF."""
    import example_robot_data.utils as utils

    loader = _loaders()[name]
    if not loader.urdf_filename:
        raise LoadError(
            f"'{name}' is only available as {loader.sdf_filename}; load this file by its path"
        )

    def path(folder: str, file: str) -> Path:
        relative = Path(loader.path, folder, file)
        return Path(utils.getModelPath(str(relative))) / relative

    has_rotors = loader.srdf_filename and loader.has_rotor_parameters
    return ExampleRobot(
        urdf=path(loader.urdf_subpath, loader.urdf_filename),
        rotors=path(loader.srdf_subpath, loader.srdf_filename) if has_rotors else None,
        build=None if loader.__init__ is utils.RobotLoader.__init__ else loader,
    )


def _loaders() -> dict[str, Any]:
    from example_robot_data.robots_loader import ROBOTS

    return dict(ROBOTS)

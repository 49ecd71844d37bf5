"""View: options for drawing a motion.  Look: its colours and sizes, equal in all viewers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeAlias, TypedDict

from ...common.argument_kinds import checks_arguments
from ...common.arrays import positive
from ...common.errors import InputError
from ...system.find_robot_files import mesh_folders

PAGES = (".html", ".rrd")  # suffixes of files that play at any speed, in contrast to films
VIEWERS = {  # {name: description}
    "pinred": "pinred's page",
    "viser": "the page of viser, which the extra viser installs",
}
VIEWER = "pinred"  # the default viewer
FPS = 60.0  # default frames per second of playback
FILM_FPS = 25.0  # default frames per second of films, whole hundredths of a second as gifs have


ArrowLook: TypeAlias = tuple[str, float, float, float]


@dataclass(frozen=True)
class Look:
    """Colours "#rrggbb" and sizes of what pages and films draw; lengths are in radii of the robot.

    Attributes:
        background: Colours at the top and at the bottom, from 0 to 1.
        grid: Colour of the grid, from 0 to 1.
        grid_mark: Colour of the grid in the legend.
        ghost: Colour and opacity of the full simulation.
        inertia: Colour and opacity of the ellipsoid of the locked inertia.
        inertia_rings: Colour and opacity of its equators.
        sphere: Colour and opacity of the momentum sphere; its path has the same colour.
        sphere_rings: Colour and opacity of its equators.
        momentum: Of the momentum arrow: colour, radii of shaft and tip, and length of the tip.
        arrow_length: Largest length of the momentum arrow, and radius of the momentum sphere.
        gravity: The same of the gravity arrow.
        gravity_length: Length of the gravity arrow.
        axes: Colours of the axes x, y and z of frames.
        base_axes: Length and radius of the axes of the base.
        ball_axes: Length and radius of the axes of bodies on ball joints.
        ball: Colour and radius of the mark of a ball joint.
        mass: Colour and radius of the centre of mass; its trail has the same colour.
        impact: Colour and radius of the flash of an impact.
        fade: Time in which a flash fades, at the film's speed [s].
        field: Colours of the most negative and positive values of the curvature.
        point: Colour of the current point in the shape panel.
        ink: Colour of words and axes.
        fov: Vertical field of view [deg].
        margin: Distance of the camera, relative to the least one that shows everything.
        cramped: Least free area beside cards, relative to the window; in smaller ones, cards fold.
        least_area: Least free area for which the distance of the camera is computed.
    """

    background: tuple[Sequence[float], Sequence[float]] = ((0.70, 0.79, 0.88), (0.42, 0.52, 0.64))
    grid: Sequence[float] = (0.22, 0.30, 0.40)
    grid_mark: str = "#8a97a5"
    ghost: tuple[str, float] = ("#0072b2", 0.38)
    inertia: tuple[str, float] = ("#56b4e9", 0.1)
    inertia_rings: tuple[str, float] = ("#1f6fa8", 0.55)
    sphere: tuple[str, float] = ("#aa3377", 0.08)
    sphere_rings: tuple[str, float] = ("#8a6d80", 0.55)
    momentum: ArrowLook = ("#d55e00", 0.016, 0.05, 0.17)
    arrow_length: float = 1.25
    gravity: ArrowLook = ("#8c510a", 0.012, 0.048, 0.15)
    gravity_length: float = 0.5
    axes: tuple[str, str, str] = ("#cc3311", "#009e73", "#0055cc")
    base_axes: tuple[float, float] = (0.5, 0.013)
    ball_axes: tuple[float, float] = (0.13, 0.008)
    ball: tuple[str, float] = ("#7b4fa3", 0.035)
    mass: tuple[str, float] = ("#111111", 0.03)
    impact: tuple[str, float] = ("#d55e00", 0.1)
    fade: float = 0.25
    field: tuple[str, str] = ("#0072b2", "#d55e00")
    point: str = "#f0e442"
    ink: str = "#1d2733"
    fov: float = 30.0
    margin: float = 1.02
    cramped: float = 0.55
    least_area: float = 0.2


LOOK = Look()


@checks_arguments
@dataclass(frozen=True, kw_only=True)
class View:
    """Options for drawing a motion; raises InputError for invalid values.

    Attributes:
        ghost: Also draw the full simulation (ABA on the full state) next to the reduced one.
        speed: Seconds of the motion in one second of playback, initially.
        fps: Frames per second of playback; the page interpolates between them.
        pair: Names of two joints for the axes of the shape panel. If None, the two that move most
            without full rotations.
        sphere: Name of a joint, or "base": draw the sphere on which its body sees the conserved
            angular momentum.
        meshes: Draw the shapes of the robot's file; False draws ellipsoids of its inertias. Folders
            are searched for meshes of a URDF, in addition to those of `load`.
    """

    ghost: bool = False
    speed: float = 1.0
    fps: float = FPS
    pair: Sequence[str] | None = None
    sphere: str | None = None
    meshes: bool | str | Path | Sequence[str | Path] = True

    def __post_init__(self) -> None:
        if not isinstance(self.meshes, bool):
            object.__setattr__(self, "meshes", mesh_folders(self.meshes))
        for name in ("speed", "fps"):
            object.__setattr__(self, name, positive(getattr(self, name), name))
        if self.pair is not None:
            is_list = isinstance(self.pair, Iterable) and not isinstance(self.pair, str)
            pair = tuple(self.pair) if is_list else ()
            is_pair = len(pair) == 2 and all(isinstance(name, str) for name in pair)
            if not is_pair or pair[0] == pair[1]:
                raise InputError(f"pair must be the names of two joints, got {self.pair!r}")
            object.__setattr__(self, "pair", pair)


class ViewOptions(TypedDict, total=False):
    """Fields of View, for functions with `**options`."""

    ghost: bool
    speed: float
    fps: float
    pair: Sequence[str] | None
    sphere: str | None
    meshes: bool | str | Path | Sequence[str | Path]


def default_fps(out: Path | None) -> float:
    """Return the default frames per second of a file, or of a browser if there is no file."""
    return FPS if out is None or out.suffix in PAGES else FILM_FPS


def as_view(options: Mapping[str, Any], what: str) -> View:
    """Build a View from options; raise InputError for an unknown option."""
    names = [entry.name for entry in fields(View)]
    for option in options:
        if option not in names:
            raise InputError(f"{what} has no option '{option}'; the options are {', '.join(names)}")
    return View(**options)

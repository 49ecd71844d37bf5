"""View: options for drawing a motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypedDict

from ...common.argument_kinds import checks_arguments
from ...common.arrays import positive
from ...common.errors import InputError
from ...system.robot_files import mesh_folders

PAGES = (".html", ".rrd")  # suffixes of files that play at any speed, in contrast to films
VIEWERS = {  # {name: description}
    "pinred": "pinred's page",
    "viser": "the page of viser, which the extra viser installs",
}
VIEWER = "pinred"  # the default viewer
FPS = 60.0  # default frames per second of playback
FILM_FPS = 25.0  # default frames per second of films, whole hundredths of a second as gifs have


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

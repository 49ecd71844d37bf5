"""Recordings for the rerun viewer: the robot over time, its energy, momentum and shape."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from ...common.arrays import Array
from ...common.errors import OutputError, install_command, optional_package
from ...common.files import check_path, write_atomic
from ...common.waiting import Wait
from ...lie.rotations import rotation
from ..motion_source import MotionSource
from .colours_and_view_options import View
from .drawn_bodies import PALETTE, drawn_bodies, facets, vertex_normals
from .playback import Playback, playback
from .scene_nodes import Framing, Node, Part, camera, frame, scene_nodes
from .viser_player import refuse_pair

FOV = math.radians(55.0)  # vertical field of view of rerun's 3D view
ASPECT = 0.6  # smallest width of the 3D view, relative to its height, that shows everything
TIMELINE = "time"
_CENTRE = "centre of mass"
_PIXELS = -1.0  # radius of lines; negative radii are in pixels
_MISSING = f".rrd files need the package rerun-sdk (500 MB): {install_command('rerun')}"


@Wait("writes a recording for rerun")
def save_rrd(source: MotionSource, path: str | Path, view: View) -> int:
    """Write a motion as a recording for rerun; if this fails, an existing file is kept.

    Args:
        source: The motion.
        path: The .rrd file.
        view: Options of the drawing.
    Returns:
        Size of the file in bytes.
    Raises:
        InputError: An option or the suffix is invalid.
        MissingPackageError: rerun-sdk is not installed.
        OutputError: The file cannot be written.
    """
    path = check_path(path, (".rrd",))
    rerun = optional_package("rerun", _MISSING)
    refuse_pair(view, "a .rrd file has")
    film = playback(source, view)
    bodies = drawn_bodies(film.system, meshes=view.meshes)
    framing = frame(film, bodies)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "motion.rrd")
        nodes = scene_nodes(film, bodies, framing, view.speed)
        _Writer(rerun, film, file).write(nodes, framing, view)
        size = file.stat().st_size
        with file.open("rb") as content:
            write_atomic(path, lambda target: shutil.copyfileobj(content, target))
    return size


class _Writer:
    """A stream of rerun into a file."""

    def __init__(self, rerun: Any, film: Playback, file: Path) -> None:
        self._rerun, self._film = rerun, film
        self._stream = rerun.RecordingStream("pinred", recording_id=uuid4())
        self._stream.save(file)
        self._times = [rerun.TimeColumn(TIMELINE, duration=film.t)]

    def write(self, nodes: Sequence[Node], framing: Framing, view: View) -> None:
        """Write everything and close the file.

        Args:
            nodes: Objects of the film.
            framing: Framing of the film.
            view: Options of the drawing.
        Raises:
            OutputError: The environment variable RERUN disables rerun.
        """
        rerun, film = self._rerun, self._film
        if not rerun.is_enabled(self._stream):
            raise OutputError("rerun is disabled; remove the environment variable RERUN")
        self._stream.send_recording_name(film.system.name or "robot")
        self._log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._send(
            rerun.new_entity_path([_CENTRE]), rerun.Transform3D.columns(translation=film.com)
        )
        for node in nodes:
            self._write_node(node)
        plots = self._write_plots()
        self._stream.send_blueprint(self._blueprint(plots, framing, view))
        self._stream.flush()
        self._stream.disconnect()

    def _log(self, path: str, *contents: Any) -> None:
        self._stream.log(path, *contents, static=True, strict=True)

    def _send(self, path: str, columns: Any) -> None:
        self._stream.send_columns(path, self._times, columns, strict=True)

    def _write_node(self, node: Node) -> None:
        rerun, path = self._rerun, self._rerun.new_entity_path
        poses, at = node.placements, path([*node.path])
        if node.stretch is not None:
            moves = rerun.Transform3D.columns(
                translation=poses[:, :3], mat3x3=rotation(poses[:, 3:]) @ node.stretch
            )
            self._send(at, moves)
        elif np.ptp(poses, axis=0).any():
            moves = rerun.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, 3:])
            self._send(at, moves)
        else:
            self._log(at, self._transform(poses[0]))
        for k, part in enumerate(node.parts):
            entity = path([*node.path, str(k)])
            self._log(entity, self._transform(part.placement), self._mesh(part))
            if node.opacity is not None:
                tints = np.tile(part.colour, (len(node.opacity), 1))
                tints[:, 3] *= node.opacity
                self._send(entity, rerun.Mesh3D.columns(albedo_factor=_bytes_of(tints)))
        for k, line in enumerate(node.lines):
            strip = rerun.LineStrips3D([line.points], colors=[line.colour], radii=[_PIXELS])
            self._log(path([*node.path, f"line {k}"]), strip)
        if node.label:
            colour = node.parts[0].colour
            label = rerun.Points3D([np.zeros(3)], labels=[node.label], colors=[colour], radii=[0.0])
            self._log(path([*node.path, "label"]), label)

    def _transform(self, pose: Array) -> Any:
        quaternion = self._rerun.Quaternion(xyzw=pose[3:])
        return self._rerun.Transform3D(translation=pose[:3], quaternion=quaternion)

    def _mesh(self, part: Part) -> Any:
        mesh = facets(part.mesh) if part.flat else part.mesh
        return self._rerun.Mesh3D(
            vertex_positions=mesh.vertices, triangle_indices=mesh.faces,
            vertex_normals=vertex_normals(mesh), albedo_factor=part.colour,
        )  # fmt: skip

    def _write_plots(self) -> list[str]:
        """Write energy, momentum and shape over time; return the names of the plots."""
        film, system = self._film, self._film.system
        shape = system.space.chart(film.x)
        units = zip(system.shape_names, system.units, strict=True)
        plots = {
            "energy": [("energy", "J", film.energy)],
            film.momentum.words: [
                (axis, film.momentum.unit, film.momentum.vector[:, k])
                for k, axis in enumerate("xyz")
            ],
            "shape": [(name, unit, shape[:, k]) for k, (name, unit) in enumerate(units)],
        }
        for plot, curves in plots.items():
            for k, (name, unit, values) in enumerate(curves):
                path = self._rerun.new_entity_path([plot, name])
                colour = PALETTE[(k + 1) % len(PALETTE)]
                label = f"{name} [{unit}]"
                self._log(path, self._rerun.SeriesLines(names=label, colors=[colour]))
                self._send(path, self._rerun.Scalars.columns(scalars=values))
        return [plot for plot, curves in plots.items() if curves]

    def _blueprint(self, plots: Sequence[str], framing: Framing, view: View) -> Any:
        """Return the layout: a 3D view whose camera sees the robot, and the plots."""
        blueprint, follow = self._rerun.blueprint, framing.follow
        placed = camera(framing, FOV, follow=follow, aspect=ASPECT)
        space = blueprint.Spatial3DView(
            name=self._film.system.name or "robot",
            # Everything is drawn relative to the origin, so the centre of mass stays where it is.
            origin=self._rerun.new_entity_path([_CENTRE] if follow else []),
            contents=["+ /robot/**", "+ /full\\ simulation/**", "+ /overlays/**"],
            eye_controls=blueprint.EyeControls3D(
                position=placed.position, look_target=placed.target, eye_up=(0.0, 0.0, 1.0)
            ),
        )
        views = [
            blueprint.TimeSeriesView(name=plot, origin=self._rerun.new_entity_path([plot]))
            for plot in plots
        ]
        time = blueprint.TimePanel(
            timeline=TIMELINE, playback_speed=view.speed, play_state="playing", loop_mode="all"
        )
        layout = blueprint.Horizontal(space, blueprint.Vertical(*views), column_shares=[2.0, 1.0])
        return blueprint.Blueprint(layout, time, collapse_panels=True)


def _bytes_of(colours: Array) -> Array:
    """Return colours as numbers of 32 bits: red, green, blue and opacity, (F,)."""
    bits = np.round(255.0 * colours).astype(np.uint32)
    packed: Array = (bits << np.array([24, 16, 8, 0], dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
    return packed

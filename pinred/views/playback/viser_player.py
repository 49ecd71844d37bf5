"""ViserPlayer: a motion on viser's page, served to browsers on this machine only.

Pinocchio's ViserVisualizer draws neither ellipsoids nor capsules, and meshes only from files.  The
shapes of this player are those of pinred's own page.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from time import monotonic
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, install_command, optional_package
from ...lie.rotations import rotation
from ..motion_source import MotionSource
from .colours_and_view_options import View
from .drawn_bodies import drawn_bodies
from .page import HOST, Player, check_port
from .playback import playback
from .scene_nodes import (
    Framing,
    Node,
    Part,
    camera,
    frame,
    interpolate,
    interpolate_placements,
    scene_nodes,
)

FOV = math.radians(45.0)  # vertical field of view
_UPDATES = 60.0  # largest number of updates of the page per second
_FADE = 3.0  # distance at which the grid vanishes, relative to the distance of the camera
_MISSING = 'viewer="viser" needs the package viser: ' + install_command("viser")


class ViserPlayer(Player):
    """A motion on viser's page; it runs until close(), or the end of a `with` block.

    Attributes:
        url: Address of the page.
        server: The ViserServer, for adding objects to the scene below "/world".
    """

    def __init__(self, source: MotionSource, view: View, port: int | None = None) -> None:
        """Serve a motion.

        Args:
            source: The motion.
            view: Options of the drawing.
            port: Port; an unused port if None.
        Raises:
            InputError: An option is invalid, or the port is taken.
            MissingPackageError: viser is not installed.
        """
        viser = optional_package("viser", _MISSING)
        check_port(port)
        refuse_pair(view, 'viewer="viser" has')
        film = playback(source, view)
        bodies = drawn_bodies(film.system, meshes=view.meshes)
        self._film, self._framing = film, frame(film, bodies)
        with _silent():
            self.server: Any = viser.ViserServer(
                host=HOST, port=port or 0, label=film.system.name or "robot", verbose=False
            )
        if port is not None and self.server.get_port() != port:
            self.server.stop()
            raise InputError(f"port {port} is taken; choose another port, or none")
        self.url = f"http://{HOST}:{self.server.get_port()}/"
        self._lock, self._ended = threading.RLock(), threading.Event()
        nodes = scene_nodes(film, bodies, self._framing, view.speed)
        self._nodes = nodes
        self._placements = np.stack([node.placements for node in nodes], axis=1)
        self._root = self.server.scene.add_frame("/world", show_axes=False)
        self._names = [node.path for node in nodes]
        self._handles, self._meshes = [], []
        for node in nodes:
            handle, meshes = _draw(self.server.scene, node)
            self._handles.append(handle)
            self._meshes.append(meshes)
        _draw_grid(self.server.scene, self._framing)
        self._add_controls(view, bodies.note)
        self._aim()
        self.server.on_client_connect(self._fit)
        self.seek(float(film.t[0]))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def seek(self, time: float) -> None:
        """Show the motion at a time [s]."""
        film = self._film
        with self._lock, self.server.atomic():
            self._time = float(np.clip(time, film.t[0], film.t[-1]))
            placements = interpolate_placements(film.t, self._placements, self._time)
            for k, placement in enumerate(placements):
                handle = self._handles[k]
                handle.position, handle.wxyz = placement[:3], placement[[6, 3, 4, 5]]
                self._change(self._nodes[k], self._meshes[k])
            com = interpolate(film.t, film.com, self._time)
            self._root.position = -com if self._follow.value else np.zeros(3)
            self._slider.value = self._time

    def _change(self, node: Node, meshes: Sequence[Any]) -> None:
        """Deform the meshes of a node, and set their opacity."""
        for part, mesh in zip(node.parts, meshes, strict=True):
            if node.stretch is not None:
                stretch = interpolate(self._film.t, node.stretch, self._time)
                mesh.vertices = (_placed(part) @ stretch.T).astype(np.float32)
            if node.opacity is not None:
                opacity = float(interpolate(self._film.t, node.opacity, self._time))
                mesh.visible = opacity > 0.0
                mesh.opacity = part.colour[3] * opacity

    def play(self) -> None:
        """Let the time run while a browser shows the page."""
        self._playing, self._button.label = True, "pause"

    def pause(self) -> None:
        """Stop the time."""
        self._playing, self._button.label = False, "play"

    def close(self) -> None:
        """Stop serving and free the port."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            with _silent():
                self.server.stop()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" title="pinred" style="width:100%;height:520px"></iframe>'

    def _run(self) -> None:
        """Advance the time at the chosen speed."""
        last = monotonic()
        while not self._ended.wait(1.0 / _UPDATES):
            now = monotonic()
            by, last = now - last, now
            if self._playing and self.server.get_clients():
                self._advance(by * self._speed.value)

    def _advance(self, by: float) -> None:
        start, end = float(self._film.t[0]), float(self._film.t[-1])
        time = self._time + by
        if time > end:
            if self._loop.value:
                time = start
            else:
                self.pause()
        self.seek(time)

    def _add_controls(self, view: View, note: str) -> None:
        """Add the controls of time, camera and overlays to viser's panel."""
        gui, film = self.server.gui, self._film
        start, end = float(film.t[0]), float(film.t[-1])
        step = (end - start) / 1000.0
        self._slider = gui.add_slider("time [s]", start, end, step, start)
        self._button = gui.add_button("pause")
        self._speed = gui.add_number("speed", view.speed, min=0.0)
        self._loop = gui.add_checkbox("loop", True)
        self._follow = gui.add_checkbox("follow", self._framing.follow)
        self._playing = True
        self._slider.on_update(self._slide)
        self._button.on_click(lambda _: self.pause() if self._playing else self.play())
        self._follow.on_update(lambda _: self._aim(move=True))
        for node, handle in zip(self._nodes, self._handles, strict=True):
            if node.path[0] == "overlays":
                self._add_switch(node.path[1], handle)
        if note:
            gui.add_markdown(note)

    def _slide(self, event: Any) -> None:
        if event.client is not None:  # the user, not `seek`, has moved the slider
            self.pause()
            self.seek(event.target.value)

    def _aim(self, *, move: bool = False) -> None:
        """Place the initial camera, and with `move` the cameras of all browsers."""
        placed = camera(self._framing, FOV, follow=self._follow.value)
        initial = self.server.initial_camera
        initial.position, initial.look_at = placed.position, placed.target
        initial.fov, initial.near, initial.far = FOV, 0.01 * placed.distance, 99 * placed.distance
        if move:
            self.seek(self._time)
            for client in self.server.get_clients().values():
                self._look(client, client.camera.aspect)

    def _fit(self, client: Any) -> None:
        """Move the camera of a new browser back if its window is higher than wide."""
        if client.camera.aspect < 1.0:
            self._look(client, client.camera.aspect)

    def _look(self, client: Any, aspect: float) -> None:
        placed = camera(self._framing, FOV, follow=self._follow.value, aspect=aspect)
        client.camera.position, client.camera.look_at = placed.position, placed.target

    def _add_switch(self, name: str, handle: Any) -> None:
        shown = self.server.gui.add_checkbox(name, True)
        shown.on_update(lambda _: setattr(handle, "visible", shown.value))


@contextmanager
def _silent() -> Iterator[None]:
    """Let viser print nothing: it prints through rich, even if it is not verbose."""
    console = import_module("rich").get_console()
    quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = quiet


def refuse_pair(view: View, subject: str) -> None:
    """Raise InputError for the option `pair`, which is for the shape panel of pinred's page."""
    if view.pair is not None:
        raise InputError(f"pair: {subject} no shape panel; leave out pair=, or use pinred's page")


def _draw(scene: Any, node: Node) -> tuple[Any, list[Any]]:
    """Add a node with its shapes to viser's scene; return its handle, and those of its meshes."""
    name = "/".join(["/world", *(part.replace("/", "_") for part in node.path)])
    handle, meshes = scene.add_frame(name, show_axes=False), []
    for k, part in enumerate(node.parts):
        opacity, rigid = part.colour[3], node.stretch is None
        mesh = scene.add_mesh_simple(
            f"{name}/{k}", part.mesh.vertices if rigid else _placed(part), part.mesh.faces,
            color=_bytes(part.colour[:3]), opacity=opacity if opacity < 1.0 else None,
            cast_shadow=part.lit and opacity == 1.0, flat_shading=part.flat, side="double",
            position=part.placement[:3] if rigid else np.zeros(3),
            wxyz=part.placement[[6, 3, 4, 5]] if rigid else (1.0, 0.0, 0.0, 0.0),
        )  # fmt: skip
        meshes.append(mesh)
    for k, line in enumerate(node.lines):
        if node.stretch is None:
            pairs = np.stack([line.points[:-1], line.points[1:]], axis=1)
            look = {"thickness": 2.0, "thickness_units": "screen"}
            scene.add_line_segments(f"{name}/line {k}", pairs, _bytes(line.colour[:3]), **look)
    if node.label:
        scene.add_label(f"{name}/label", node.label)
    return handle, meshes


def _placed(part: Part) -> Array:
    """Return the points of a part in the frame of its node, (V, 3) [m]."""
    turn = rotation(part.placement[3:])
    return np.asarray(part.mesh.vertices @ turn.T + part.placement[:3])


def _draw_grid(scene: Any, framing: Framing) -> None:
    x, y, z = framing.normal
    rotation = np.array([1.0 + z, -y, x, 0.0])  # from the z axis to the normal
    distance = camera(framing, FOV, follow=framing.follow).distance
    scene.add_grid(
        "/world/grid", plane="xy", infinite_grid=True, position=framing.grid,
        wxyz=rotation / np.linalg.norm(rotation), fade_distance=_FADE * distance,
        cell_size=framing.cell, section_size=5.0 * framing.cell,
    )  # fmt: skip


def _bytes(colour: tuple[float, ...]) -> tuple[int, ...]:
    return tuple(round(255.0 * channel) for channel in colour)

"""Films: frames seen by a camera, with the cards of the page, as PNG pictures, mp4 or gif."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import PIL.Image  # a dependency of meshcat
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont  # a dependency of meshcat
from PIL.Image import Image as Picture

from ...common.arrays import Array
from ...common.errors import InputError, OutputError, install_command
from ...common.files import check_path, write_atomic
from ...common.waiting import Progress, quiet, say, shown
from ...lie.rotations import rotation
from ..motion_source import MotionSource
from .colours_and_view_options import LOOK, View
from .drawn_bodies import drawn_bodies, face_normals, vertex_normals
from .playback import ShapePanel, frame_times, playback, shape_panel
from .rasteriser import (
    FLAT,
    SIDE,
    SMOOTH,
    UNLIT,
    Samples,
    average_samples,
    draw_mesh,
    draw_picture,
    draw_segments,
)
from .scene_nodes import (
    Node,
    Part,
    camera,
    colour_of,
    frame,
    interpolate,
    interpolate_placements,
    scene_nodes,
)

SIZE = (960, 720)
MOST_FRAMES, MOST_FPS = 20_000, 120
_MEASURED = 5  # number of frames whose time is measured to estimate that of all
_PATIENCE = 2.0  # least remaining time that is announced [s]
GIF_FPS = (0.01, 50.0)  # gif delays are multiples of 0.01 s; browsers slow delays below 0.02 s
_LEVEL = 3  # of the compression of PNG pictures; higher levels take much longer
SUFFIXES = (".mp4", ".gif", ".png")


def save_film(
    source: MotionSource,
    path: str | Path,
    view: View,
    *,
    size: Sequence[int] = SIZE,
    progress: Progress | None = None,
) -> int:
    """Write a film in the format that the suffix of the path selects.

    Args:
        source: The motion.
        path: film.mp4 (needs ffmpeg), film.gif (up to 50 frames per second), or film.png for frames
            film_0000.png and so on. Existing frames of a longer film are an error.
        view: Options; its fps and speed determine the frames.
        size: Width and height in pixels, even.
        progress: Called with the completed fraction.
    Returns:
        Number of frames.
    Raises:
        InputError: An option is invalid, or ffmpeg is not installed.
        OutputError: Rendering or writing fails.
    """
    path = check_path(path, SUFFIXES)
    pixels = tuple(size) if isinstance(size, Sequence) else ()
    if len(pixels) != 2 or not all(n in range(16, 4097, 2) for n in pixels):
        raise InputError(f"size must be two even numbers of pixels, 16 to 4096, got {size!r}")
    if view.fps > MOST_FPS:
        raise InputError(f"fps must be at most {MOST_FPS} in a film, got {view.fps:g}")
    if path.suffix == ".gif" and not GIF_FPS[0] <= view.fps <= GIF_FPS[1]:
        raise InputError(
            f"fps must be from {GIF_FPS[0]:g} to {GIF_FPS[1]:g} in a gif, whose frames last whole "
            f"hundredths of a second, got {view.fps:g}; an .mp4 takes up to {MOST_FPS}"
        )
    times = frame_times(source, view, MOST_FRAMES, even=True)
    if path.suffix == ".png":
        check_frames(path, len(times))
    encoder = find_ffmpeg() if path.suffix == ".mp4" else ""
    try:
        with (
            _tidy_at_sigterm(),
            shown(progress, "film", len(times), "frames", "renders a film", reports=True) as report,
            closing(
                _draw_frames(
                    source,
                    times,
                    (pixels[0], pixels[1]),
                    view,
                    _announcing(report, len(times)) if progress is None else report or quiet,
                )
            ) as shots,
        ):
            if path.suffix == ".png":
                return write_frames(path, shots)
            if path.suffix == ".gif":
                return write_gif(path, shots, view.fps)
            return _write_mp4(path, shots, view.fps, encoder, pixels)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error


def _announcing(
    progress: Progress | None, count: int, clock: Callable[[], float] = time.monotonic
) -> Progress:
    """Return a progress function that says once, after a few frames, how long all of them take.

    Args:
        progress: Called with the completed fraction; may be None.
        count: Number of frames.
        clock: Function that returns a time [s].
    """
    began: list[float] = []

    def report(part: float) -> None:
        frames = round(part * count)
        if not began:  # The first frame includes the start of the page.
            began.append(clock())
        elif frames == 1 + _MEASURED:
            remaining = (clock() - began[0]) * (count - frames) / _MEASURED
            if remaining > _PATIENCE:
                say(f"the {count} frames of the film take about {remaining:.0f} s")
        if progress is not None:
            progress(part)

    return report


def find_ffmpeg() -> str:
    """Return the path of ffmpeg; raise InputError with instructions if it is not installed."""
    if path := shutil.which("ffmpeg"):
        return path
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise InputError(
            f"mp4 films need ffmpeg: apt-get install ffmpeg, or {install_command('film')}; "
            "a .gif or .png needs neither"
        ) from None


class _Terminated(BaseException):
    """Raised inside the block of `_tidy_at_sigterm` when SIGTERM arrives."""


@contextmanager
def _tidy_at_sigterm() -> Iterator[None]:
    """Turn SIGTERM into an exception inside the block, so that files are cleaned up first.

    This applies only in the main thread, and only if SIGTERM has its default handler.

    Raises:
        _Terminated: SIGTERM was received; the process ends.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ):
        yield
        return

    def raise_terminated(number: int, frame: FrameType | None) -> None:
        del frame
        signal.signal(number, signal.SIG_IGN)  # ignore further signals during cleanup
        raise _Terminated

    signal.signal(signal.SIGTERM, raise_terminated)
    try:
        yield
    except _Terminated:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTERM)
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _draw_frames(
    source: MotionSource, times: Array, size: tuple[int, int], view: View, progress: Progress
) -> Generator[Picture]:
    """Yield pictures of a motion at some times."""
    frames = Frames(source, view, size)
    for k, t in enumerate(times.tolist(), start=1):
        yield frames.draw(t)
        progress(k / len(times))


def _frame_path(path: Path, k: int) -> Path:
    return path.with_name(f"{path.stem}_{k:04d}.png")


def check_frames(path: Path, count: int) -> None:
    """Check that frames can be written and that no frames of a longer film exist.

    Old frames of a longer film would look like a continuation of the new film. They are not
    removed; the caller gets an error instead.

    Args:
        path: Path of the film.
        count: Number of frames.
    Raises:
        InputError: A frame cannot be written, or frames of a longer film exist.
    """
    for k in range(count):
        if _frame_path(path, k).is_dir():
            raise InputError(f"cannot write '{_frame_path(path, k)}': it is a folder")
    name = re.compile(re.escape(path.stem) + r"_(\d{4,})\.png", re.ASCII)
    matches = (name.fullmatch(entry) for entry in os.listdir(path.parent))
    later = sorted(int(match[1]) for match in matches if match and int(match[1]) >= count)
    if later:
        more = f" and {len(later) - 1} more" if len(later) > 1 else ""
        raise InputError(
            f"'{_frame_path(path, later[0])}'{more} of a longer film would follow the {count} new "
            "frames; remove the old frames, or choose another name"
        )


def write_frames(path: Path, shots: Iterator[Picture]) -> int:
    """Write pictures as film_0000.png and so on; on failure, no frame is written.

    The frames are written to a temporary folder and moved when all are complete. If moving
    fails, the old frames are restored.

    Args:
        path: Path of the film.
        shots: The pictures.
    Returns:
        Number of frames.
    """
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        new, old = Path(folder, "new"), Path(folder, "old")
        new.mkdir()
        old.mkdir()
        count = 0
        for count, shot in enumerate(shots, start=1):
            shot.save(_frame_path(new / path.name, count - 1), compress_level=_LEVEL)
        check_frames(path, count)
        targets: list[Path] = []
        try:
            for k in range(count):
                targets.append(_frame_path(path, k))
                if targets[k].exists():
                    targets[k].replace(old / targets[k].name)
                _frame_path(new / path.name, k).replace(targets[k])
        except BaseException:
            for target in targets:
                if not (new / target.name).exists():
                    target.unlink()
                if (old / target.name).exists():
                    (old / target.name).replace(target)
            raise
    return count


def write_gif(path: Path, shots: Iterator[Picture], fps: float) -> int:
    """Write pictures as a gif.

    Frame durations are whole hundredths of a second.  They vary, so that each frame ends as close
    to its time as possible.

    Args:
        path: The file.
        shots: The pictures.
        fps: Frames per second.
    Returns:
        Number of frames.
    """
    method = (
        PIL.Image.Quantize.FASTOCTREE
    )  # the default method spends most colours on the background
    pictures = [shot.quantize(method=method) for shot in shots]
    ends = [round(100.0 * k / fps) for k in range(len(pictures) + 1)]
    write_atomic(
        path,
        lambda file: pictures[0].save(
            file, format="GIF", save_all=True, append_images=pictures[1:],
            duration=[10 * (b - a) for a, b in pairwise(ends)], loop=0,
        ),
    )  # fmt: skip
    return len(pictures)


def _write_mp4(
    path: Path, shots: Iterator[Picture], fps: float, encoder: str, size: Sequence[int]
) -> int:
    with tempfile.TemporaryDirectory() as folder:
        film, count = Path(folder, "film.mp4"), 0
        command = [
            encoder, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
            "-s", f"{size[0]}x{size[1]}", "-framerate", f"{fps:g}", "-i", "-",
            "-c:v", "libx264", "-preset", "veryfast", "-pix_fmt", "yuv420p",
            "-crf", "20", "-movflags", "+faststart", str(film),
        ]  # fmt: skip
        with (
            Path(folder, "log").open("w+", encoding="utf-8", errors="replace") as log,
            subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log) as ffmpeg,
        ):
            try:
                for shot in shots:
                    ffmpeg.stdin.write(shot.tobytes())  # type: ignore[union-attr]
                    count += 1
                ffmpeg.stdin.close()  # type: ignore[union-attr]
            except BrokenPipeError:
                pass  # the log is reported below
            except BaseException:
                ffmpeg.kill()
                raise
            if code := ffmpeg.wait():
                log.seek(0)
                lines = log.read().strip().splitlines()
                raise OutputError(f"ffmpeg failed: {lines[-1] if lines else f'code {code}'}")
        write_atomic(path, lambda file: file.write(film.read_bytes()))
    return count


_FOV = math.radians(LOOK.fov)
_BLACK = colour_of(LOOK.mass[0])[:3]
_INK = tuple(bytes.fromhex(LOOK.ink[1:]))
_MARGIN, _ROUND = 10, 6  # of cards [px]
_PAPER = (255, 255, 255, 219)  # colour and opacity of cards
_CLOCK = 36  # height of the card of the time [px]
_PANEL = (211, 192)  # size of the card of the shape panel [px]
_FIELD = (48, 36, 152, 129)  # left, top, width and height of its field [px]
_LINE = 1.2  # width of lines [px]


class Frames:
    """Frames of a motion, drawn at any of its times."""

    def __init__(self, source: MotionSource, view: View, size: tuple[int, int]) -> None:
        """Compute everything that all frames share.

        Args:
            source: The motion.
            view: Options of the drawing.
            size: Width and height in pixels.
        """
        self.size = size
        width, height = size
        film = playback(source, view)
        bodies = drawn_bodies(film.system, meshes=view.meshes)
        self._film, self._framing = film, frame(film, bodies)
        nodes = scene_nodes(film, bodies, self._framing, view.speed)
        # Opaque parts hide what is behind them, so they are drawn before transparent parts.
        self._nodes = sorted(nodes, key=lambda node: (node.order, _is_transparent(node)))
        self._placements = np.stack([node.placements for node in self._nodes], axis=1)
        self._parts = [[_Mesh(part) for part in node.parts] for node in self._nodes]
        most = max(len(mesh.points) for meshes in self._parts for mesh in meshes)
        self._corners = np.empty((max(most, 4), 4))
        self._samples = np.empty((SIDE * height, SIDE * width), dtype=np.int64)
        self._pixels = np.empty((height, width), dtype=np.int64)
        self._background = _gradient(*self._samples.shape)
        self._grid = _grid_lines(self._framing)
        self._panel = shape_panel(film.system, film.x, film.xdot, view.pair)
        area = self._free_area()
        if min(area[2:]) < LOOK.cramped * min(size):
            self._panel = None
            area = self._free_area()
        self._card = None if self._panel is None else _panel_card(self._panel)
        self._axis = (area[0] + 0.5 * area[2], area[1] + 0.5 * area[3])
        aspect = max(min(area[2:]) / height, LOOK.least_area)
        self._camera = camera(self._framing, _FOV, follow=self._framing.follow, aspect=aspect)

    @property
    def triangles(self) -> int:
        """Number of triangles of all shapes."""
        return sum(len(mesh.faces) for meshes in self._parts for mesh in meshes)

    def draw(self, t: float) -> Image.Image:
        """Return the picture at a time [s]."""
        film = self._film
        self._samples[:] = self._background
        com = interpolate(film.t, film.com, t)
        eye = self._camera.position + (com if self._framing.follow else 0.0)
        self._view = _view(eye, self._camera.target - self._camera.position, self._lens())
        placements = interpolate_placements(film.t, self._placements, t)
        behind = True
        for node, meshes, placement in zip(self._nodes, self._parts, placements, strict=True):
            if behind and (node.order or _is_transparent(node)):
                self._draw_grid(com)
                behind = False
            self._draw_node(node, meshes, placement, t)
        self._draw_cards(t)
        average_samples(self._samples, self._pixels)
        data = self._pixels.astype("<i4").tobytes()
        return Image.frombytes("RGB", self.size, data, "raw", "BGRX")

    def _free_area(self) -> tuple[int, int, int, int]:
        """Return left, top, width and height of the largest area without cards [px]."""
        width, height = self.size
        above_clock = height - _MARGIN - _CLOCK
        if self._panel is None:
            return 0, 0, width, above_clock
        beside, above = _MARGIN + _PANEL[0], height - _MARGIN - _PANEL[1]
        areas = [(0, 0, width, above), (beside, 0, width - beside, above_clock)]
        return max(areas, key=lambda area: min(area[2:]))

    def _lens(self) -> Array:
        """Return the focal length, the column and the row of the camera's axis in samples."""
        focal = 0.5 * self.size[1] / math.tan(0.5 * _FOV)
        return SIDE * np.array([focal, *self._axis])

    def _draw_node(self, node: Node, meshes: list[_Mesh], placement: Array, t: float) -> None:
        film, over = self._film, node.order > 0
        opacity = 1.0 if node.opacity is None else float(interpolate(film.t, node.opacity, t))
        if opacity == 0.0:
            return
        turn = rotation(placement[3:])
        if node.stretch is not None:
            turn = turn @ interpolate(film.t, node.stretch, t)
        for mesh in meshes:
            world = np.empty((3, 4))
            world[:, :3] = turn @ mesh.turn
            world[:, 3] = placement[:3] + turn @ mesh.at
            colour = mesh.colour * (1.0, 1.0, 1.0, opacity)
            draw_mesh(
                self._samples, self._corners, mesh.points, mesh.normals, mesh.faces, world,
                _turn_of_normals(world), self._view, colour, mesh.kind, over,
            )  # fmt: skip
        for line in node.lines:
            points = line.points
            if line.grows:
                k = int(np.searchsorted(film.t, t, side="right"))
                points = np.vstack([points[:k], interpolate(film.t, points, t)])
            points = placement[:3] + points @ turn.T
            ends = np.stack([points[:-1], points[1:]], axis=1)
            self._draw_lines(ends, np.full(len(ends), line.colour[3]), line.colour[:3], over)
        if node.label:
            self._draw_label(node, placement[:3])

    def _draw_lines(
        self, ends: Array, opacities: Array, colour: tuple[float, ...], over: bool
    ) -> None:
        ink = np.array([*colour, 1.0]) * (255.0, 255.0, 255.0, 1.0)
        draw_segments(
            self._samples, self._corners, ends, opacities, self._view, ink, SIDE * _LINE, over
        )

    def _draw_label(self, node: Node, at: Array) -> None:
        """Draw the label of a node at its place in the picture."""
        right, down, ahead = self._view[:3] @ (at - self._view[3])
        at_pixel = self._view[4, 1:] + self._view[4, 0] * np.array([right, down]) / ahead
        column, row = float(at_pixel[0]), float(at_pixel[1])
        red, green, blue = (round(255.0 * channel) for channel in node.parts[0].colour[:3])
        picture = _written(node.label, 22, (red, green, blue))
        middle = (round(row - 0.5 * picture.shape[0]), round(column - 0.5 * picture.shape[1]))
        draw_picture(self._samples, picture, *middle)

    def _draw_grid(self, com: Array) -> None:
        """Draw the grid, which follows the camera in steps of whole squares."""
        framing = self._framing
        lines, opacities = self._grid
        if not framing.follow:
            self._draw_lines(
                framing.grid + framing.wide * lines, opacities, tuple(LOOK.grid), False
            )
            return
        by = com - framing.middle
        on_normal = framing.normal * (by @ framing.normal)
        wall = abs(framing.normal[2]) < 0.5
        row, column = _grid_axes(framing)
        steps = framing.cell * np.round([by @ row / framing.cell, by @ column / framing.cell])
        steps = steps @ np.array([row, column])
        at = framing.grid + steps + (on_normal if wall else 0.0)
        self._draw_lines(at + lines, opacities, tuple(LOOK.grid), False)

    def _draw_cards(self, t: float) -> None:
        """Draw the shape panel with the path so far, and the time."""
        width, height = self.size
        words = _clock(f"{t:.2f} of {self._film.t[-1]:.2f} s")
        row = SIDE * (height - _MARGIN) - words.shape[0]
        draw_picture(self._samples, words, row, SIDE * (width - _MARGIN) - words.shape[1])
        if self._panel is None or self._card is None:
            return
        left, top = _MARGIN, height - _MARGIN - _PANEL[1]
        draw_picture(self._samples, self._card, SIDE * top, SIDE * left)
        film = self._film
        k = int(np.searchsorted(film.t, t, side="right"))
        path = np.vstack([self._panel.path[:k], interpolate(film.t, self._panel.path, t)])
        points = _in_field(self._panel, path) + np.array([left, top])
        self._draw_flat(points, 1.4, _BLACK)
        angle = np.linspace(0.0, 2.0 * np.pi, 25)
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        self._draw_flat(points[-1] + 1.6 * circle, 3.2, colour_of(LOOK.point)[:3])
        self._draw_flat(points[-1] + 3.2 * circle, 1.0, _BLACK)

    def _draw_flat(self, points: Array, width: float, colour: tuple[float, float, float]) -> None:
        """Draw a line through points of the picture, (N, 2) [px]."""
        flat = np.zeros((6, 3))
        flat[:3] = np.eye(3)
        flat[4, 0], flat[5, 0] = SIDE, 0.5  # a camera that sees column, row, 1 as they are
        spatial = np.column_stack([points, np.ones(len(points))])
        ends = np.stack([spatial[:-1], spatial[1:]], axis=1)
        ink = np.array([*colour, 1.0]) * (255.0, 255.0, 255.0, 1.0)
        draw_segments(
            self._samples, self._corners, ends, np.ones(len(ends)), flat, ink, SIDE * width, True
        )


class _Mesh:
    """A part of a node as arrays for the rasteriser."""

    def __init__(self, part: Part) -> None:
        # Copies are writeable, so the code is compiled for one kind of arrays.
        self.points = np.array(part.mesh.vertices, dtype=float, order="C")
        self.faces = np.array(part.mesh.faces, dtype=np.int64, order="C")
        self.kind = UNLIT if not part.lit else FLAT if part.flat else SMOOTH
        self.normals = face_normals(part.mesh) if part.flat else vertex_normals(part.mesh)
        self.turn, self.at = rotation(part.placement[3:]), part.placement[:3]
        self.colour = np.array(part.colour) * (255.0, 255.0, 255.0, 1.0)


def _is_transparent(node: Node) -> bool:
    return any(part.colour[3] < 1.0 for part in node.parts) or not node.parts


def _turn_of_normals(world: Array) -> Array:
    """Return the matrix that maps normals of a surface to normals of the mapped surface."""
    turn = world[:, :3]
    return np.ascontiguousarray(np.cross(turn[[1, 2, 0]], turn[[2, 0, 1]]))  # cofactors


def _view(eye: Array, ahead: Array, lens: Array) -> Array:
    """Return the camera's rows for the rasteriser, with z upwards.

    Args:
        eye: Position, (3,) [m].
        ahead: Vector to a point in the middle of the picture, (3,) [m].
        lens: Focal length, column and row of the axis in samples, (3,).
    Returns:
        The rows, (6, 3).
    """
    distance = float(np.linalg.norm(ahead))
    forward = ahead / distance
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    near = np.array([distance / 1000.0, 0.0, 0.0])
    return np.array([right, np.cross(forward, right), forward, eye, lens, near])


def _gradient(rows: int, columns: int) -> Samples:
    """Return the samples of the background."""
    share = (np.arange(rows) + 0.5)[:, None] / rows
    top, bottom = map(np.array, LOOK.background)
    colours = np.round(255.0 * ((1.0 - share) * top + share * bottom))
    packed = colours.astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    return np.ascontiguousarray(np.broadcast_to(packed[:, None], (rows, columns)))


def _grid_axes(framing: Any) -> tuple[Array, Array]:
    """Return the directions of the rows and columns of the grid."""
    row = np.cross([0.0, 0.0, 1.0], framing.normal)
    if np.linalg.norm(row) < 0.5:
        row = np.array([1.0, 0.0, 0.0])
    return row, np.cross(framing.normal, row)


def _grid_lines(framing: Any) -> tuple[Array, Array]:
    """Return the sides of the squares, (N, 2, 3) [m], and their opacities, which fade outwards."""
    row, column = _grid_axes(framing)
    n = framing.cells
    values = framing.cell * (np.arange(n + 1) - 0.5 * n)
    across, begin = (
        values_of_axis.ravel() for values_of_axis in np.meshgrid(values, values[:-1], indexing="ij")
    )
    one = np.stack([across, begin], axis=1), np.stack([across, begin + framing.cell], axis=1)
    flat = np.concatenate([np.stack(one, axis=1), np.stack(one, axis=1)[..., ::-1]])
    middle = flat.mean(axis=1)
    opacities = 1.0 - (middle**2).sum(axis=1) / values[-1] ** 2
    visible = opacities > 0.0
    return flat[visible] @ np.array([row, column]), opacities[visible]


@cache
def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def _packed(image: Image.Image) -> Samples:
    """Return a picture for `draw_picture`."""
    red, green, blue, opacity = np.moveaxis(np.asarray(image.convert("RGBA"), dtype=np.int64), 2, 0)
    packed: Samples = np.ascontiguousarray(opacity << 24 | red << 16 | green << 8 | blue)
    return packed


@cache
def _written(text: str, height: int, colour: tuple[int, int, int]) -> Samples:
    """Return a text on a transparent picture."""
    font = _font(SIDE * height)
    left, top, right, bottom = font.getbbox(text)
    size = (math.ceil(right - left) + 2, math.ceil(bottom - top) + 2)
    image = Image.new("RGBA", size, (*colour, 0))
    ImageDraw.Draw(image).text((1 - left, 1 - top), text, font=font, fill=(*colour, 255))
    return _packed(image)


def _empty_card(width: float, height: float) -> Image.Image:
    image = Image.new("RGBA", (round(SIDE * width), round(SIDE * height)), (255, 255, 255, 0))
    box = (0, 0, image.width - 1, image.height - 1)
    ImageDraw.Draw(image).rounded_rectangle(box, SIDE * _ROUND, fill=_PAPER)
    return image


def _clock(text: str) -> Samples:
    """Return a card with the time, as wide as its text."""
    font = _font(SIDE * 13)
    image = _empty_card(font.getlength(text) / SIDE + 22, _CLOCK)
    middle = (image.width // 2, image.height // 2)
    ImageDraw.Draw(image).text(middle, text, font=font, fill=_INK, anchor="mm")
    return _packed(image)


def _in_field(panel: ShapePanel, path: Array) -> Array:
    """Return points of the shape plane as pixels of the panel, (N, 2)."""
    left, top, width, height = _FIELD
    share = (path - panel.low) / (panel.high - panel.low)
    return np.column_stack([left + width * share[:, 0], top + height * (1.0 - share[:, 1])])


def _panel_card(panel: ShapePanel) -> Samples:
    """Return the card of the shape panel: the field with its colour bar, the axes and the path."""
    image = _empty_card(*_PANEL)
    pen, font = ImageDraw.Draw(image), _font(SIDE * 9)
    left, top, width, height = (SIDE * n for n in _FIELD)
    if panel.components:
        field = panel.field[0]
        most = max(float(np.abs(field).max()), 1e-300)
        colours = Image.fromarray(_colours(field / most).swapaxes(0, 1)[::-1])
        image.paste(colours.resize((width, height), Image.Resampling.BICUBIC), (left, top))
        bound = f"{most:.2g}"
        bar = _colours(np.linspace(-1.0, 1.0, 41 * SIDE))[None].repeat(SIDE * 7, axis=0)
        level, start = SIDE * 16, left + round(font.getlength(f"-{bound} "))
        image.paste(Image.fromarray(bar), (start, level - SIDE * 3))
        pen.text((left, level), f"-{bound}", font=font, fill=_INK, anchor="lm")
        pen.text((start + 43 * SIDE, level), f"+{bound}", font=font, fill=_INK, anchor="lm")
        name = panel.components[0].partition(" [")[0]
        pen.text((left + width, level), name, font=font, fill=_INK, anchor="rm")
    pen.rectangle((left, top, left + width, top + height), outline=_INK)
    below, beside = top + height + 3 * SIDE, left - 3 * SIDE
    for value, where, anchor in (
        (panel.low[0], (left, below), "la"),
        (panel.high[0], (left + width, below), "ra"),
        (panel.low[1], (beside, top + height), "rs"),
        (panel.high[1], (beside, top), "ra"),
    ):
        pen.text(where, f"{float(value):.2g}", font=font, fill=_INK, anchor=anchor)
    pen.text(
        (left + width // 2, below + 9 * SIDE), panel.labels[0], font=font, fill=_INK, anchor="ma"
    )
    label = Image.new("RGBA", (height, 12 * SIDE), (*_INK, 0))
    middle = (height // 2, 6 * SIDE)
    ImageDraw.Draw(label).text(middle, panel.labels[1], font=font, fill=_INK, anchor="mm")
    image.alpha_composite(label.rotate(90, expand=True), (8 * SIDE, top))
    points = SIDE * _in_field(panel, panel.path)
    pen.line([*map(tuple, points.tolist())], fill=(20, 30, 40, 255), width=1)
    return _packed(image)


def _colours(values: Array) -> NDArray[np.uint8]:
    """Return red, green and blue of values from −1 (blue) over 0 (white) to 1 (orange)."""
    strong = np.where(
        (values < 0.0)[..., None],
        *(255.0 * np.array(colour_of(colour)[:3]) for colour in LOOK.field),
    )
    return np.asarray(255.0 + (strong - 255.0) * np.abs(values)[..., None]).round().astype(np.uint8)

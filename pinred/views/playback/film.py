"""Films: PNG frames, mp4 and gif."""

from __future__ import annotations

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
from itertools import pairwise
from pathlib import Path
from types import FrameType

import PIL.Image  # a dependency of meshcat
from PIL.Image import Image as Picture

from ...common.arrays import Array
from ...common.errors import InputError, OutputError
from ...common.files import check_path, write_atomic
from ...common.optional_packages import install_command
from ...common.waiting import Progress, quiet, say, shown
from ..motion_source import MotionSource
from .film_frames import Frames
from .playback import frame_times
from .view_options import View

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

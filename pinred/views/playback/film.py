"""Films: PNG frames, mp4 and gif, photographed from the page in a headless browser."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from types import FrameType

from ...common.arrays import Array
from ...common.errors import InputError, OutputError
from ...common.files import check_path, write_atomic
from ...common.progress import Progress
from ..motion_source import MotionSource
from .headless_browser import browser
from .page import page
from .playback import frame_times
from .view import View

SIZE = (960, 720)
MOST_FRAMES, MOST_FPS = 20_000, 120
GIF_FPS = (0.01, 50.0)  # a gif counts hundredths of a second, and browsers slow down below two
SUFFIXES = (".mp4", ".gif", ".png")


def save_film(
    source: MotionSource,
    path: str | Path,
    view: View,
    *,
    size: Sequence[int] = SIZE,
    progress: Progress | None = None,
) -> int:
    """Write a film and return the number of its frames; the suffix decides what it is.

    path: film.mp4 (needs ffmpeg), film.gif (up to 50 frames a second), or film.png for frames
    film_0000.png and so on, which are refused while frames of a longer film are there.
    view: of it, fps is frames a second, and speed how much of the motion goes into one.
    size: width and height in pixels, even.  progress: called with the part that is done.
    Raises InputError for what makes no sense, or if Chromium or ffmpeg is not installed,
    OutputError if rendering or writing fails; the others as of `page`.
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
            closing(_shots(source, times, pixels, view, progress or (lambda _: None))) as shots,
        ):
            if path.suffix == ".png":
                return write_frames(path, shots)
            if path.suffix == ".gif":
                return write_gif(path, shots, view.fps)
            return _write_mp4(path, shots, view.fps, encoder)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error


def find_ffmpeg() -> str:
    """Return the path of ffmpeg.  Raises InputError that says what to install."""
    if found := shutil.which("ffmpeg"):
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise InputError(
            'mp4 films need ffmpeg: pip install "pinred[film]" or apt-get install ffmpeg; '
            "a .gif or .png needs neither"
        ) from None


class _Terminated(BaseException):
    """SIGTERM has come."""


@contextmanager
def _tidy_at_sigterm() -> Iterator[None]:
    """Let SIGTERM end what is done inside like an error before it ends the process.

    Only where nobody else handles it, and in the main thread, the only one that may.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ):
        yield
        return

    def leave(number: int, frame: FrameType | None) -> None:
        del frame
        signal.signal(number, signal.SIG_IGN)  # not again while cleaning up
        raise _Terminated

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    except _Terminated:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTERM)
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _shots(
    source: MotionSource,
    times: Array,
    size: Sequence[int],
    view: View,
    progress: Progress,
) -> Generator[bytes]:
    """Give PNG pictures of a motion's page at some times."""
    content = page(source, view)
    with tempfile.TemporaryDirectory() as folder, browser() as screen:
        file = Path(folder, "film.html")
        file.write_bytes(content)
        screen.open(f"{file.as_uri()}#bare", width=size[0], height=size[1])
        screen.wait_for("window.pinred !== undefined")
        for k, t in enumerate(times.tolist(), start=1):
            screen.run(f"pinred.seek({t!r})")
            yield screen.screenshot()
            progress(k / len(times))


def _frame(path: Path, k: int) -> Path:
    return path.with_name(f"{path.stem}_{k:04d}.png")


def check_frames(path: Path, count: int) -> None:
    """Raise InputError where frames cannot be written, or others would follow the last of them.

    A later frame is of a longer film, and whoever made it may want it: nothing is removed.
    """
    for k in range(count):
        if _frame(path, k).is_dir():
            raise InputError(f"cannot write '{_frame(path, k)}': it is a folder")
    name = re.compile(re.escape(path.stem) + r"_(\d{4,})\.png", re.ASCII)
    found = (name.fullmatch(entry) for entry in os.listdir(path.parent))
    later = sorted(int(match[1]) for match in found if match and int(match[1]) >= count)
    if later:
        more = f" and {len(later) - 1} more" if len(later) > 1 else ""
        raise InputError(
            f"a film of {count} frames would be followed by '{_frame(path, later[0])}'{more}, "
            "of a longer one; remove what is left of that, or take another name"
        )


def write_frames(path: Path, shots: Iterator[bytes]) -> int:
    """Write PNG pictures as film_0000.png and so on, all or none, and return their number.

    They are moved into place when the last of them is there; if that fails, back again.
    Raises InputError as of `check_frames`.
    """
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        new, old = Path(folder, "new"), Path(folder, "old")
        new.mkdir()
        old.mkdir()
        count = 0
        for count, shot in enumerate(shots, start=1):
            _frame(new / path.name, count - 1).write_bytes(shot)
        check_frames(path, count)
        targets: list[Path] = []
        try:
            for k in range(count):
                targets.append(_frame(path, k))
                if targets[k].exists():
                    targets[k].replace(old / targets[k].name)
                _frame(new / path.name, k).replace(targets[k])
        except BaseException:
            for target in targets:
                if not (new / target.name).exists():
                    target.unlink()
                if (old / target.name).exists():
                    (old / target.name).replace(target)
            raise
    return count


def write_gif(path: Path, shots: Iterator[bytes], fps: float) -> int:
    """Write PNG pictures as a gif and return their number.

    Frames last whole hundredths of a second, and not all the same: each ends at the hundredth
    that is nearest to its end in a film of `fps` frames a second.
    """
    from PIL import Image  # meshcat brings it along

    few = Image.Quantize.FASTOCTREE  # the default spends its colours on the background
    pictures = [Image.open(io.BytesIO(shot)).convert("RGB").quantize(method=few) for shot in shots]
    ends = [round(100.0 * k / fps) for k in range(len(pictures) + 1)]
    write_atomic(
        path,
        lambda file: pictures[0].save(
            file, format="GIF", save_all=True, append_images=pictures[1:],
            duration=[10 * (b - a) for a, b in pairwise(ends)], loop=0,
        ),
    )  # fmt: skip
    return len(pictures)


def _write_mp4(path: Path, shots: Iterator[bytes], fps: float, encoder: str) -> int:
    with tempfile.TemporaryDirectory() as folder:
        film, count = Path(folder, "film.mp4"), 0
        command = [
            encoder, "-loglevel", "error", "-f", "image2pipe", "-framerate", f"{fps:g}",
            "-c:v", "png", "-i", "-", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20",
            "-movflags", "+faststart", str(film),
        ]  # fmt: skip
        with (
            Path(folder, "said").open("w+", encoding="utf-8", errors="replace") as said,
            subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said) as coder,
        ):
            try:
                for shot in shots:
                    coder.stdin.write(shot)  # type: ignore[union-attr]
                    count += 1
                coder.stdin.close()  # type: ignore[union-attr]
            except BrokenPipeError:
                pass  # it says why below
            except BaseException:
                coder.kill()
                raise
            if code := coder.wait():
                said.seek(0)
                why = said.read().strip().splitlines()
                raise OutputError(f"ffmpeg failed: {why[-1] if why else f'code {code}'}")
        write_atomic(path, lambda file: file.write(film.read_bytes()))
    return count

"""Films: PNG frames, mp4 and gif, photographed from the page in a headless browser."""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from ..errors import InputError, OutputError
from ..export import check_path, write_atomic
from ..recording import Recording
from ..trajectory import Trajectory
from .browser import browser
from .page import page
from .view import View

SIZE, FPS = (960, 720), 30.0
MOST_FRAMES, MOST_FPS = 20_000, 120
SUFFIXES = (".mp4", ".gif", ".png")
Progress = Callable[[float], None]


def save_film(
    source: Trajectory | Recording,
    path: str | Path,
    view: View,
    *,
    size: Sequence[int] = SIZE,
    progress: Progress | None = None,
) -> int:
    """Write a film and return the number of its frames; the suffix decides what it is.

    path: film.mp4 (needs ffmpeg), film.gif, or film.png for frames film_0000.png and so on.
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
    encoder = find_ffmpeg() if path.suffix == ".mp4" else ""
    content = page(source, view)
    shots = _shots(content, pixels, view, progress or (lambda _: None))
    try:
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


def _shots(content: bytes, size: Sequence[int], view: View, progress: Progress) -> Iterator[bytes]:
    """Give PNG pictures of a page at even times, from the first to the last."""
    with tempfile.TemporaryDirectory() as folder, browser() as screen:
        file = Path(folder, "film.html")
        file.write_bytes(content)
        screen.open(f"{file.as_uri()}#bare", width=size[0], height=size[1])
        screen.wait_for("window.pinred !== undefined")
        begin, end = screen.run("[pinred.begin, pinred.end]")
        count = max(2, round((end - begin) / view.speed * view.fps) + 1)
        if count > MOST_FRAMES:
            raise InputError(
                f"{count} frames are too many (at most {MOST_FRAMES}); "
                "play faster, with speed=, or with a lower fps="
            )
        for k in range(count):
            screen.run(f"pinred.seek({begin + (end - begin) * k / (count - 1)!r})")
            yield screen.screenshot()
            progress((k + 1) / count)


def write_frames(path: Path, shots: Iterator[bytes]) -> int:
    """Write PNG pictures as film_0000.png and so on, all or none, and return their number.

    They are moved into place when the last of them is there.
    """
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        count = 0
        for count, shot in enumerate(shots, start=1):
            Path(folder, f"{path.stem}_{count - 1:04d}.png").write_bytes(shot)
        for frame in sorted(Path(folder).iterdir()):
            frame.replace(path.parent / frame.name)
    return count


def write_gif(path: Path, shots: Iterator[bytes], fps: float) -> int:
    """Write PNG pictures as a gif and return their number."""
    from PIL import Image  # meshcat brings it along

    few = Image.Quantize.FASTOCTREE  # the default spends its colours on the background
    pictures = [Image.open(io.BytesIO(shot)).convert("RGB").quantize(method=few) for shot in shots]
    write_atomic(
        path,
        lambda file: pictures[0].save(
            file, format="GIF", save_all=True, append_images=pictures[1:],
            duration=max(20, round(1000.0 / fps)), loop=0,
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

"""Time of a film's frame, compared with screenshots of the same page."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.progress import Progress, one_by_one
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.robot_files import has_example_robots
from .film import SIZE, take_pictures
from .headless_browser import Browser, browser
from .page import page
from .view_options import FILM_FPS, View

BUNDLED = ("falling_cat", "satellite_two_arms")
EXAMPLES = ("solo12", "talos")
_SPAN = 2.0  # duration of the motion [s]
_FILMS = 3  # number of short films, each followed by screenshots at the same times
_FRAMES = 6  # number of frames of a short film


@checks_arguments
@dataclass(frozen=True)
class FilmTiming:
    """Times of a frame of a robot's film; medians of short films and screenshots, taken in turn.

    Attributes:
        robot: Name of the robot.
        frame: Time of a frame as films capture it [s].
        screenshot: Time of a screenshot of the same page at the same time of the motion [s].
    """

    robot: str
    frame: float
    screenshot: float

    @staticmethod
    def header() -> str:
        """Return the header of the table."""
        return f"{'robot':<20} {'frame [s]':>10} {'per second':>11} {'screenshot [s]':>15} {'×':>6}"

    def __str__(self) -> str:
        return (
            f"{self.robot:<20} {self.frame:>10.3f} {1.0 / self.frame:>11.1f} "
            f"{self.screenshot:>15.3f} {self.screenshot / self.frame:>6.2f}"
        )


@checks_arguments
def bench_films(
    robots: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[FilmTiming]:
    """Measure the time of a film's frame for each robot.

    Args:
        robots: Names or files; two bundled robots and, if installed, solo12 and talos by default.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each robot.
    """
    names = list(robots) or [*BUNDLED, *(EXAMPLES if has_example_robots() else ())]
    return one_by_one(names, _bench_film, progress, "films")


def _bench_film(name: str) -> FilmTiming:
    traj = simulate(load(name, gravity=(0.0, 0.0, 0.0)), seed=1, duration=_SPAN)
    content = page(traj, View(fps=FILM_FPS))
    times = np.linspace(0.0, _SPAN, _FILMS * _FRAMES).reshape(_FILMS, _FRAMES).tolist()
    with ExitStack() as stack:
        # A page that captures its pictures is hidden, so screenshots need a page of their own.
        filmed, shown = (stack.enter_context(_open_page(content)) for _ in range(2))
        _film(filmed, times[0])  # the first frames of a page take longer
        seconds = [
            (_duration(_film, filmed, film), _duration(_take_screenshots, shown, film))
            for film in times
        ]
    frame, screenshot = (np.median(seconds, axis=0) / _FRAMES).tolist()
    return FilmTiming(name, frame, screenshot)


@contextmanager
def _open_page(content: bytes) -> Iterator[Browser]:
    """Open a page without controls in a browser of its own."""
    with tempfile.TemporaryDirectory() as folder, browser() as screen:
        file = Path(folder, "film.html")
        file.write_bytes(content)
        screen.open(f"{file.as_uri()}#bare", width=SIZE[0], height=SIZE[1])
        screen.wait_for("window.pinred !== undefined")
        yield screen


def _film(screen: Browser, times: Sequence[float]) -> None:
    for _ in take_pictures(screen, times):
        pass


def _take_screenshots(screen: Browser, times: Sequence[float]) -> None:
    for t in times:
        screen.run(f"pinred.seek({t!r})")
        screen.screenshot()


def _duration(
    action: Callable[[Browser, Sequence[float]], None], screen: Browser, times: Sequence[float]
) -> float:
    began = time.perf_counter()
    action(screen, times)
    return time.perf_counter() - began

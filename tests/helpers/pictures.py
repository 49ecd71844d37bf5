"""Baseline pictures of figures in tests/helpers/baselines/*.png; run this file to write them.

Text is removed, because its rendering differs between versions of the font renderer; other tests
check it. Two pictures agree if every pixel of one has a similar pixel nearby in the other. This
accepts small shifts of edges and margins between versions of matplotlib, and rejects a missing
curve.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave
from matplotlib.text import Text
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

import pinred
from pinred import plots
from pinred.common.arrays import Array
from pinred.laboratory.bench import Point, WorkPrecision

FOLDER = Path(__file__).parent / "baselines"
DPI = 50
NEAR = 7  # side of the square in which a similar pixel is searched [pixels]
ALIKE = 0.15  # largest difference of similar pixels; black is 0 and white is 1
Picture = NDArray[np.float64]


def picture(figure: Figure) -> Picture:
    """Render a figure without text, (height, width, 3), values from 0 to 1."""
    figure.set_dpi(DPI)
    figure.set_layout_engine("none")  # automatic layouts differ between versions of matplotlib
    for axes in figure.axes:
        for axis in axes._axis_map.values():
            axis.set_major_formatter(NullFormatter())
            axis.set_minor_formatter(NullFormatter())
    for text in figure.findobj(Text):
        text.set_text("")
    canvas = figure.canvas
    if not isinstance(canvas, FigureCanvasAgg):
        raise TypeError(canvas)
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels: Picture = np.array(canvas.buffer_rgba())[..., :3] / 255.0  # type: ignore[no-untyped-call]
    return pixels


def baseline(name: str) -> Picture:
    """Return the baseline picture of a figure."""
    return np.asarray(imread(FOLDER / f"{name}.png"), dtype=float)[..., :3]


def mismatch(a: Picture, b: Picture) -> float:
    """Return the number of pixels, except at the rim, without a similar pixel nearby."""
    height, width = np.minimum(a.shape, b.shape)[:2]
    if (
        abs(np.subtract(a.shape, b.shape)).max() > 1
    ):  # sizes may differ by one pixel due to rounding
        return np.inf
    a, b = a[:height, :width], b[:height, :width]
    return float(max(_count_unmatched(a, b), _count_unmatched(b, a)))


def _count_unmatched(a: Picture, b: Picture) -> int:
    size = (NEAR, NEAR, 1)
    low = minimum_filter(b, size=size) - ALIKE
    high = maximum_filter(b, size=size) + ALIKE
    unmatched = ((a < low) | (a > high)).any(axis=2)
    return int(unmatched[NEAR:-NEAR, NEAR:-NEAR].sum())


def _cat() -> pinred.Trajectory:
    return pinred.simulate(pinred.load("falling_cat"), duration=4.0)


def _body() -> pinred.Trajectory:
    return pinred.simulate(pinred.load("rigid_body"), duration=6.0)


def _swing() -> pinred.Trajectory:
    return pinred.simulate(
        pinred.load("elroys_beanie"), x0=[0.4], momentum=[1.5], springs={"beanie": (1.0, 0.0)},
        duration=8.0,
    )  # fmt: skip


def _pendulum() -> pinred.Trajectory:
    system = pinred.load("double_spherical_pendulum")
    return pinred.simulate(system, x0=[0.3, 0.1, 0.0], xdot0=[0, 0.5, 0.2], xi0=[1], duration=60.0)


def recorded() -> pinred.Recording:
    """Return an artificial recording whose drifts are far larger than round-off."""
    t = np.linspace(0.0, 4.0, 81)
    J = np.array([1.0, -0.4, 0.6]) + 1e-9 * np.stack([t, t**2, t**3], axis=1)
    none, zero = np.zeros((81, 0)), np.zeros((81, 3))
    states = pinred.State(
        t=t, x=none, xdot=none, xi=zero, pose=zero, q=zero, v=zero, body_momentum=zero,
        spatial_momentum=J, energy=2.0 + 1e-9 * np.expm1(t),
    )  # fmt: skip
    return pinred.Recording(Path("made_up.npz"), "made_up", "SE2", (), states, {})


def report() -> pinred.Report:
    """Return an artificial report whose errors grow by known powers of time."""
    t = np.linspace(0.1, 4.0, 80)
    scalars = dict.fromkeys(pinred.Report.__dataclass_fields__, 1.0)
    names: dict[str, Any] = {"robot": "made_up", "engine": "none", "group": "SE2", "joints": 1}
    errors = {
        "t": t, "shape_errors": 1e-11 * t[:, None]**2, "rotation_errors": 3e-12 * t,
        "position_errors": 1e-12 * t**3, "shape_bounds": 1e-8 * t[:, None],
        "rotation_bounds": 3e-8 * t, "position_bounds": 1e-7 * t, "growth": t, "told": 80,
        "reasons": (), "left_out": "", "stop_checks": (),
    }  # fmt: skip
    return pinred.Report(**{**scalars, **names, **errors})


def measured() -> list[WorkPrecision]:
    """Return two artificial measurements with errors from 1e-2 to 1e-12 and known run times."""
    errors: Array = np.logspace(-2, -12, 6)

    def points(method: str, wall: float, power: float) -> list[Point]:
        return [
            Point(method, tol, wall=wall * tol**-power, evaluations=100 * tol**-power, shape=tol,
                  rotation=0.5 * tol, position=0.1 * tol)
            for tol in errors.tolist()
        ]  # fmt: skip

    failed = Point("slow", 1e-14, failure="too many steps")
    both = (*points("fast", 1e-4, 0.05), *points("slow", 1e-3, 0.1), failed)
    about = {"fast": "the fast one", "slow": "the slow one"}
    return [
        WorkPrecision("first", 3, 2.0, 1e-11, about, both),
        WorkPrecision("second", 3, 2.0, 1e-13, {"slow": "the slow one"}, both[6:]),
    ]


FIGURES: dict[str, Callable[[], Figure]] = {
    "shape": lambda: pinred.plot(_cat(), "shape"),
    "base": lambda: pinred.plot(_cat(), "base"),
    "momentum": lambda: plots.momentum(recorded()),
    "energy": lambda: plots.energy(recorded()),
    "error": lambda: plots.error(report()),
    "phase_1": lambda: pinred.plot(_swing(), "phase"),
    "phase_2": lambda: pinred.plot(_cat(), "phase"),
    "sphere": lambda: pinred.plot(
        pinred.simulate(pinred.load("rigid_body"), duration=6.0), "sphere"
    ),
    "curvature": lambda: plots.curvature(pinred.load("falling_cat"), component="w3", path=_cat().x),
    "poincare": lambda: pinred.plot(_pendulum(), "poincare", value=0.0, direction=0),
    "work_precision": lambda: plots.work_precision(measured()),
}


def main() -> None:
    """Write all baseline pictures."""
    FOLDER.mkdir(exist_ok=True)
    for name, draw in FIGURES.items():
        imsave(FOLDER / f"{name}.png", picture(draw()), pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()

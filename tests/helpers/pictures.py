"""Pictures that figures are held to: tests/helpers/baselines/*.png, written by running this file.

They are drawn without text, which looks different with every version of its renderer; the tests
read it from the figures.  Two pictures agree if every pixel of one has its like near the same
place in the other.  That forgives what another version of matplotlib does to edges and margins,
and not a curve that is missing.
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
NEAR = 7  # pixels: the side of the square in which a like is looked for
ALIKE = 0.15  # of the way from black to white
Picture = NDArray[np.float64]


def picture(figure: Figure) -> Picture:
    """A figure as it is drawn but for its text, (height, width, 3) from 0 to 1."""
    figure.set_dpi(DPI)
    figure.set_layout_engine("none")  # layouts differ from version to version
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
    """The picture on file."""
    return np.asarray(imread(FOLDER / f"{name}.png"), dtype=float)[..., :3]


def mismatch(a: Picture, b: Picture) -> float:
    """How many pixels of either picture, away from its rim, have no like in the other."""
    height, width = np.minimum(a.shape, b.shape)[:2]
    if abs(np.subtract(a.shape, b.shape)).max() > 1:  # one pixel is rounding
        return np.inf
    a, b = a[:height, :width], b[:height, :width]
    return float(max(_alone(a, b), _alone(b, a)))


def _alone(a: Picture, b: Picture) -> int:
    size = (NEAR, NEAR, 1)
    low = minimum_filter(b, size=size) - ALIKE
    high = maximum_filter(b, size=size) + ALIKE
    alone = ((a < low) | (a > high)).any(axis=2)
    return int(alone[NEAR:-NEAR, NEAR:-NEAR].sum())


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
    """A made-up recording: drifts of known size, which no rounding decides."""
    t = np.linspace(0.0, 4.0, 81)
    J = np.array([1.0, -0.4, 0.6]) + 1e-9 * np.stack([t, t**2, t**3], axis=1)
    none, zero = np.zeros((81, 0)), np.zeros((81, 3))
    states = pinred.State(
        t=t, x=none, xdot=none, xi=zero, pose=zero, q=zero, v=zero, body_momentum=zero,
        spatial_momentum=J, energy=2.0 + 1e-9 * np.expm1(t),
    )  # fmt: skip
    return pinred.Recording(Path("made_up.npz"), "made_up", "SE2", (), states, {})


def report() -> pinred.Report:
    """A made-up report: errors that grow by known powers of time."""
    t = np.linspace(0.1, 4.0, 80)
    scalars = dict.fromkeys(pinred.Report.__dataclass_fields__, 1.0)
    names: dict[str, Any] = {"robot": "made_up", "engine": "none", "group": "SE2", "joints": 1}
    errors = {
        "t": t, "shape_errors": 1e-11 * t[:, None]**2, "rotation_errors": 3e-12 * t,
        "position_errors": 1e-12 * t**3, "shape_bounds": 1e-8 * t[:, None],
        "rotation_bounds": 3e-8 * t, "position_bounds": 1e-7 * t, "growth": t, "told": 80,
        "reasons": (),
    }  # fmt: skip
    return pinred.Report(**{**scalars, **names, **errors})


def measured() -> list[WorkPrecision]:
    """Two made-up measurements: errors from 1e-2 down, walls of known powers of them."""
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
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    for name, make in FIGURES.items():
        imsave(FOLDER / f"{name}.png", picture(make()), pil_kwargs={"optimize": True})


if __name__ == "__main__":
    main()

"""`pinred equilibria`: relative equilibria at a momentum, or branches over a range of momenta."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .options import add_robot, by_joint_in, numbers_in, prescribed_in, springs_in, system_of
from .written import written

if TYPE_CHECKING:
    from ..analysis.equilibria.relative_equilibrium import Equilibria
    from ..system.system import System

_PAGES = (".html", ".mp4", ".gif", ".png")


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    sub.add_argument(
        "--momentum", metavar="J or LOW,HIGH", required=True,
        help="of the steady motion, or a range over which branches are followed [N·m·s | N·s]",
    )  # fmt: skip
    sub.add_argument(
        "--cyclic", metavar="J1=V1,…", help="momenta of cyclic joints, such as wheels (zero)"
    )
    sub.add_argument("--starts", metavar="N", type=int, help="points that the search starts from")
    sub.add_argument("--seed", metavar="S", type=int, default=0, help="of these (0)")
    sub.add_argument(
        "--spring", metavar="J=K,REST", action="append", default=[], help="a spring at joint J"
    )
    sub.add_argument("--passive", action="store_true", help="springs in the robot's file act")
    sub.add_argument(
        "--prescribed", metavar="J=PLAN", action="append", default=[],
        help="joint J is held at a number, or turns steadily, such as '3*t'",
    )  # fmt: skip
    sub.add_argument("--joint", metavar="J", help="of the diagram's vertical axis (amended V)")
    sub.add_argument("--play", metavar="K", type=int, help="play the K-th, counted from 0")
    sub.add_argument("--mode", metavar="M", type=int, help="on its M-th mode, counted from 0")
    sub.add_argument(
        "--amplitude", metavar="A", type=float, default=0.05, help="of the mode (0.05) [rad | m]"
    )
    sub.add_argument("--time", metavar="T", type=float, help="of what is played [s]")
    sub.add_argument(
        "--out", metavar="FILE",
        help="of a range, the diagram as .png, .pdf or .svg; with --play, .html, .mp4, .gif, .png",
    )  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Print what was found, draw it or play it.  Returns 0."""
    momenta = numbers_in(options.momentum, "momentum") or []
    if len(momenta) not in (1, 2):
        raise InputError(f"--momentum takes J, or LOW,HIGH, got {len(momenta)} numbers")
    _check(options, is_range=len(momenta) == 2)
    system = system_of(options)
    given: dict[str, Any] = {
        "cyclic": _cyclic(options.cyclic),
        "seed": options.seed,
        "springs": springs_in(options.spring),
        "prescribed": prescribed_in(options.prescribed),
        "passive": options.passive,
    }
    if options.starts is not None:
        given["starts"] = options.starts
    if len(momenta) == 2:
        return _branches(options, system, (momenta[0], momenta[1]), given)
    from ..analysis.equilibria.find import relative_equilibria

    found = relative_equilibria(system, momentum=momenta[0], **given)
    for note in {each.problem.scene.left_out for each in found} - {""}:
        print(note)
    print(found)
    return 0 if options.play is None else _play(options, found)


def _branches(
    options: argparse.Namespace, system: System, ends: tuple[float, float], given: dict[str, Any]
) -> int:
    from ..analysis.branches.follow import branches
    from ..common.files import FIGURES, check_path
    from .plot import save

    path = None if options.out is None else check_path(Path(options.out), FIGURES)
    if path is not None:
        from ..views.plots import branches as draw  # refuses a missing matplotlib at once
    found = branches(system, momentum=ends, **given)
    print(found)
    if path is not None:
        save(draw(found, joint=options.joint), path)
        print(written(path))
    return 0


def _play(options: argparse.Namespace, found: Equilibria) -> int:
    from ..simulation.simulate import simulate
    from ..views.playback.view import FILM_FPS, FPS, View

    if not 0 <= options.play < len(found):
        raise InputError(f"--play: there are {len(found)}, counted from 0; got {options.play}")
    each = found[options.play]
    traj = simulate(
        each.scene(options.mode, amplitude=options.amplitude, duration=options.time), progress=True
    )
    print(f"playing {options.play}, {each}")
    if options.out is None:
        from ..views.playback.show import play

        play(traj, View(), wait=True)
        return 0
    path = Path(options.out)
    if path.suffix == ".html":
        from ..views.playback.page import save_html

        save_html(traj, path, View(fps=FPS))
        print(written(path))
        return 0
    from ..views.playback.film import save_film

    count = save_film(traj, path, View(fps=FILM_FPS))
    print(f"{count} frames written to {path}")
    return 0


def _check(options: argparse.Namespace, *, is_range: bool) -> None:
    """Raise InputError for options that would change nothing."""
    from ..common.files import check_path

    if is_range and options.play is not None:
        raise InputError("--play is for one momentum, not for a range")
    if options.play is None:
        for name in ("mode", "time"):
            if getattr(options, name) is not None:
                raise InputError(f"--{name} goes with --play K")
        if options.out is not None and not is_range:
            raise InputError("--out goes with a range, --momentum LOW,HIGH, or with --play K")
    elif options.out is not None:
        check_path(Path(options.out), _PAGES)
    if options.joint is not None and not (is_range and options.out is not None):
        raise InputError("--joint is of the diagram that --momentum LOW,HIGH --out FILE draws")


def _cyclic(text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    momenta = by_joint_in(text, "cyclic")
    if not isinstance(momenta, dict):
        raise InputError(f"--cyclic takes JOINT=MOMENTUM for each joint, got '{text}'")
    return momenta

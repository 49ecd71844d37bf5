"""Commands of impacts: capture, release and land, and the motion that follows."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .command_files import check_robot, describe_file, motion_in, print_report
from .command_options import add_options, option_adder, options_in

if TYPE_CHECKING:
    from ..scene.toml.schema import Key
    from ..simulation.contact.capture import Capture, Landing, Release
    from ..system.system import System
    from ..views.motion_source import MotionSource

_MOTION = "scene file (.toml), whose end counts, or motion traj.npz, whose last state counts"
_AFTER = (
    "duration", "prescribed", "hold", "springs", "passive", "friction", "rtol", "atol", "method",
)  # fmt: skip


def add_capture_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("first", metavar="FIRST", help=f"the robot that captures: {_MOTION}")
    sub.add_argument("second", metavar="SECOND", help="the other robot, at the same time")
    add = option_adder(sub)
    add("--at FRAME", "link or frame of the first", required=True)
    add("--onto FRAME", "link or frame of the second", required=True)
    add("--tolerance T", "largest distance [m] and angle [rad] of the frames", float, 1e-6)
    add("--prefix P", "text before the names of the second")
    _add_after(sub)


def run_capture(arguments: argparse.Namespace) -> int:
    """Print the capture.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import capture

    _check_after(arguments)
    motions = [_motion_before(path) for path in (arguments.first, arguments.second)]
    result = capture(
        motions[0], motions[1], at=arguments.at, onto=arguments.onto,
        tolerance=arguments.tolerance, prefix=arguments.prefix,
    )  # fmt: skip
    return _follow(arguments, motions, result, [(result.system, result.start)])


def add_release_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help=f"the robot: {_MOTION}")
    add = option_adder(sub)
    add("--link LINK", "link behind the joint that opens, or the joint", required=True)
    add("--root LINK", "link of the released part that its pose describes", default="")
    _add_after(sub)


def run_release(arguments: argparse.Namespace) -> int:
    """Print the release.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import release

    _check_after(arguments)
    motion = _motion_before(arguments.motion)
    result = release(motion, arguments.link, root=arguments.root)
    systems = (result.carrier, result.released)
    return _follow(arguments, [motion], result, [(state.system, state.start) for state in systems])


def add_land_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help=f"the robot in flight: {_MOTION}")
    add = option_adder(sub)
    add("--frame F[,F2]", "link or frame that stops, or several at once", required=True)
    add("--contact C", "point: its origin stops; flat: it stops turning, too", str, "point")
    _add_after(sub)


def run_land(arguments: argparse.Namespace) -> int:
    """Print the landing.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import land

    _check_after(arguments)
    motion = _motion_before(arguments.motion)
    landing = land(motion, arguments.frame.split(","), contact=arguments.contact)
    stance = landing.stance
    if stance is None and arguments.duration is not None:
        raise InputError(f"--duration: {landing.why_no_stance}")
    states = [] if stance is None else [(stance.system, stance.start)]
    return _follow(arguments, [motion], landing, states)


def _add_after(sub: argparse.ArgumentParser) -> None:
    """Add the options of the motion after the impact."""
    add_options(sub, _keys())
    add = option_adder(sub)
    add("--compare", "compare all motions with full ABA, and the impact with full mass matrices")
    add("--out FILE", "write the motions and the impact as one motion (.npz, .csv)")


def _keys() -> dict[str, Key]:
    from ..scene.scene_options import SCENE_OPTIONS

    return {name: SCENE_OPTIONS[name] for name in _AFTER}


def _check_after(arguments: argparse.Namespace) -> None:
    """Check the options before a long simulation.  Raises InputError."""
    from ..common.files import DATA, check_path

    options = options_in(arguments, _keys())
    if arguments.out is not None:
        check_path(Path(arguments.out), DATA)
    if "duration" not in options and options:
        raise InputError("pass --duration T to simulate the motion after the impact")


def _motion_before(path: str) -> MotionSource:
    """Return the motion in a scene file or recording."""
    check_robot(path, None)
    if Path(path).suffix not in (".toml", ".npz"):
        raise InputError(f"expected a scene file (.toml) or a motion (.npz), got '{path}'")
    return motion_in(path, None)


def _follow(
    arguments: argparse.Namespace,
    before: Sequence[MotionSource],
    impact: Capture | Release | Landing,
    states: Sequence[tuple[System, dict[str, Any]]],
) -> int:
    """Print an impact, simulate what follows, if requested, and write and compare all of it.

    Args:
        arguments: Parsed arguments of the command.
        before: Motions that end at the impact.
        impact: The impact.
        states: Systems after it, with the options that start them.
    Returns:
        0, or the exit code of the comparison.
    Raises:
        InputError: The motions before it are recordings, but more than the impact is requested.
    """
    from ..simulation.contact.chain import chain
    from ..simulation.simulate import simulate
    from ..simulation.trajectory import Trajectory

    print(impact)
    options = options_in(arguments, _keys())
    if "duration" not in options and arguments.out is None and not arguments.compare:
        return 0
    earlier = [motion for motion in before if isinstance(motion, Trajectory)]
    if len(earlier) < len(before):
        raise InputError(
            "--duration, --out and --compare need scene files (.toml) of one motion, not "
            "recordings; state further phases in the file, as tables [[phases]] (docs/scenes.md)"
        )
    after = [
        simulate(system, **start, **options, progress=True)
        for system, start in (states if "duration" in options else ())
    ]
    mission = chain(earlier, impact, *([after] if after else []))
    if arguments.out is not None:
        path = Path(arguments.out)
        mission.save(path)
        print(describe_file(path))
    if not arguments.compare:
        return 0
    from ..judge.compare import compare

    return print_report(compare(mission, progress=True))

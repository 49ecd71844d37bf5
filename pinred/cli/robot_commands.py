"""Commands about robots: inspect, robots and equilibria."""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError, PinredError
from ..common.files import FIGURES
from .command_files import describe_file, out_path, save_figure, show_motion
from .command_options import (
    add_options,
    add_robot,
    by_joint_in,
    numbers_in,
    option_adder,
    options_in,
    system_of,
)

if TYPE_CHECKING:
    from ..analysis.equilibria.relative_equilibrium import Equilibria
    from ..system.system import System


def add_inspect_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    sub.add_argument("--at", metavar="X1,X2,…", help="shape [rad | m] (default: zero)")


def run_inspect(arguments: argparse.Namespace) -> int:
    """Print the inspection.  Returns 0."""
    from ..analysis.inspection import inspect

    print(inspect(system_of(arguments), numbers_in(arguments.at, "at")))
    return 0


def add_robots_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("--check", action="store_true", help="load each robot and print errors")


def run_robots(arguments: argparse.Namespace) -> int:
    """Print the names of the robots.  Returns 0."""
    from ..system.robot_files import INSTALL_ROBOTS, bundled_robots, example_robots

    bundled = bundled_robots()
    width = max(map(len, bundled))
    print("bundled:")
    for name, robot in bundled.items():
        print(f"  {name:<{width}}  {robot.group:<3}  {robot.description}")
    examples = example_robots()
    if not examples:
        print(f"more (solo12, talos, ur5, …): {INSTALL_ROBOTS}")
        return 0
    print("from example-robot-data:")
    if not arguments.check:
        print("  " + ", ".join(examples))
        return 0
    from ..system.load import load

    width = max(map(len, examples))
    for name in examples:
        try:
            with warnings.catch_warnings(record=True) as caught:
                system = load(name)
            print(
                f"  {name:<{width}}  {system.group.name:<3}  {system.m} joints, {system.mass:g} kg"
            )
            for warning in caught:
                print(f"  {'':<{width}}  warning: {warning.message}")
        except PinredError as error:
            print(f"  {name:<{width}}  refused: {error}")
    return 0


_PLAYED = (".html", ".rrd", ".mp4", ".gif", ".png")  # suffixes of files with --play
_SCENE = ("springs", "passive", "prescribed")  # options of a scene that this command accepts


def add_equilibria_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import SCENE_OPTIONS

    add_robot(sub)
    add_options(sub, {name: SCENE_OPTIONS[name] for name in _SCENE})
    add = option_adder(sub)
    text = "momentum of the relative equilibria, or a range for branches [N·m·s | N·s]"
    add("--momentum J or LOW,HIGH", text, required=True)
    add("--cyclic J1=V1,…", "momenta of cyclic joints, such as wheels [N·m·s | N·s] (default: 0)")
    add("--starts N", "number of random starting points of each round", int)
    add("--limit N", "largest number of starting points in all, at one momentum", int)
    add("--seed S", "seed of the starting points", int, 0)
    add("--joint J", "vertical axis of the diagram (default: amended potential)")
    add("--play K", "play equilibrium K, counted from 0", int)
    add("--mode M", "perturb it along mode M, counted from 0", int)
    add("--amplitude A", "amplitude of the mode [rad | m]", float, 0.05)
    text = "ten periods of the mode, or of the rotation"
    add_options(sub, {"duration": replace(SCENE_OPTIONS["duration"], default=text)})
    text = (
        "diagram of a range (.png, .pdf, .svg), or motion of --play (.html, .rrd, .mp4, .gif, .png)"
    )
    add("--out FILE", text)


def run_equilibria(arguments: argparse.Namespace) -> int:
    """Print equilibria or branches, and draw or play them.  Returns 0."""
    momenta = numbers_in(arguments.momentum, "momentum") or []
    if len(momenta) not in (1, 2):
        raise InputError(f"--momentum takes J, or LOW,HIGH, got {len(momenta)} numbers")
    _check(arguments, is_range=len(momenta) == 2)
    system = system_of(arguments)
    from ..scene.scene_options import SCENE_OPTIONS

    options = options_in(arguments, {name: SCENE_OPTIONS[name] for name in _SCENE})
    options |= {"cyclic": _parse_cyclic(arguments.cyclic), "seed": arguments.seed}
    if arguments.starts is not None:
        options["starts"] = arguments.starts
    if arguments.limit is not None:
        options["limit"] = arguments.limit
    if len(momenta) == 2:
        return _branches(arguments, system, (momenta[0], momenta[1]), options)
    from ..analysis.equilibria.find import relative_equilibria

    equilibria = relative_equilibria(system, momentum=momenta[0], **options)
    for note in {equilibrium.problem.scene.left_out for equilibrium in equilibria} - {""}:
        print(note)
    print(equilibria)
    return 0 if arguments.play is None else _play(arguments, equilibria)


def _branches(
    arguments: argparse.Namespace,
    system: System,
    ends: tuple[float, float],
    options: dict[str, Any],
) -> int:
    """Follow branches between two momenta, print them, and draw a diagram.  Returns 0."""
    from ..analysis.equilibria.branches import branches

    path = out_path(arguments, FIGURES)
    if path is not None:
        from ..views.plots import branches as draw  # Fail early if matplotlib is missing.
    result = branches(system, momentum=ends, **options)
    print(result)
    if path is not None:
        save_figure(draw(result, joint=arguments.joint), path)
        print(describe_file(path))
    return 0


def _play(arguments: argparse.Namespace, equilibria: Equilibria) -> int:
    """Simulate one equilibrium, perturbed along a mode, and play or write it.  Returns 0."""
    from ..simulation.simulate import simulate
    from ..views.playback.view_options import View, default_fps

    index, count = arguments.play, len(equilibria)
    if not 0 <= index < count:
        raise InputError(f"--play: expected an index below {count}, got {index}")
    equilibrium = equilibria[index]
    scene = equilibrium.scene(
        arguments.mode, amplitude=arguments.amplitude, duration=arguments.duration
    )
    traj = simulate(scene, progress=True)
    print(f"playing {index}, {equilibrium}")
    path = None if arguments.out is None else Path(arguments.out)
    show_motion(traj, path, View(fps=default_fps(path)))
    return 0


def _check(arguments: argparse.Namespace, *, is_range: bool) -> None:
    """Raise InputError for options without effect; `is_range`: the command follows branches."""
    if is_range and arguments.limit is not None:
        raise InputError("--limit is for one momentum, not for a range")
    if is_range and arguments.play is not None:
        raise InputError("--play requires a single momentum, not a range")
    if arguments.play is None:
        for name in ("mode", "duration"):
            if getattr(arguments, name) is not None:
                raise InputError(f"--{name} requires --play K")
        if arguments.out is not None and not is_range:
            raise InputError("--out requires a range, --momentum LOW,HIGH, or --play K")
    else:
        out_path(arguments, _PLAYED)
    if arguments.joint is not None and not (is_range and arguments.out is not None):
        raise InputError("--joint requires the diagram that --momentum LOW,HIGH --out FILE draws")


def _parse_cyclic(text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    momenta = by_joint_in(text, "cyclic")
    if not isinstance(momenta, dict):
        raise InputError(f"--cyclic takes JOINT=MOMENTUM for each joint, got '{text}'")
    return momenta

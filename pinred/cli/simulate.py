"""`pinred simulate`: simulate the reduced equations and write the motion."""

from __future__ import annotations

import argparse
from dataclasses import replace

from ..common.errors import InputError
from .options import add_robot, add_scene, scene_of
from .run import told_events
from .written import written


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene import EVEN_TIMES

    add_robot(sub)
    add_scene(sub)
    sub.add_argument("--out", metavar="FILE", required=True, help="traj.npz or traj.csv")
    sub.add_argument(
        "--samples", metavar="N", type=int, default=EVEN_TIMES, help=f"report times ({EVEN_TIMES})"
    )


def run(options: argparse.Namespace) -> int:
    """Simulate and write.  Returns 0."""
    import numpy as np

    from ..common.files import check_path
    from ..simulation.simulate import simulate

    path = check_path(options.out)
    scene = scene_of(options)
    if options.samples < 2:
        raise InputError(f"--samples must be at least 2, got {options.samples}")
    scene = replace(scene, times=np.linspace(0.0, scene.end, options.samples))
    traj = simulate(scene, engine=options.engine, progress=True)
    traj.save(path)
    if scene.left_out:
        print(scene.left_out)
    for name, text in told_events(traj):
        print(f"event {name}: {text}")
    print(f"{traj}\n{written(path)}")
    return 0

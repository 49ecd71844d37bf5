"""`pinred simulate`: simulate the reduced equations and write the motion to a file.

Its options are described in scene/scene_options.py and scene/load_options.py;
cli/command_options.py makes arguments of them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from ..common.errors import InputError
from .command_options import add_options, add_robot, add_scene, scene_of
from .output_files import describe_file
from .run_command import describe_events


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.option_checks import EVEN_TIMES
    from ..scene.scene_options import RUN_OPTIONS

    add_robot(sub)
    add_scene(sub)
    add_options(sub, {name: RUN_OPTIONS[name] for name in ("samples", "checkpoint")})
    sub.set_defaults(samples=EVEN_TIMES)
    sub.add_argument("--out", metavar="FILE", required=True, help="traj.npz, csv, h5, zarr or xml")


def run(arguments: argparse.Namespace) -> int:
    """Simulate and write.  Returns 0."""
    import numpy as np

    from ..common.files import check_path
    from ..simulation.simulate import simulate
    from ..simulation.trajectory_files import FOLDERS, SUFFIXES

    path = check_path(arguments.out, SUFFIXES, folders=FOLDERS)
    scene = scene_of(arguments)
    if arguments.samples < 2:
        raise InputError(f"--samples must be at least 2, got {arguments.samples}")
    scene = replace(scene, times=np.linspace(0.0, scene.end, arguments.samples))
    traj = simulate(
        scene,
        engine=arguments.engine,
        check=arguments.check,
        checkpoint=arguments.checkpoint,
        progress=True,
    )
    traj.save(path)
    if scene.left_out:
        print(scene.left_out)
    for name, text in describe_events(traj):
        print(f"event {name}: {text}")
    print(f"{traj}\n{describe_file(path)}")
    return 0

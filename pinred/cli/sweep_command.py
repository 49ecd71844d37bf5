"""`pinred sweep`: simulate many points of the scene in a TOML file, and store the results."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.names import quoted
from .command_options import add_options, add_parameters, add_repeated, options_in, parameters_in

if TYPE_CHECKING:
    from ..sweeps.sweep_result import SweepResult

_QUANTILES = (0.05, 0.5, 0.95)


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.sweep_options import SWEEP_OPTIONS

    text = "scene file (docs/scenes.md); the options replace those of its table `sweep`"
    sub.add_argument("scene", metavar="SCENE", help=text)
    repeated = {name: SWEEP_OPTIONS[name] for name in ("vary", "outputs")}
    for option in repeated.values():
        add_repeated(sub, option.command, f"{option.description}; repeatable")
    others = {name: key for name, key in SWEEP_OPTIONS.items() if name not in repeated}
    add_options(sub, others)
    sub.add_argument("--threads", metavar="N", type=int, help="number of local threads")
    add_parameters(sub, "value of a parameter of the file or of its robot, instead of the file's")


def run(arguments: argparse.Namespace) -> int:
    """Run the command.  Returns 0."""
    from ..scene.sweep_options import SWEEP_OPTIONS
    from ..scene.toml.file_place import naming
    from ..scene.toml.reader import read_scene_file
    from ..simulation.simulate import as_scene
    from ..sweeps.sweep import sweep
    from ..system.body_parameters import refuse_vague
    from ..system.variants import nominal

    file = read_scene_file(arguments.scene)
    scene = file.scene
    if parameters := parameters_in(arguments.parameters):
        scene = as_scene(scene, {"parameters": parameters}, "sweep")
    with naming(file.place):
        for name in file.sweep.get("vary", {}):
            refuse_vague(nominal(scene.system), name)
    others = {name: key for name, key in SWEEP_OPTIONS.items() if name not in ("vary", "outputs")}
    stated = options_in(arguments, others)
    if arguments.vary:
        stated["vary"] = {**file.sweep.get("vary", {}), **_assigned(arguments.vary)}
    if arguments.outputs:
        stated["outputs"] = _outputs(arguments.outputs)
    options: dict[str, Any] = {**file.sweep, **stated}
    for name, example in (("vary", "front.mass=Uniform(0.5, 2)"), ("store", "results.zarr")):
        if name not in options:
            raise InputError(
                f"{name}: expected a table [sweep] with the key '{name}', or --{name} '{example}'"
            )
    with nullcontext() if stated else naming(file.place):
        result = sweep(
            scene, options.pop("vary"), threads=arguments.threads, progress=True, **options
        )
    print(summary(result))
    print(f"  written to {options['store']}")
    return 0


def _assigned(entries: Sequence[str]) -> dict[str, str]:
    """Parse texts NAME=LAW.  Raises InputError."""
    values = {}
    for entry in entries:
        name, sign, text = entry.partition("=")
        if not (sign and name.strip() and text.strip()):
            raise InputError(
                f"--vary takes NAME=LAW, such as 'front.mass=Uniform(0.5, 2)', got {quoted(entry)}"
            )
        values[name.strip()] = text.strip()
    return values


def _outputs(entries: Sequence[str]) -> dict[str, str]:
    """Parse texts FIELD or NAME=FIELD."""
    values = {}
    for entry in entries:
        name, sign, field = entry.partition("=")
        values[name if sign else entry.removesuffix("(t)")] = field if sign else entry
    return values


def summary(result: SweepResult) -> str:
    """Return the number of points by status, and the quantiles of all scalar outputs."""
    import numpy as np

    status = result["status"].values
    lines = [
        f"{result.attrs['robot']}: {len(status)} points, {int((status == 2).sum())} failed, "
        f"{int((status == 3).sum())} rejected"
    ]
    for name, values in result.data_vars.items():
        if values.dims != ("point",) or name == "status":
            continue
        quantiles = np.nanquantile(values.values, _QUANTILES)
        unit = values.attrs.get("units", "")
        shown = ", ".join(f"{value:.6g}" for value in quantiles)
        percents = ", ".join(f"{100 * part:.0f}" for part in _QUANTILES)
        lines.append(f"  {name}{f' [{unit}]' if unit else ''}: {shown} at {percents} %")
    return "\n".join(lines)

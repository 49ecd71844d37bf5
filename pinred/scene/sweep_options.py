"""Descriptions of the options of a sweep: for `[sweep]` in scene files, and `pinred sweep`.

The parameters of `pinred.sweep` have the same names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from .scene_options import Option
from .toml.file_place import Place
from .toml.schema import ByName, Either, Key, ListOf, Node, Schema, Table, Text, Whole
from .toml.signal_tables import NUMBERS

Sampler: TypeAlias = Literal["sobol", "latin", "random", "grid"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)
BLOCK = 16_384  # default number of points of a block


@dataclass(frozen=True)
class Laws(Node):
    """A table from names of numbers to distributions; nested tables extend the names."""

    types = (dict,)
    words = 'a table {name = "Uniform(0.5, 2)" or list of numbers}'
    name = "distributions"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        """Return {name with dots: text or list of numbers}."""
        laws: dict[str, Any] = {}
        for name, entry in value.items():
            if isinstance(entry, dict):
                nested = self.read(entry, place / name)
                read = {f"{name}.{end}": law for end, law in nested.items()}
            else:
                read = {name: _LAW.read(entry, place / name)}
            for key, law in read.items():
                if key in laws:
                    (place / name).fail(f"'{key}' is stated twice")
                laws[key] = law
        return laws

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        return {
            "type": "object",
            "additionalProperties": {"anyOf": [_LAW.schema(defs), self.schema(defs)]},
        }


_LAW = Either((Text((), 'a distribution, such as "Uniform(0.5, 2)"'), NUMBERS))


def _option(node: Node, text: str, default: str, command: str, **more: Any) -> Option:
    return Option(node, text, default=default, table="sweep", command=command, **more)


SWEEP_OPTIONS: Mapping[str, Option] = {
    "vary": Option(
        Laws(),
        "numbers of the scene or robot that vary, each with its distribution: Uniform(low, high), "
        "LogUniform(low, high), Normal(mean, deviation), Grid(low, high, count), or a list",
        required=True, table="sweep", command="--vary NAME=LAW",
    ),
    "points": _option(
        Whole(1), "number of points", "the product of all lists, for the sampler grid", "--points N"
    ),
    "sampler": _option(
        Text(SAMPLERS), f"sampler: {', '.join(SAMPLERS)}", "sobol, or grid without points",
        "--sampler S",
    ),
    "seed": _option(Whole(), "seed of the sampler", "0", "--seed S"),
    "outputs": _option(
        Either((ListOf(Text()), ByName(Text()))),
        "what to store, by name: a field at the end of the motion, such as pose or pose.θ, or at "
        "all report times, such as pose(t); or turn, position(FRAME), peak_torque, excursion",
        "x, xdot, pose and energy", "--outputs [NAME=]FIELD",
    ),
    "store": _option(
        Text((), "the name of a .zarr folder"),
        "zarr folder of the results; if it exists, the sweep continues",
        "a temporary folder", "--store FOLDER",
    ),
    "scheduler": _option(
        Text((), "an address such as tcp://host:8786"),
        "address of a Dask scheduler, whose workers compute the blocks", "local threads",
        "--scheduler ADDRESS",
    ),
    "block": _option(
        Whole(1), "number of points of a block, which is stored at once", str(BLOCK), "--block N"
    ),
}  # fmt: skip
# The table of a scene file.
SWEEP = Key(Table(SWEEP_OPTIONS, "a sweep"), "numbers that `pinred sweep` varies")

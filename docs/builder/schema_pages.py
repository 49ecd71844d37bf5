"""The reference of gait files, from their JSON Schema."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[2] / "tests/helpers"))

from scene_tables import table

import pinred

LEAD = """# Gait files

Write a gait, a connection, or the options of an optimisation into a TOML file. Use it with
`pinred phase`, `gait`, `reorient` and `field`, or in Python with `pinred.load_gait`. The tables are
those of `pinred.gait_schema()`; keys in bold are required. [Scene files](../scenes.md) describe
simulations.
"""


def pages() -> dict[str, str]:
    """Return the page of gait files."""
    schema = pinred.gait_schema()
    defs = schema.get("$defs", {})
    parts = [LEAD, table("The file", schema, defs)]
    for name, part in schema["properties"].items():
        parts += [table(title, found, defs) for title, found in tables(f"[{name}]", part)]
    return {"gaits": "\n".join(parts).replace("\n### ", "\n## ")}


def tables(title: str, schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the tables of a part of a schema, those of variants by their kind."""
    for variant in schema.get("oneOf", schema.get("anyOf", [])):
        kind = variant.get("properties", {}).get("kind", {}).get("enum", [""])[0]
        yield from tables(f"{title} `{kind}`" if kind else title, variant)
    if "properties" in schema:
        yield f"{title}" if "`" in title else f"`{title}`", schema
        for name, part in schema["properties"].items():
            inner = part.get("additionalProperties") or part.get("items") or {}
            if isinstance(inner, dict) and ("properties" in inner or "oneOf" in inner):
                yield from tables(f"{title} `{name}`", inner)

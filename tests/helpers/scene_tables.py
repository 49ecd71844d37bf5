"""The tables of docs/scenes.md, from the JSON Schema.  Run it to write them again."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pinred
from pinred.scene.toml.reader import IMPACTS

DOCUMENT = Path(__file__).parents[2] / "docs/scenes.md"
START = "<!-- tables: written by tests/helpers/scene_tables.py -->\n"
END = "<!-- end of tables -->\n"


def kind_of(schema: dict[str, Any], defs: dict[str, Any]) -> str:
    """The type of a value, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        known = {
            "signal": "a signal",
            "plan": "a signal; for a ball a list of 3 signals, a quaternion or an `attitude` table",
            "attitude": "list of 3 signals, a quaternion or an `attitude` table",
            "parameters": "by name: number, or list of numbers",
            "controls": "by actuator: number, text, or a signal table",
            "distributions": "by name: text, or list of numbers",
        }
        return known.get(name) or kind_of(defs[name], defs)
    if "anyOf" in schema:
        return ", or ".join(kind_of(part, defs) for part in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if schema.get("type") == "array":
        many = f"{schema['minItems']}: " if "minItems" in schema else ""
        items = kind_of(schema["items"], defs)
        return f"list of {many}" + re.sub(r"^number\b", "number" if many else "numbers", items)
    if schema.get("type") == "object" and isinstance(schema["additionalProperties"], dict):
        return f"by joint: {kind_of(schema['additionalProperties'], defs)}"
    if schema.get("type") == "number" and "exclusiveMinimum" in schema:
        return "number above 0"
    names = {"string": "text", "integer": "whole number", "boolean": "true or false"}
    plain = str(schema.get("type", "table"))
    return {"object": "table"}.get(plain, names.get(plain, plain))


def table(title: str, schema: dict[str, Any], defs: dict[str, Any]) -> str:
    """A heading and a row for each key; what has to be there is in bold."""
    rows = [f"### {title}\n", "| key | value | meaning |", "|---|---|---|"]
    for name, key in schema["properties"].items():
        bold = "**" if name in schema.get("required", ()) else ""
        meaning = key["description"].replace("|", "\\|")
        rows.append(f"| {bold}`{name}`{bold} | {kind_of(key, defs)} | {meaning} |")
    return "\n".join(rows) + "\n"


def tables() -> str:
    """All tables."""
    schema = pinred.scene_schema()
    defs, keys = schema["$defs"], schema["properties"]
    out = [table("The file", schema, defs)]
    out += [table(f"`[{name}]`", keys[name], defs) for name in ("load", "start", "run", "sweep")]
    for one in keys["run"]["properties"]["method"]["anyOf"][1]["oneOf"]:
        out.append(table(f"`run.method`: {one['properties']['name']['enum'][0]}", one, defs))
    signals = defs["plan_table"]["properties"]
    out += [table(f"signal `{{ {name} = {{ … }} }}`", signals[name], defs) for name in signals]
    for one in keys["forces"]["items"]["oneOf"]:
        out.append(
            table(f'`[[forces]]` `kind = "{one["properties"]["kind"]["enum"][0]}"`', one, defs)
        )
    out.append(table("`[[events]]`", keys["events"]["items"], defs))
    phase = keys["phases"]["items"]
    out.append(table("`[[phases]]`", phase, defs))
    impacts = phase["properties"]
    out += [table(f"`phases.{name}`", impacts[name], defs) for name in IMPACTS]
    return "\n".join(out)


def document() -> str:
    """docs/scenes.md with the tables as they should be."""
    text = DOCUMENT.read_text(encoding="utf-8")
    head, rest = text.split(START)
    return head + START + "\n" + tables() + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    DOCUMENT.write_text(document(), encoding="utf-8")

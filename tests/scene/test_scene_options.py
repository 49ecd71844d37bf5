"""Each scene option is described once, in scene_options.py, and everything else is derived."""

from __future__ import annotations

import argparse
import io
import tokenize
from dataclasses import fields
from pathlib import Path

import pytest
import scene_tables

import pinred
from pinred.cli.command_options import add_options
from pinred.cli.command_options import options_in as options_in_arguments
from pinred.scene.scene_options import (
    RUN_OPTIONS,
    SCENE_OPTIONS,
    Option,
    describe_fields,
    list_conflicts,
)
from pinred.scene.toml.reader import FILE_OPTIONS, options_in, scene_table
from pinred.scene.toml.schema import Place, document_schema
from pinred.scene.toml.value_tables import POSITIVE

PACKAGE = Path(pinred.__file__).parent


def test_new_option_reaches_files_schema_docs_and_command_line() -> None:
    """One description suffices for the reader, the schema, the docs, --help and Scene's help."""
    drag = Option(
        POSITIVE, "drag coefficient [N·s/m]", default="0.1", formats="a number", table="run",
        command="--drag C", replaces=("rtol",), scope="a tolerance",
    )  # fmt: skip
    options = {**FILE_OPTIONS, "drag": drag}
    table = scene_table(options)
    document = table.read({"robot": "falling_cat", "run": {"drag": 2}}, Place("scene.toml"))
    assert options_in(document, options) == {"drag": 2.0}
    with pytest.raises(pinred.InputError, match=r"run\.drag: must be a number above 0"):
        table.read({"robot": "falling_cat", "run": {"drag": "2"}}, Place("scene.toml"))
    schema = document_schema(table, "scene")
    run = schema["properties"]["run"]
    assert run["properties"]["drag"] == {
        "type": "number", "exclusiveMinimum": 0,
        "description": "drag coefficient [N·s/m] (default: 0.1)",
    }  # fmt: skip
    row = "| `drag` | number above 0 | drag coefficient [N·s/m] (default: 0.1) |"
    assert row in scene_tables.table("run", run, schema["$defs"])
    parser = argparse.ArgumentParser()
    add_options(parser, options)
    assert options_in_arguments(parser.parse_args(["--drag", "3"]), options) == {"drag": 3.0}
    assert options_in_arguments(parser.parse_args([]), options) == {}
    assert "--drag C" in parser.format_help()
    assert "drag: a number.  Drag coefficient [N·s/m].  Default: 0.1." in describe_fields(options)
    assert ("rtol", "drag") in list_conflicts(options)


def test_every_field_of_scene_has_a_description() -> None:
    """The descriptions are complete, and `help(pinred.Scene)` shows all of them."""
    assert list(SCENE_OPTIONS) == [entry.name for entry in fields(pinred.Scene)][1:]
    for name, option in {**SCENE_OPTIONS, **RUN_OPTIONS}.items():
        assert option.text, name
        assert option.default, name
        assert option.table in ("", "start", "run"), name
    for name in SCENE_OPTIONS:
        assert f"\n        {name}: " in str(pinred.Scene.__doc__)


def test_every_description_occurs_in_one_file() -> None:
    """No other file of the package repeats the meaning of an option."""
    sources = {path: path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    for option in FILE_OPTIONS.values():
        start = option.text[:30]
        assert [path.name for path in sources if start in sources[path]] == ["scene_options.py"]


def words_of(path: Path) -> set[str]:
    """The names and texts in the code of a file."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    return {token.string.strip("\"'") for token in tokens}


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("keyframe", {"scene_options.py", "scene.py"}),
        ("q0", {"scene_options.py", "scene.py", "parse_options.py"}),
        ("pose0", {"scene_options.py", "scene.py", "reader.py"}),
    ],
)
def test_option_touches_at_most_three_files(option: str, expected: set[str]) -> None:
    """Reader, schema, docs and command line do not name the options that need no conversion."""
    paths = [path for folder in ("scene", "cli") for path in (PACKAGE / folder).rglob("*.py")]
    assert {path.name for path in paths if option in words_of(path)} == expected

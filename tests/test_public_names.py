"""Public names: all of them are documented, with all of their parameters."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import api_index
import site_pages

import pinred

ROOT = Path(__file__).parent.parent
_ENTRY = r" +((?:\*{0,2}\w+, )*\*{0,2}\w+)(?: \(.*?\))?:"  # such as `x, xdot (Array): …`


def unnamed_parameters(function: Callable[..., Any], doc: str) -> list[str]:
    """Return the parameters that the docstring does not describe.

    A parameter is described by an entry under Args or Attributes, or by its name with its shape,
    as in "the shape x (m,)".
    """
    try:
        parameters = inspect.signature(function).parameters
    except ValueError:  # a type alias or a built-in
        return []
    listed, section = {"self", "cls"}, ""
    for line in inspect.cleandoc(doc).splitlines():
        if heading := re.fullmatch(r" *(Args|Attributes|Returns|Yields|Raises):", line):
            section = heading[1]
        elif section in ("Args", "Attributes") and (entry := re.match(_ENTRY, line)):
            listed.update(entry[1].replace("*", "").split(", "))
    return [
        name
        for name in parameters
        if not (name in listed or name.startswith("_") or re.search(rf"\b{name} \(", doc))
    ]


def test_docstrings_list_all_public_parameters() -> None:
    """Every parameter of every public callable stands under Args or Attributes."""
    missing = {
        name: parameters
        for name, function, doc in api_index.public_callables()
        if (parameters := unnamed_parameters(function, doc))
    }
    assert not missing, "\n".join(f"{name}: {', '.join(p)}" for name, p in missing.items())


def test_missing_parameter_is_detected() -> None:
    """A parameter that only the prose mentions, or none of it, is reported."""

    def function(x: float, y: float, z: float) -> None:  # noqa: D417
        """Use x.

        Args:
            y: A number.
        """

    assert unnamed_parameters(function, function.__doc__ or "") == ["x", "z"]


def test_index_of_public_names_is_complete() -> None:
    """docs/api.md has all public names with today's descriptions."""
    assert api_index.index() in api_index.DOCUMENT.read_text("utf-8"), (
        "run `python tests/helpers/api_index.py`"
    )


def test_public_names_appear_in_docs_or_examples() -> None:
    """Every public name is used or explained in a page, an example or the README."""
    pages = [ROOT / "README.md", *site_pages.sources(), *(ROOT / "examples").rglob("*.py")]
    text = "\n".join(page.read_text("utf-8") for page in pages)
    words = set(re.findall(r"\w+", text))
    assert [name for name in api_index.public_names() if name.rpartition(".")[2] not in words] == []


def test_hooks_of_integrators_are_private() -> None:
    """Users set the options of a method; its compiled steps and registers are internal."""
    for name in ("DOP853", "Tsit5", "RKMK4", "Gauss", "AdaptiveGauss", "Radau", "Variational"):
        method = getattr(pinred, name)
        public = {entry for entry in dir(method) if not entry.startswith("_")}
        assert not public & {"stepper", "registers"}
        assert {"_stepper", "_registers"} <= set(dir(method))

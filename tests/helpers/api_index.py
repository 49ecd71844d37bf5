"""Public names and their one-sentence descriptions; run it to write the index of docs/api.md."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

DOCUMENT = Path(__file__).parents[2] / "docs/api.md"
START = "<!-- index: written by tests/helpers/api_index.py -->\n"
END = "<!-- end of index -->\n"
# Modules that users import names from.
NAMESPACES = (
    *("pinred", "pinred.forces", "pinred.signals", "pinred.lie", "pinred.plots"),
    *("pinred.equations", "pinred.poisson", "pinred.laboratory.bench"),
)


def public_names() -> dict[str, Any]:
    """Return all public names with their values, as `namespace.name`."""
    names = {}
    for namespace in NAMESPACES:
        module = import_module(namespace)
        for name in sorted(getattr(module, "__all__", dir(module))):
            value = getattr(module, name)
            if not (name.startswith("_") or inspect.ismodule(value)):
                names[f"{namespace}.{name}"] = value
    return names


def public_callables() -> Iterator[tuple[str, Any, str]]:
    """Yield all public functions, classes with fields, and public methods of public classes.

    Yields:
        The full name, the callable, and its docstring. The docstring of a class is that of the
        class and of its `__init__`.
    """
    for name, value in public_names().items():
        if inspect.isclass(value):
            if not issubclass(value, Exception):
                extra = "" if is_dataclass(value) else (value.__init__.__doc__ or "")
                yield name, value, (value.__doc__ or "") + extra
            for attribute, method in vars(value).items():
                function = getattr(method, "__func__", method)
                if inspect.isfunction(function) and (
                    not attribute.startswith("_") or attribute == "__call__"
                ):
                    yield f"{name}.{attribute}", function, _inherited_doc(value, attribute)
        elif callable(value):
            yield name, value, value.__doc__ or ""


def _inherited_doc(owner: type, attribute: str) -> str:
    """Return the docstrings of a method and of the methods that it overrides."""
    docs = (getattr(vars(kind).get(attribute), "__doc__", None) for kind in owner.__mro__)
    return "\n\n".join(inspect.cleandoc(doc) for doc in docs if doc)


def first_sentence(value: Any) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(value) or "").split("\n\n")[0].replace("\n", " ")


def index() -> str:
    """Return the tables of public names, one per namespace."""
    lines: list[str] = []
    previous = ""
    for full, value in public_names().items():
        namespace, _, name = full.rpartition(".")
        if namespace != previous:
            lines += ["", f"## `{namespace}`", "", "| name | description |", "|---|---|"]
            previous = namespace
        described = inspect.isclass(value) or callable(value)
        text = first_sentence(value) if described else f"A constant of type {type(value).__name__}."
        escaped = re.sub(r"([|*])", r"\\\1", text)
        lines.append(f"| `{name}` | {escaped} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the index into the document."""
    before, _, tail = DOCUMENT.read_text("utf-8").partition(START)
    DOCUMENT.write_text(before + START + index() + "\n" + END + tail.partition(END)[2], "utf-8")


if __name__ == "__main__":
    main()

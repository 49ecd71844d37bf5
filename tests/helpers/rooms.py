"""The rooms of the package and the imports between them; run it to draw them again in the docs."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "pinred"
# From the ground up: a room imports from those before it, and from itself.
ROOMS = (
    *("common", "lie", "system", "reduction", "forces", "integrators", "kernels", "scene"),
    *("simulation", "analysis", "judge", "planning", "views", "laboratory", "cli"),
)
DOCUMENT = ROOT / "docs/architecture.md"
START, END = "<!-- rooms: written by tests/helpers/rooms.py -->\n", "<!-- end of rooms -->\n"


@dataclass(frozen=True)
class Import:
    """One import: the module that has it, the line, and the module that it needs."""

    by: str
    line: int
    of: str

    @property
    def rooms(self) -> tuple[str, str]:
        """The rooms of both; "" is the package itself, its faces and its entry."""
        return room_of(self.by), room_of(self.of)


def room_of(module: str) -> str:
    """The room of a module, as its name says."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ROOMS else ""


def modules() -> dict[str, Path]:
    """All modules of the package, by their names."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports() -> list[Import]:
    """All imports of the package by the package: lazy ones, those for types, and stubs' too."""
    known = modules()
    found = []
    for name, path in known.items():
        stub = path.with_suffix(".pyi")
        for file in (path, stub) if stub.exists() else (path,):
            for line, needed in _needed(file, name, is_package=path.name == "__init__.py"):
                of = needed
                while of and of not in known:  # a name in a module, not a module
                    of = of.rpartition(".")[0]
                if of and of != name:
                    found.append(Import(name, line, of))
    return found


def _needed(file: Path, name: str, *, is_package: bool) -> Iterator[tuple[int, str]]:
    """Lines and full names of what a file imports."""
    here = name.split(".") if is_package else name.split(".")[:-1]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(here[: len(here) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def upward(found: Iterable[Import]) -> list[Import]:
    """The imports of a room above one's own, or, from within a room, of the package's faces."""
    order = {room: k for k, room in enumerate(ROOMS)}
    wrong = []
    for each in found:
        by, of = each.rooms
        if by and (not of or order[of] > order[by]):
            wrong.append(each)
    return wrong


def circle(found: Iterable[Import]) -> list[str]:
    """Modules that import each other in a circle, or none.

    A package that hands on the names of its own modules does not count as importing them.
    """
    graph: dict[str, set[str]] = {}
    for each in found:
        if not each.of.startswith(f"{each.by}."):
            graph.setdefault(each.by, set()).add(each.of)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def arrows(found: Iterable[Import]) -> dict[str, set[str]]:
    """The rooms that each room imports."""
    out: dict[str, set[str]] = {room: set() for room in ROOMS}
    for each in found:
        by, of = each.rooms
        if by and of and by != of:
            out[by].add(of)
    return out


def needed_arrows(direct: dict[str, set[str]]) -> dict[str, set[str]]:
    """The arrows that are no detour: a room that is reached over another one is left out."""
    reached: dict[str, set[str]] = {}
    for room in ROOMS:
        reached[room] = set().union(*({of, *reached[of]} for of in direct[room]))
    return {
        room: {of for of in direct[room] if not any(of in reached[via] for via in direct[room])}
        for room in ROOMS
    }


def drawing() -> str:
    """The rooms as a Mermaid diagram and a table of what each holds."""
    direct = arrows(imports())
    lines = ["```mermaid", "graph TD"]
    for room, needed in needed_arrows(direct).items():
        lines += [f"    {room} --> {of}" for of in sorted(needed, key=ROOMS.index)]
    lines += ["```", "", "| room | what lives there | imports |", "|---|---|---|"]
    for room in reversed(ROOMS):
        text = ast.get_docstring(ast.parse((PACKAGE / room / "__init__.py").read_text("utf-8")))
        assert text is not None
        first = text.split("\n\n")[0].replace("\n", " ").rstrip(".").split(".  Imports")[0]
        below = sorted(direct[room], key=ROOMS.index)
        lines.append(f"| `{room}` | {first} | {', '.join(below) or 'nothing'} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the drawing into the document."""
    before, _, rest = DOCUMENT.read_text("utf-8").partition(START)
    after = rest.partition(END)[2]
    DOCUMENT.write_text(before + START + "\n" + drawing() + "\n" + END + after, "utf-8")


if __name__ == "__main__":
    main()

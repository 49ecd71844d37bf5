"""Docstrings with Google sections as Markdown with tables."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

_HEADING = re.compile(r"^(Args|Attributes|Returns|Yields|Raises):\s*$")
_ENTRY = re.compile(r"^((?:\*{0,2}\w+, )*\*{0,2}\w+)(?: \(.*?\))?:\s?(.*)$")


@dataclass
class Docstring:
    """A docstring in parts.

    Attributes:
        prose: Everything before the first section.
        sections: Lines of each section, without their indentation.
    """

    prose: str = ""
    sections: dict[str, list[str]] = field(default_factory=dict)

    def entries(self, section: str) -> dict[str, str]:
        """Return the descriptions of a section by name."""
        entries: dict[str, str] = {}
        names: list[str] = []
        for line in self.sections.get(section, []):
            match = None if line.startswith(" ") else _ENTRY.match(line)
            if match:
                names = [name.lstrip("*") for name in match[1].split(", ")]
                entries.update(dict.fromkeys(names, match[2].strip()))
            else:
                for name in names:
                    entries[name] = f"{entries[name]} {line.strip()}".strip()
        return entries


def parse(doc: str | None) -> Docstring:
    """Split a docstring into prose and sections."""
    parsed, section, prose = Docstring(), "", []
    for line in inspect.cleandoc(doc or "").splitlines():
        if heading := _HEADING.match(line):
            section = heading[1]
            parsed.sections[section] = []
        elif section and (line.startswith("    ") or not line.strip()):
            parsed.sections[section].append(line[4:])
        else:
            section = ""
            prose.append(line)
    parsed.prose = "\n".join(prose).strip()
    return parsed


def escape(text: str, *, in_table: bool = False) -> str:
    """Escape characters that Markdown would interpret; code in backticks stays.

    Args:
        text: Plain text with code in backticks.
        in_table: Whether the text is a cell of a table, where `|` separates cells.
    """
    parts = re.split(r"(`[^`\n]*`)", text)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"([\\*_<>\[\]{}$#~])", r"\\\1", parts[k])
    joined = "".join(parts)
    return joined.replace("|", "\\|").replace("\n", " ") if in_table else joined


def table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table; cells are Markdown."""
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def code(text: str) -> str:
    """Return code for a cell of a table, or nothing."""
    return f"`{text}`".replace("|", "\\|").replace("\n", " ") if text else ""

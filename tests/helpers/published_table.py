"""The table of published results; run it to write the table of docs/published.md."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pinred.laboratory.published.row import ROWS, Result

DOCUMENT = Path(__file__).parents[2] / "docs/published.md"
START = "<!-- table: written by tests/helpers/published_table.py -->\n"
END = "<!-- end of table -->\n"


def table(results: Iterable[Result]) -> str:
    """Return the table with one line per row."""
    lines = [
        "| row | quantity | published or closed form | pinred | difference | source |",
        "|---|---|---|---|---|---|",
    ]
    for result in results:
        row = result.row
        cells = (
            f"`{row.name}`", row.quantity, result.expected, result.found,
            f"{result.difference:.0e}", row.source,
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def cells() -> dict[str, list[str]]:
    """Return the cells of the document's table by the name of the row."""
    text = DOCUMENT.read_text(encoding="utf-8")
    lines = text[text.index(START) : text.index(END)].splitlines()
    rows = [
        [cell.strip() for cell in line.strip("|").split(" | ")] for line in lines if "`" in line
    ]
    return {row[0].strip("` "): row[1:] for row in rows}


def document(results: Iterable[Result]) -> str:
    """Return the document with a new table."""
    text = DOCUMENT.read_text(encoding="utf-8")
    return (
        text[: text.index(START)] + START + "\n" + table(results) + "\n" + text[text.index(END) :]
    )


if __name__ == "__main__":
    DOCUMENT.write_text(document([row.run() for row in ROWS.values()]), encoding="utf-8")

"""Sphinx extension: tables with many columns become lists of rows in narrow windows.

Each cell gets the heading of its column as an attribute, which site.css writes before the cell.
"""

from __future__ import annotations

import re
from html import escape, unescape
from typing import Any

LEAST = 4  # number of columns of a table that does not fit into a narrow window
_WIDE = 6  # number of columns of a table that is set smaller in all windows
_TABLE = re.compile(r'<table class="docutils[^"]*">.*?</table>', re.DOTALL)
_HEADING = re.compile(r"<th\b[^>]*>(.*?)</th>", re.DOTALL)
_CELL = re.compile(r"<td\b[^>]*>(.*?)</td>", re.DOTALL)
_ROW = re.compile(r"<tr\b.*?</tr>", re.DOTALL)


def label_cells(html: str) -> str:
    """Return a page whose wide tables have the class `stacks` and labels in their cells.

    Args:
        html: The page.
    """
    return _TABLE.sub(lambda match: _labelled(match[0]), html)


def _labelled(table: str) -> str:
    headings = [" ".join(re.sub(r"<[^>]+>", " ", text).split()) for text in _HEADING.findall(table)]
    if len(headings) < LEAST:
        return table

    def row(match: re.Match[str]) -> str:
        labels = iter(headings)

        def cell(found: re.Match[str]) -> str:
            label, text = escape(unescape(next(labels, ""))), re.sub(r"<[^>]+>", "", found[1])
            attribute = f'data-label="{label}"' if text.strip() else 'data-blank=""'
            return found[0].replace("<td", f"<td {attribute}", 1)

        return _CELL.sub(cell, match[0])

    kind = "stacks wide" if len(headings) >= _WIDE else "stacks"
    return _ROW.sub(row, table.replace('class="docutils', f'class="{kind} docutils', 1))


def _on_page(app: Any, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    del app, page, template, doctree
    if "body" in context:
        context["body"] = label_cells(context["body"])


def setup(app: Any) -> dict[str, bool]:
    """Register the extension."""
    app.connect("html-page-context", _on_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

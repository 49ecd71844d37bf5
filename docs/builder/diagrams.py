"""Diagrams of Mermaid as SVG, for graphs of packages: `graph TD` with arrows `a --> b`."""

from __future__ import annotations

import re
from html import escape

WIDTH, HEIGHT, STEP_X, STEP_Y = 104, 30, 128, 70  # of a box, and between boxes [px]


def layers_of(arrows: list[tuple[str, str]]) -> list[list[str]]:
    """Return the nodes in layers, so that every arrow points downwards.

    Args:
        arrows: Start and end of each arrow; the graph has no cycles.
    """
    depth = dict.fromkeys((name for arrow in arrows for name in arrow), 0)
    for _ in depth:
        for start, end in arrows:
            depth[end] = max(depth[end], depth[start] + 1)
    return [[n for n in depth if depth[n] == k] for k in range(max(depth.values()) + 1)]


def draw(text: str) -> str:
    """Return a diagram as SVG within HTML.

    Args:
        text: Lines of a Mermaid graph.
    """
    arrows = re.findall(r"^\s*(\w+) --> (\w+)$", text, re.MULTILINE)
    layers = layers_of(arrows)
    width = max(map(len, layers)) * STEP_X
    place = {
        name: (width / 2 + (k - (len(layer) - 1) / 2) * STEP_X, 20 + row * STEP_Y)
        for row, layer in enumerate(layers)
        for k, name in enumerate(layer)
    }
    parts = []
    for start, end in arrows:
        (x1, y1), (x2, y2) = place[start], place[end]
        bottom, top = y1 + HEIGHT / 2, y2 - HEIGHT / 2 - 5
        middle = (bottom + top) / 2
        curve = f"M{x1:g},{bottom:g} C{x1:g},{middle:g} {x2:g},{middle:g} {x2:g},{top:g}"
        parts.append(f'<path class="arrow" d="{curve}" marker-end="url(#tip)"/>')
    for name, (x, y) in place.items():
        corner = f'x="{x - WIDTH / 2:g}" y="{y - HEIGHT / 2:g}"'
        parts.append(f'<rect {corner} width="{WIDTH}" height="{HEIGHT}" rx="5"/>')
        parts.append(f'<text x="{x:g}" y="{y + 5:g}">{escape(name)}</text>')
    head = f'<svg class="diagram" viewBox="0 0 {width} {len(layers) * STEP_Y - 20}" role="img">'
    tip = '<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="2" refY="3" orient="auto">'
    return f'{head}{tip}<path d="M0,0 L6,3 L0,6 z"/></marker></defs>{"".join(parts)}</svg>'

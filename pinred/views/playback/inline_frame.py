"""Pages inside notebook cells: an iframe that contains the page and may only run scripts."""

from __future__ import annotations

import sys
from html import escape

_HEIGHT = 520  # initial height; the cell can be resized at its lower edge [px]


def inline_frame(content: bytes) -> str:
    """Return an HTML element that shows a page in a notebook cell, without a server.

    Args:
        content: The page, in UTF-8.
    Returns:
        A resizable iframe.  The page in it has no access to the notebook.
    """
    page = escape(content.decode("utf-8"), quote=True)
    return (
        f'<div style="position:relative;resize:vertical;overflow:hidden;height:{_HEIGHT}px;'
        'min-height:240px">'
        f'<iframe sandbox="allow-scripts" title="pinred" srcdoc="{page}" '
        # marimo puts an element of its own between these two, so a height of 100 % has no effect.
        'style="position:absolute;top:0;left:0;width:100%;height:calc(100% - 8px);border:0">'
        "</iframe></div>"
    )


def is_notebook() -> bool:
    """Return whether the process is the kernel of a notebook, which displays results as HTML."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if getattr(shell, "kernel", None) is not None:
        return True
    return bool(getattr(sys.modules.get("marimo"), "running_in_notebook", lambda: False)())

"""Formulas as MathML, which browsers draw without scripts, with a font of the site."""

from __future__ import annotations

import re
import shutil
from importlib.util import find_spec
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

_DIGITS = re.compile(r"\\([tdc]?frac)\s*(\d)\s*(\d)")  # such as \tfrac12

_ACCENT = re.compile(r'<mover accent="true">\s*<mi>(.)</mi>\s*<mo[^>]*>(.)</mo>\s*</mover>')
_COMBINING = {"˙": "\u0307", "¨": "\u0308"}  # those of time derivatives


def convert(formula: str, *, as_block: bool = False) -> str:
    """Return a formula in LaTeX as MathML."""
    # The converter of docutils reads the 12 of \tfrac12 as one number.
    formula = _DIGITS.sub(r"\\\1{\2}{\3}", formula)
    return _ACCENT.sub(_combine, str(tex2mathml(formula, as_block=as_block)))


def _combine(match: re.Match[str]) -> str:
    """Return a letter with its accent as one text; browsers draw accents of `mover` too low."""
    letter, accent = match.groups()
    if accent not in _COMBINING:
        return match[0]
    return f"<mi>{italic(letter)}{_COMBINING[accent]}</mi>"


def italic(letter: str) -> str:
    """Return the italic form of a Latin or Greek letter, which `mi` uses for single letters."""
    for first, last, start in (("A", "Z", 0x1D434), ("a", "z", 0x1D44E),
                               ("Α", "Ω", 0x1D6E2), ("α", "ω", 0x1D6FC)):  # fmt: skip
        if first <= letter <= last and letter != "h":
            return chr(start + ord(letter) - ord(first))
    return "ℎ" if letter == "h" else letter


def copy_font(folder: Path) -> None:
    """Copy the font STIX Two Math from the package ziamath, if it is installed.

    Args:
        folder: Folder of static files. Without the font, browsers use their own.
    """
    spec = find_spec("ziamath")
    if spec is not None and spec.submodule_search_locations:
        source = Path(spec.submodule_search_locations[0]) / "fonts/STIXTwoMath-Regular.ttf"
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, folder / "STIXTwoMath.ttf")


def write_inline(writer: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def write_block(writer: HTML5Translator, node: nodes.math_block) -> None:
    """Write a displayed formula."""
    formula = convert(node.astext(), as_block=True)
    writer.body.append(f'<div class="formula">{formula}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the renderer `mathml`."""
    copy_font(Path(app.srcdir) / "generated/static")
    app.add_html_math_renderer("mathml", (write_inline, None), (write_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}

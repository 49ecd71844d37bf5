"""The pages of docs/ that people write, and their code."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.append(str(DOCS / "builder"))  # the modules that write the other pages


def sources() -> list[Path]:
    """Return the Markdown files of docs/ without the pages that a build writes."""
    generated = DOCS / "generated"
    return sorted(path for path in DOCS.rglob("*.md") if generated not in path.parents)


def python_blocks(text: str) -> list[str]:
    """Return the Python blocks of a page, in order."""
    return re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def console_commands(text: str) -> list[str]:
    """Return the commands `pinred …` of the console blocks of a page, without comments."""
    blocks = re.findall(r"^```console\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = re.findall(r"^\$ pinred (.*?)(?:\s+#.*)?$", "\n".join(blocks), re.MULTILINE)
    return [line.strip() for line in lines]

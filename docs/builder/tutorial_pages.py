"""The tutorials as pages, with outputs and figures if they have been run.

`python docs/builder/tutorial_pages.py docs/generated/runs` runs all tutorials.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import os
import re
import sys
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from docstring_markdown import escape
from github_markdown import convert

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "examples/tutorials"


@dataclass(frozen=True)
class Cell:
    """A cell of a tutorial.

    Attributes:
        is_text: Whether it is prose.
        body: Markdown or code.
    """

    is_text: bool
    body: str


def cells_of(text: str) -> list[Cell]:
    """Split a script at its lines `# %%`."""
    cells = []
    for part in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        kind, _, body = part.partition("\n")
        if kind.strip() == "[markdown]":
            lines = [line.removeprefix("#").removeprefix(" ") for line in body.strip().splitlines()]
            cells.append(Cell(True, "\n".join(lines)))
        else:
            cells.append(Cell(False, body.strip()))
    return cells


def key_of(text: str) -> str:
    """Return the key under which the run of a script is stored."""
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def run(path: Path, folder: Path) -> None:
    """Run a tutorial cell by cell; store its outputs and figures.

    Args:
        path: Script.
        folder: Folder of the results.
    """
    text = path.read_text("utf-8")
    scope: dict[str, Any] = {"__name__": "__main__"}
    outputs: list[dict[str, str]] = []
    for k, cell in enumerate(cells_of(text)):
        result = {"text": "", "figure": ""}
        if not cell.is_text:
            with redirect_stdout(io.StringIO()) as stream:
                value = execute(cell.body, str(path), scope)
            result["text"] = stream.getvalue()
            if hasattr(value, "savefig"):
                result["figure"] = f"{path.stem}_{k}.png"
                value.savefig(folder / result["figure"], dpi=110)
        outputs.append(result)
    stored = {"key": key_of(text), "outputs": outputs}
    (folder / f"{path.stem}.json").write_text(json.dumps(stored), "utf-8")


def execute(code: str, name: str, scope: dict[str, Any]) -> Any:
    """Run the code of a cell and return the value of its last expression, as notebooks do."""
    tree = ast.parse(code)
    last = tree.body.pop() if tree.body else None
    if isinstance(last, ast.Expr):
        exec(compile(tree, name, "exec"), scope)
        return eval(compile(ast.Expression(last.value), name, "eval"), scope)
    exec(compile(code, name, "exec"), scope)
    return None


def pages(runs: Path) -> dict[str, str]:
    """Return the pages of all tutorials.

    Args:
        runs: Folder of stored runs; tutorials without one are shown without outputs.
    """
    made = {}
    for path in sorted(TUTORIALS.glob("*.py")):
        made[f"examples/tutorials/{path.stem}_py"] = page(path, runs)
    return made


def page(path: Path, runs: Path) -> str:
    """Return the page of a tutorial."""
    text = path.read_text("utf-8")
    stored = runs / f"{path.stem}.json"
    outputs: list[dict[str, str]] = []
    if stored.exists():
        read = json.loads(stored.read_text("utf-8"))
        outputs = read["outputs"] if read["key"] == key_of(text) else []
    parts = []
    for k, cell in enumerate(cells_of(text)):
        if cell.is_text:
            name = f"generated/examples/tutorials/{path.stem}_py"
            parts.append(convert(cell.body, "examples/tutorials", name) + "\n")
            if k == 0:
                where = f"Run it: `python examples/tutorials/{path.name}`."
                parts.append(where if outputs else f"{where} It prints what its asserts check.")
                parts.append("")
        else:
            parts.append(f"```python\n{cell.body}\n```\n")
        if k < len(outputs):
            parts += show(outputs[k], escape(f"figure of {path.stem}"))
    return "\n".join(parts)


def show(output: dict[str, str], alt: str) -> list[str]:
    """Return the output of a cell as Markdown."""
    parts = []
    if output["text"].strip():
        parts.append(f"```text\n{output['text'].rstrip()}\n```\n")
    if output["figure"]:
        parts.append(f"![{alt}](../../runs/{output['figure']})\n")
    return parts


def main() -> None:
    """Run the tutorials whose results are missing; `--only NN` runs one."""
    folder = Path(sys.argv[1]).absolute()
    only = sys.argv[sys.argv.index("--only") + 1] if "--only" in sys.argv else ""
    folder.mkdir(parents=True, exist_ok=True)
    sys.path.insert(0, str(ROOT))
    for path in sorted(TUTORIALS.glob(f"{only}*.py")):
        stored = folder / f"{path.stem}.json"
        key = key_of(path.read_text("utf-8"))
        if stored.exists() and json.loads(stored.read_text("utf-8"))["key"] == key:
            continue
        print(path.name, flush=True)
        here = os.getcwd()
        run(path, folder)
        os.chdir(here)


if __name__ == "__main__":
    main()

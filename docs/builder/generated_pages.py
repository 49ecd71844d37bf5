"""Pages that are written from the project: reference, examples, tutorials, contributing."""

from __future__ import annotations

import sys
from pathlib import Path

import api_pages
import command_pages
import schema_pages
import tutorial_pages
from github_markdown import convert
from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
COPIES = {
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
    "robots/README.md": "bundled_robots",
}
_LANGUAGES = {".py": "python", ".toml": "toml", ".urdf": "xml", ".csv": "text"}


def copied_pages() -> dict[str, str]:
    """Return the Markdown files outside of docs/ as pages."""
    pages = {}
    for file, name in COPIES.items():
        text = (ROOT / file).read_text("utf-8")
        folder = file.rpartition("/")[0] or "."
        pages[name] = convert(text, folder, f"generated/{name}")
    return pages


def example_pages() -> dict[str, str]:
    """Return a page for each script and scene file in examples/, and their list."""
    folder = ROOT / "examples"
    files = sorted(
        path for path in folder.rglob("*") if path.suffix in _LANGUAGES and path.is_file()
    )
    pages, rows = {}, []
    for path in files:
        name = path.relative_to(folder).as_posix()
        if name.startswith("tutorials/"):
            continue
        page = f"examples/{name.replace('.', '_')}"
        text = path.read_text("utf-8").rstrip()
        fence = f"```{_LANGUAGES[path.suffix]}\n{text}\n```\n"
        pages[page] = f"# {name}\n\nRead or copy `examples/{name}`.\n\n{fence}"
        rows.append(name.replace(".", "_"))
    listed = "\n".join(rows)
    pages["examples/index"] = (
        "# Scripts and scene files\n\nCopy a script or a scene file that is close to your task. "
        "Tests run all scripts.\n\n"
        f"```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"
    )
    return pages


def write_pages(folder: Path) -> None:
    """Write all pages; leave those that have not changed, and delete those that are no more.

    Args:
        folder: Folder of the pages.
    """
    pages = {
        **copied_pages(),
        **example_pages(),
        **tutorial_pages.pages(folder / "runs"),
        **api_pages.pages(),
        **command_pages.pages(),
        **schema_pages.pages(),
    }
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text("utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
    for path in folder.rglob("*.md"):
        if path.relative_to(folder).with_suffix("").as_posix() not in pages:
            path.unlink()


def write_feel(path: Path) -> None:
    """Write the page that moves the falling cat by hand, if it is missing."""
    if not path.exists():
        import pinred

        pinred.save_html(pinred.load("falling_cat"), path, feel=True)


def _write(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "generated"
    write_pages(folder)
    if app.builder.format == "html":
        write_feel(folder / "extra/feel_the_cat.html")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for files."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))

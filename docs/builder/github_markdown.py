"""Markdown as GitHub reads it, for MyST: formulas, links out of docs/, diagrams, new pages."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

import diagrams
from api_pages import TASKS
from sphinx.application import Sphinx

_FENCE = re.compile(r"^(`{3,}|~{3,}).*?^\1[ ]*$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(\]\()(?!https?://|#|mailto:)([^)\s#]+)(#[^)\s]*)?(\))")
_FILE_NAME = re.compile(r"(?<!!)\[(?:docs/)?[\w/.-]+\.(?:md|py)\](?=\([^)\s]+\.md(?:#[^)]*)?\))")
_FORMULA = re.compile(r"\$`(.+?)`\$", re.DOTALL)
# Files outside of docs/, as seen from the root of the project, that are pages of the site.
PAGES = {
    "CONTRIBUTING.md": "generated/contributing",
    "CHANGELOG.md": "generated/changelog",
    "README.md": "index",
    "robots/README.md": "generated/bundled_robots",
    "examples": "generated/examples/index",
}
# Pages with a table of contents that GitHub does not show: {page: entries}.
CONTENTS = {
    "tutorials": "generated/examples/tutorials/*",
    "api": "\n".join([*(f"generated/api/{task.page}" for task in TASKS), "generated/api/pinred_*"]),
    "flow": "adapters/*",
}


def page_of(path: str) -> str | None:
    """Return the page that shows a file of the project, or None.

    Args:
        path: Path relative to the root of the project.
    """
    if path.startswith("docs/"):
        return path.removeprefix("docs/") if path.endswith(".md") else None
    if path.startswith("examples/") and not path.endswith("/"):
        return f"generated/{path.replace('.', '_')}.md"
    if path.startswith("robots/") and path.endswith((".urdf", ".toml")):
        return "generated/bundled_robots.md"
    return f"{PAGES[path]}.md" if path in PAGES else None


def rewrite_links(text: str, folder: str, page: str) -> str:
    """Replace links to files outside of docs/ by links to their pages.

    Args:
        text: Markdown without code blocks.
        folder: Folder of the source file, relative to the root of the project.
        page: Name of the page that shows the text, such as `howto/load`.
    """

    def replace(match: re.Match[str]) -> str:
        before, target, anchor, after = match.groups()
        shown = page_of(posixpath.normpath(posixpath.join(folder, target)))
        if shown is None:
            return match[0]
        path = posixpath.relpath(shown, posixpath.dirname(page) or ".")
        return f"{before}{path}{anchor or ''}{after}"

    # A link without text has the title of its page.
    return _FILE_NAME.sub("[]", _LINK.sub(replace, text))


def convert(text: str, folder: str, page: str) -> str:
    """Return Markdown of GitHub as Markdown of MyST; code blocks stay."""

    def convert_prose(prose: str) -> str:
        return _FORMULA.sub(r"$\1$", rewrite_links(prose, folder, page))

    parts, end = [], 0
    for fence in _FENCE.finditer(text):
        block = fence[0]
        if block.startswith("```mermaid"):
            block = f"```{{raw}} html\n{diagrams.draw(block)}\n```"
        parts += [convert_prose(text[end : fence.start()]), block]
        end = fence.end()
    return "".join([*parts, convert_prose(text[end:])])


def link_names(text: str) -> str:
    """Link the names in the tables of docs/api.md to their entries in the reference."""
    namespace, lines = "", []
    for line in text.splitlines():
        if heading := re.fullmatch(r"## `([\w.]+)`", line):
            namespace = heading[1]
        name = re.match(r"\| `(\w+)` \|", line)
        if namespace and name:
            link = f"| {{py:obj}}`{name[1]} <{namespace}.{name[1]}>` |"
            line = link + line[name.end() :]
        lines.append(line)
    return "\n".join(lines) + "\n"


def unlisted_pages(docs: Path) -> list[str]:
    """Return the pages directly in docs/ that no table of contents lists."""
    listed = set()
    for path in [docs / "index.md", *docs.glob("*/index.md")]:
        for block in re.findall(r"```\{toctree\}\n(.*?)```", path.read_text("utf-8"), re.DOTALL):
            listed.update(re.findall(r"^(?:.*<)?([\w/*]+)>?$", block, re.MULTILINE))
    pages = {path.stem for path in docs.glob("*.md")}
    return sorted(pages - listed - {"index"})


def _read(app: Sphinx, page: str, source: list[str]) -> None:
    text = source[0]
    if page == "index":
        more = "\n".join(unlisted_pages(Path(app.srcdir)))
        text = text.replace("<!-- pages that are not listed -->", more)
    if page == "api":
        tasks = ", ".join(f"[{task.title}](generated/api/{task.page}.md)" for task in TASKS)
        text = link_names(text).replace("<!-- pages by task -->", f"By task: {tasks}. By name:")
    if page in CONTENTS:
        text += f"\n```{{toctree}}\n:hidden:\n:glob:\n\n{CONTENTS[page]}\n```\n"
    folder = "docs/" + posixpath.dirname(page)
    source[0] = text if page.startswith("generated/") else convert(text, folder, page)


def setup(app: Sphinx) -> dict[str, bool]:
    """Convert each page when it is read."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

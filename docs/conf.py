"""Settings of the site: `python -m sphinx -W -b html docs site`, from the root of the project."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "builder")]

from pinred.common.errors import __version__  # noqa: E402

project, author, copyright = "pinred", "The pinred authors", "2026, the pinred authors"  # noqa: A001
version = release = __version__
extensions = [
    *("myst_parser", "sphinx_copybutton", "github_markdown", "mathml", "generated_pages"),
    "narrow_tables",
]
copybutton_prompt_text = "$ "  # is not copied
source_suffix = {".md": "markdown"}
exclude_patterns = ["builder"]
html_theme = "furo"
html_title = f"pinred {version}"
html_logo = html_favicon = "static/logo.svg"
html_static_path = ["static", "generated/static"]
html_css_files = ["site.css"]
html_extra_path = ["generated/extra"]  # copied as they are
for name in ("extra", "static"):
    (DOCS / "generated" / name).mkdir(parents=True, exist_ok=True)
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
# The address of the repository, if the project states it, is a link at the end of each page.
with (DOCS.parent / "pyproject.toml").open("rb") as project_file:
    urls = tomllib.load(project_file)["project"].get("urls", {})
if "Repository" in urls:
    html_theme_options["footer_icons"] = [
        {"name": "Repository", "url": urls["Repository"], "html": "Repository"}
    ]
pygments_style, pygments_dark_style = "friendly", "monokai"
# Lines of text blocks and of consoles are not code of a language.
highlight_language = "text"
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "attrs_block", "attrs_inline"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]
toc_object_entries = False  # the reference has lists of its own
html_math_renderer = "mathml"

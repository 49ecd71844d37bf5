"""The site: pages are listed and converted, and it builds without warnings or network."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
import site_pages
from api_index import public_names
from headless_browser import Browser
from site_pages_in_browser import broken_links, faults_in_browser

import pinred
from pinred import plots
from pinred.cli import command_line
from pinred.system.find_robot_files import has_example_robots

pytest.importorskip("myst_parser")
pytest.importorskip("furo")
import api_pages

ROOT, DOCS = site_pages.ROOT, site_pages.DOCS


def build(folder: Path, builder: str = "html") -> None:
    """Build the site with warnings as errors, as CONTRIBUTING.md says."""
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", builder]
    done = subprocess.run(
        [*command, DOCS, folder], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.by_hand  # The workflow of the site builds every page with warnings as errors.
def test_pages_are_read_without_warnings(tmp_path: Path) -> None:
    """All pages and links are resolved; every warning is an error."""
    build(tmp_path / "site", "dummy")


@pytest.mark.by_hand
def test_built_pages_load_nothing_from_the_network(tmp_path: Path) -> None:
    """Scripts, styles and pictures of every page are files of the site; formulas are MathML."""
    build(tmp_path)
    pages = sorted(tmp_path.rglob("*.html"))
    assert len(pages) > 80
    for page in pages:
        text = page.read_text("utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]* src=\"([^\"]+)\"", text)
        loaded += re.findall(r"<link[^>]* rel=\"stylesheet\"[^>]* href=\"([^\"]+)\"", text)
        for target in loaded:
            assert not re.match(r"\w+:|//", target), (page.name, target)
            assert (page.parent / target.partition("?")[0]).exists(), (page.name, target)
    theory = (tmp_path / "theory.html").read_text("utf-8")
    assert theory.count("<math") > 40
    assert "\\tfrac" not in theory
    assert broken_links(tmp_path) == []


@pytest.mark.by_hand
def test_pages_have_no_faults_in_a_browser(tmp_path: Path, screen: Browser) -> None:
    """No page loads from the network, fails, lacks a picture or is wider than the window."""
    build(tmp_path)
    for page in sorted(tmp_path.rglob("*.html")):
        for width in (1440, 400):
            assert faults_in_browser(screen, page, width) == [], (page.name, width)


@pytest.mark.browser
def test_faults_of_a_page_are_found(tmp_path: Path, screen: Browser) -> None:
    """Each fault of a page that has all of them is reported, and each broken link."""
    body = (
        '<h1 id="top">A</h1><p>$x$</p><div style="width: 2000px">wide</div><img src="no.png">'
        '<p style="width: 2em">unbreakablyLongWordOfAPage</p><a href="b.html">b</a>'
        '<a href="#top">top</a><a href="#end">end</a><script>throw Error("e")</script>'
        '<table style="display: block; width: 2em; overflow: auto"><td>unbreakable</td></table>'
    )
    page = tmp_path / "page.html"
    page.write_text(f"<!doctype html><article>{body}</article>", "utf-8")
    assert broken_links(tmp_path) == ["page.html: #end", "page.html: b.html"]
    faults = faults_in_browser(screen, page, 390)
    for start in (
        "wider than", "broken picture", "text is wider", "text that is", "script fails",
        "table scrolls",
    ):  # fmt: skip
        assert sum(fault.startswith(start) for fault in faults) == 1, (start, faults)


WRITTEN = [
    *sorted((DOCS / "howto").glob("*.md")),
    *sorted((DOCS / "users").glob("*.md")),
    *(DOCS / f"{name}.md" for name in ("start", "api", "comparison", "dynamics", "feel")),
]
PAGES = [ROOT / "README.md", *site_pages.sources()]
# `--by-hand` executes their code; every run looks up the names in it.
LONG = (
    *("dynamics", "land_within_limits", "legged_robots", "short_examples", "space_robots"),
    "turn_base",
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=[pytest.mark.by_hand] * (path.stem in LONG)) for path in WRITTEN],
    ids=lambda path: path.stem,
)
@pytest.mark.sampled
def test_code_of_page_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Python blocks of a page run in order, with their assertions."""
    if path.stem == "legged_robots" and not has_example_robots():
        pytest.skip("example-robot-data is not installed")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    code = "\n".join(site_pages.python_blocks(path.read_text("utf-8")))
    exec(compile(code, path.name, "exec"), {})


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_names_in_code_of_page_exist(path: Path) -> None:
    """Every Python block is valid, and the names of `pinred` that it uses exist."""
    for block in site_pages.python_blocks(path.read_text("utf-8")):
        tree = ast.parse(block)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pinred"):
                module = import_module(node.module or "")
                assert [name.name for name in node.names if not hasattr(module, name.name)] == []
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pinred":
                assert hasattr(pinred, node.attr) or find_spec(f"pinred.{node.attr}"), node.attr


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_commands_of_page_are_accepted(path: Path) -> None:
    """Commands and options in console blocks exist; by-hand tests run those of the gallery."""
    for command in site_pages.console_commands(path.read_text("utf-8")):
        words = command.partition(" && ")[0].split()
        command_line._parser(words).parse_args(command_line._join_negative(words))


def test_start_lists_every_extra() -> None:
    """The table of extras has those of pyproject.toml, and no other."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    text = (DOCS / "start.md").read_text("utf-8")
    table = text[text.index("| extra |") :].split("\n\n")[0]
    extras = re.findall(r"`(\w+)`", " ".join(row.split("|")[1] for row in table.splitlines()))
    assert sorted(extras) == sorted(project["optional-dependencies"])


def test_gallery_shows_every_kind_of_figure() -> None:
    """Each picture has a command, each kind of figure a picture, and no picture is left over."""
    from draw import commands_of

    text = (DOCS / "gallery.md").read_text("utf-8")
    commands = commands_of(text)
    shown = re.findall(r"!\[[^]]+\]\(pictures/([\w-]+)\.png\)", text)
    assert shown == list(commands)
    assert {path.stem for path in (DOCS / "pictures").glob("*.png")} == {*shown, "feel"}
    drawn = {word for words in commands.values() for word in words}
    files = [word for word in drawn if word.endswith((".toml", ".csv"))]
    assert all((ROOT / file).is_file() for file in files)  # commands run in the root
    assert len(files) > 4
    elsewhere = {"field", "loop", "cycles", "branches", "work_precision"}  # of other commands
    assert set(plots.KINDS) - elsewhere <= drawn
    assert {"field", "phase", "gait", "reorient", "equilibria"} <= {c[0] for c in commands.values()}


@pytest.mark.by_hand
def test_gallery_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command of the gallery writes its picture."""
    from draw import FOLDERS, commands_of, draw, shrink, sweeps_of

    for folder in FOLDERS.values():
        (tmp_path / folder).mkdir(parents=True)
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "gallery.md").read_text("utf-8")
    for words in sweeps_of(text):
        draw(words)
    for name, words in commands_of(text).items():
        draw(words)
        shrink(Path(f"docs/pictures/{name}.png"))
        assert Path(f"docs/pictures/{name}.png").stat().st_size > 5000


@pytest.mark.by_hand
def test_tutorials_are_executed(tmp_path: Path) -> None:
    """The runner stores output and figures, and the page shows them; one short tutorial."""
    import tutorial_pages

    path = tutorial_pages.TUTORIALS / "01_elroys_beanie.py"
    tutorial_pages.run(path, tmp_path)
    page = tutorial_pages.page(path, tmp_path)
    assert "verdict: PASSED" in page
    assert page.count("](../../runs/01_elroys_beanie_") == 2


def test_arrows_of_diagram_point_downwards() -> None:
    """Each node is one layer below all nodes that point to it, and is drawn once."""
    import diagrams

    arrows = [("cli", "views"), ("views", "common"), ("cli", "common")]
    assert diagrams.layers_of(arrows) == [["cli"], ["views"], ["common"]]
    svg = diagrams.draw("\n".join(f"    {a} --> {b}" for a, b in arrows))
    assert [svg.count(f">{name}</text>") for name in ("cli", "views", "common")] == [1, 1, 1]
    assert svg.count('class="arrow"') == 3


def test_new_page_is_listed(tmp_path: Path) -> None:
    """A page in docs/ that no table of contents names is added to the guides."""
    from github_markdown import unlisted_pages

    (tmp_path / "index.md").write_text("```{toctree}\n:hidden:\n\ntheory\n```\n", "utf-8")
    for name in ("theory", "sweeps"):
        (tmp_path / f"{name}.md").write_text(f"# {name}\n", "utf-8")
    assert unlisted_pages(tmp_path) == ["sweeps"]
    assert "<!-- pages that are not listed -->" in (DOCS / "index.md").read_text("utf-8")


def test_cells_of_wide_tables_have_the_headings_of_their_columns() -> None:
    """Of tables with four columns; empty cells have none, and narrow tables stay as they are."""
    from narrow_tables import label_cells

    def table(columns: int, cells: str) -> str:
        heads = "".join(f'<th class="head"><p>a &lt; <em>{k}</em></p></th>' for k in range(columns))
        body = f"<tbody><tr>{cells}</tr></tbody>"
        return f'<table class="docutils x"><thead><tr>{heads}</tr></thead>{body}</table>'

    narrow = table(3, "<td>1</td><td></td><td>3</td>")
    assert label_cells(narrow) == narrow
    cells = '<td>1</td><td class="q"><p></p></td><td>3</td><td>4</td>'
    shown = label_cells(f"<p>{table(4, cells)}")
    assert shown.count('class="stacks docutils x"') == 1
    assert '<td data-label="a &lt; 0">1</td><td data-blank="" class="q">' in shown
    assert '<td data-label="a &lt; 3">4</td>' in shown


@pytest.mark.parametrize(
    ("text", "converted"),
    [
        ("[a](../examples/05_shooting.py)", "[a](generated/examples/05_shooting_py.md)"),
        ("[a](../CONTRIBUTING.md#rules)", "[a](generated/contributing.md#rules)"),
        ("[a](../robots/README.md)", "[a](generated/bundled_robots.md)"),
        ("[theory.md](theory.md#x), [docs/a.md](a.md)", "[](theory.md#x), [](a.md)"),
        ("[a](theory.md#x) and [b](https://host.example/a)",) * 2,
        ("$`x^2`$ and `$x`", "$x^2$ and `$x`"),
        ("```python\nx = '[a](../README.md)'\n```\n",) * 2,
    ],
)
def test_markdown_of_github_is_converted(text: str, converted: str) -> None:
    """Links out of docs/ lead to pages, formulas are those of MyST, and code stays."""
    from github_markdown import convert

    assert convert(text, "docs", "howto") == converted


@pytest.mark.parametrize("path", site_pages.sources(), ids=lambda path: path.stem)
def test_formulas_become_mathml(path: Path) -> None:
    """Every formula is converted, and a fraction of two digits has two parts."""
    from mathml import convert

    text = path.read_text("utf-8")
    blocks = re.findall(r"```math\n(.*?)```", text, re.DOTALL)
    inline = re.findall(r"\$`(.+?)`\$", text, re.DOTALL)
    for formula in [*blocks, *inline]:
        assert "<math" in convert(formula, as_block=formula in blocks)
        for fraction in re.findall(r"\\[td]?frac\s*\d\s*\d", formula):
            parts = re.findall(r"<mn>(\d)</mn>", convert(fraction))
            assert parts == re.findall(r"\d", fraction)
    assert "<mn>1</mn>" in convert(r"\tfrac12\,x")
    assert "<mi>\N{MATHEMATICAL ITALIC SMALL X}\u0307</mi>" in convert(r"\dot x")


def test_every_linked_file_has_a_page() -> None:
    """Links of pages to files outside of docs/ lead to pages of the site, not to GitHub."""
    from github_markdown import page_of

    for path in site_pages.sources():
        for target in re.findall(r"\]\((\.\./[^)#\s]+)", path.read_text("utf-8")):
            file = (path.parent / target).resolve()
            assert file.exists(), (path.name, target)
            if DOCS not in file.parents:
                name = file.relative_to(ROOT).as_posix()
                assert page_of(name) is not None, (path.name, target)


def test_docstring_becomes_table() -> None:
    """Entries over several lines are joined, and characters of Markdown are escaped."""
    from docstring_markdown import escape, parse

    doc = parse(
        "Do it.\n\nArgs:\n    x, y: Shape\n        (m,).\n    z: A*B.\nRaises:\n    E: No.\n"
    )
    assert doc.prose == "Do it."
    assert doc.entries("Args") == {"x": "Shape (m,).", "y": "Shape (m,).", "z": "A*B."}
    assert doc.entries("Raises") == {"E": "No."}
    assert escape("a*b `c*d` |x|", in_table=True) == "a\\*b `c*d` \\|x\\|"


def test_home_page_shows_the_output_of_its_code(capsys: pytest.CaptureFixture[str]) -> None:
    """The text below the code is what it prints."""
    text = (DOCS / "index.md").read_text("utf-8")
    (code,) = site_pages.python_blocks(text)
    exec(compile(code, "index.md", "exec"), {})
    (shown,) = re.findall(r"^```text\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert capsys.readouterr().out == shown


def test_every_function_has_a_page_with_an_example() -> None:
    """Each public name of `pinred` belongs to one task."""
    made = api_pages.pages()
    names = [full.partition(".")[2] for full in public_names() if full.count(".") == 1]
    functions = [name for name in names if not isinstance(getattr(pinred, name), type)]
    assert [n for n in functions if "## Example" not in made[f"api/functions/{n}"]] == []
    texts = "\n".join(made[f"api/{task.page}"] for task in api_pages.TASKS)
    assert [name for name in names if f"`~pinred.{name}`" not in texts] == []

"""Code, tables and file names in the documents agree with the package."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest
import scene_tables
import site_pages
from mjcf_constructs import ACTING

import pinred
from pinred.cli.command_line import COMMANDS, main
from pinred.lie import GROUPS
from pinred.system.find_robot_files import bundled_folder, bundled_robots

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
CONCEPTS = (ROOT / "docs/concepts.md").read_text(encoding="utf-8")
GROUP_TABLE = (ROOT / "docs/groups.md").read_text(encoding="utf-8")
CODE: list[str] = site_pages.python_blocks(README)


@pytest.mark.slow
@pytest.mark.parametrize("code", CODE)
def test_readme_examples_run(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The Python examples of the README run unchanged and pass their comparison."""
    exec(compile(code, "README.md", "exec"), {})
    assert "verdict: PASSED" in capsys.readouterr().out


@pytest.mark.by_hand("adapters/scipy.md")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *("theory.md", "published.md", "equilibria.md", "forces.md", "capture.md"),
        *("adapters/casadi.md", "adapters/scipy.md"),
        *(
            pytest.param(name, marks=pytest.mark.by_hand)
            for name in ("flow.md", "adapters/jax.md", "adapters/pytorch.md")
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:`torch.jit")  # PyTorch warns about its own API
def test_code_of_documents_runs(name: str) -> None:
    """All code blocks of a document run in order, with their assertions."""
    for package in ("jax", "torch"):
        if f"adapters/{'py' * (package == 'torch')}{package}.md" == name:
            pytest.importorskip(package)
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    exec(compile("\n".join(blocks), name, "exec"), {})


def test_formulas_are_closed() -> None:
    """Displayed formulas are closed, and inline formulas have both delimiters."""
    text = (ROOT / "docs/theory.md").read_text(encoding="utf-8")
    assert text.count("```") % 2 == 0
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    assert prose.count("$`") == prose.count("`$") > 10


def test_readme_is_short_and_names_all_commands() -> None:
    """The README has at most 1,200 words and three pictures, and names every command."""
    assert len(README.split()) <= 1200
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", README)
    assert len(pictures) == 3
    assert [name for name in pictures if not (ROOT / name).exists()] == []
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`(?:pinred )?([a-z, `]+)`", README))))
    assert [name for name in COMMANDS if name not in words] == []


def test_readme_table_names_functions_that_exist() -> None:
    """Every function in the table of capabilities exists in `pinred`."""
    table = README[README.index("| you want |") :].split("\n\n")[0]
    for row in table.splitlines()[2:]:
        for name in re.findall(r"`([\w.]+)`", row.split("|")[2]):
            if name == "pinred.laboratory.bench":
                continue  # a module
            module, _, function = name.removeprefix("pinred.").rpartition(".")
            namespace = import_module(f"pinred.{module}") if module else pinred
            assert hasattr(namespace, function), name


def test_first_readme_example_has_ten_lines() -> None:
    """The first example has at most ten lines and two imports."""
    assert len(CODE[0].strip().splitlines()) <= 12


@pytest.mark.slow
def test_scene_of_howto_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scene file of the page on scene files runs unchanged and passes its comparison."""
    page = (ROOT / "docs/howto/scene_file.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    assert main(["run", str(path), "--compare"]) == 0
    assert "verdict: PASSED" in capsys.readouterr().out


def test_scene_keys_are_documented(tmp_path: Path) -> None:
    """docs/scenes.md has the tables of the schema and the error message of the reader."""
    text = scene_tables.DOCUMENT.read_text(encoding="utf-8")
    assert text == scene_tables.document(), "run tests/helpers/scene_tables.py"
    (message,) = re.findall(r"```text\n(.*?)\n```", text)
    head = 'robot = "falling_cat"\n' + "\n" * 7
    spring = '[[forces]]\nkind = "spring"\njoint = "bend"\nstifness = 1\n'
    path = tmp_path / "scene.toml"
    path.write_text(head + spring, encoding="utf-8")
    with pytest.raises(pinred.InputError) as caught:
        pinred.load_scene(path)
    assert str(caught.value) == f"{tmp_path}/{message}"


def test_ci_runs_the_test_command_of_the_readme() -> None:
    """CI runs the second console command of the README."""
    commands = re.findall(r"```console\n\$ (.*?)\n", README)
    assert (ROOT / ".ci/run").read_text(encoding="utf-8").strip().endswith(commands[1])
    assert "pinred compare" in commands[0]


def test_concept_table_names_code_that_exists() -> None:
    """Every name in the column `code` of the concept table exists."""
    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    traj = pinred.simulate(system, duration=0.1)
    scope = {"pinred": pinred, "system": system, "red": red, "traj": traj, "at": red.at(traj.x[0])}
    table = CONCEPTS[CONCEPTS.index("| concept |") :].split("\n\n")[0]
    names = re.findall(r"`([a-z]+(?:\.[A-Za-z_]+)+)", table)
    assert len(names) > 12
    for name in names:
        first, *rest = name.split(".")
        value = scope[first]
        for attribute in rest:
            value = getattr(value, attribute)
        assert value is not None


def test_robots_readme_lists_the_catalogue() -> None:
    """robots/README.md has one row per robot, with its group and description."""
    text = (bundled_folder() / "README.md").read_text(encoding="utf-8")
    rows = {}
    for line in text.splitlines():
        cells = [cell.strip().strip("`") for cell in line.strip("|").split("|")]
        if len(cells) == 4 and cells[0] in bundled_robots():
            rows[cells[0]] = cells
    assert set(rows) == set(bundled_robots())
    for name, robot in bundled_robots().items():
        assert rows[name][1] == robot.group
        assert rows[name][2] == robot.description
        assert robot.closed_form or robot.source
    files = {path.name for path in bundled_folder().glob("*.urdf")}
    assert files == {robot.path.name for robot in bundled_robots().values()}


def test_ignored_mjcf_elements_are_documented() -> None:
    """docs/robots.md names every ignored kind of MJCF element and every group of a base."""
    text = (ROOT / "docs/robots.md").read_text(encoding="utf-8")
    assert [kind for kind in (*ACTING, *GROUPS) if kind not in text] == []


def test_groups_page_lists_all_groups() -> None:
    """Each group has a row with its pose and twist coordinates in their order."""
    rows = {}
    for line in GROUP_TABLE[GROUP_TABLE.index("| `group` |") :].split("\n\n")[0].splitlines()[2:]:
        name, *cells = (cell.strip().strip("`()") for cell in line.strip("|").split("|"))
        rows[name] = cells
    assert list(rows) == list(GROUPS)
    for name, group in GROUPS.items():
        assert rows[name][:2] == [", ".join(group.pose_names), ", ".join(group.twist_names)]
        assert rows[name][2].startswith(group.root)


def test_errata_name_tests_that_exist() -> None:
    """Each test that the errata name exists."""
    text = (ROOT / "docs/errata.md").read_text(encoding="utf-8")
    names = re.findall(r"`(?:(tests/\w+/\w+\.py)::)?(test_\w+)`", text)
    assert len(names) >= 10
    for file, name in names:
        path = ROOT / (file or "tests/reduction/test_closed_forms.py")
        source = path.read_text(encoding="utf-8")
        assert f"def {name}(" in source


@pytest.mark.parametrize("path", [ROOT / "README.md", *site_pages.sources()], ids=lambda p: p.name)
def test_files_that_documents_name_exist(path: Path) -> None:
    """Paths in a document are relative to the project, the package or the document."""
    text = path.read_text(encoding="utf-8")
    for name in re.findall(r"`((?:\w+/)+\w*\.?\w*)`", text):
        folders = (ROOT, ROOT / "pinred", path.parent)
        assert any((folder / name).exists() for folder in folders), name


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_examples_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every example runs in any folder."""
    monkeypatch.chdir(tmp_path)
    if path.name == "05_shooting.py":
        pytest.importorskip("crocoddyl")
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), {"__name__": "__main__"})

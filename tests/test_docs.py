"""What the documents say is what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import scene_tables
from mjcf_constructs import ACTING

import pinred
from pinred.cli.main import main
from pinred.lie import GROUPS
from pinred.system.catalogue import bundled_folder, bundled_robots

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


CODE: list[str] = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("code", CODE)
def test_readme_examples_run(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The examples of the README run as they stand and pass their comparison."""
    exec(compile(code, "README.md", "exec"), {})
    assert "verdict: PASSED" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *("theory.md", "equilibria.md", "forces.md", "flow.md"),
        *("adapters/casadi.md", "adapters/jax.md", "adapters/pytorch.md", "adapters/scipy.md"),
    ],
)
@pytest.mark.filterwarnings("ignore:`torch.jit")  # PyTorch warns of its own ways
def test_code_of_documents_runs(name: str) -> None:
    """All blocks of code in a row, with what they assert."""
    for package in ("jax", "torch"):
        if f"adapters/{'py' * (package == 'torch')}{package}.md" == name:
            pytest.importorskip(package)
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    exec(compile("\n".join(blocks), name, "exec"), {})


def test_formulas_are_closed() -> None:
    """Every displayed formula ends, and inline ones have both of their marks."""
    text = (ROOT / "docs/theory.md").read_text(encoding="utf-8")
    assert text.count("```") % 2 == 0
    inside = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    assert inside.count("$`") == inside.count("`$") > 10


def test_ten_lines_are_ten_lines() -> None:
    """The first example is what its heading says, but for its imports."""
    assert len(CODE[0].strip().splitlines()) <= 12


@pytest.mark.slow
def test_readme_scene_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scene of the README runs as it stands and passes its comparison."""
    (text,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    assert main(["run", str(path), "--compare"]) == 0
    assert "verdict: PASSED" in capsys.readouterr().out


def test_scene_keys_are_documented(tmp_path: Path) -> None:
    """docs/scenes.md has the tables of the schema, and its error is what the reader says."""
    text = scene_tables.DOCUMENT.read_text(encoding="utf-8")
    assert text == scene_tables.document(), "run tests/helpers/scene_tables.py"
    (said,) = re.findall(r"```text\n(.*?)\n```", text)
    head = 'robot = "falling_cat"\n' + "\n" * 7
    spring = '[[forces]]\nkind = "spring"\njoint = "bend"\nstifness = 1\n'
    path = tmp_path / "scene.toml"
    path.write_text(head + spring, encoding="utf-8")
    with pytest.raises(pinred.InputError) as caught:
        pinred.load_scene(path)
    assert str(caught.value) == f"{tmp_path}/{said}"


def test_ci_runs_the_test_command_of_the_readme() -> None:
    """The second command block of the README is the line that CI runs."""
    commands = re.findall(r"```console\n\$ (.*?)\n", README)
    assert (ROOT / ".ci/run").read_text(encoding="utf-8").strip().endswith(commands[1])
    assert "pinred compare" in commands[0]


def test_concept_table_names_code_that_exists() -> None:
    """Every name in the column `code` of the concept table can be called or read."""
    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    traj = pinred.simulate(system, duration=0.1)
    scope = {"pinred": pinred, "system": system, "red": red, "traj": traj, "at": red.at(traj.x[0])}
    table = README[README.index("| concept |") :].split("\n\n")[0]
    names = re.findall(r"`([a-z]+(?:\.[A-Za-z_]+)+)", table)
    assert len(names) > 12
    for name in names:
        first, *rest = name.split(".")
        value = scope[first]
        for attribute in rest:
            value = getattr(value, attribute)
        assert value is not None


def test_robots_readme_is_the_catalogue() -> None:
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


def test_what_is_left_out_of_mjcf_is_documented() -> None:
    """docs/robots.md names each kind of thing that can be left out, and each group of a base."""
    text = (ROOT / "docs/robots.md").read_text(encoding="utf-8")
    assert [kind for kind in (*ACTING, *GROUPS) if kind not in text] == []


def test_groups_of_the_readme_are_those_there_are() -> None:
    """Each has a row, with the coordinates of a pose and of a twist in their order."""
    rows = {}
    for line in README[README.index("| `group` |") :].split("\n\n")[0].splitlines()[2:]:
        name, *cells = (cell.strip().strip("`()") for cell in line.strip("|").split("|"))
        rows[name] = cells
    assert list(rows) == list(GROUPS)
    for name, group in GROUPS.items():
        assert rows[name][:2] == [", ".join(group.pose_names), ", ".join(group.twist_names)]
        assert rows[name][2].startswith(group.root)


def test_errata_name_tests_that_exist() -> None:
    """Each line of the errata points to a test."""
    text = (ROOT / "docs/errata.md").read_text(encoding="utf-8")
    names = re.findall(r"`(?:(tests/\w+/\w+\.py)::)?(test_\w+)`", text)
    assert len(names) >= 10
    for file, name in names:
        path = ROOT / (file or "tests/reduction/test_closed_forms.py")
        source = path.read_text(encoding="utf-8")
        assert f"def {name}(" in source


@pytest.mark.parametrize(
    "path", sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md")]), ids=lambda p: p.name
)
def test_files_that_documents_name_exist(path: Path) -> None:
    """A path in a document is from the top of the checkout, the package, or its own folder."""
    text = path.read_text(encoding="utf-8")
    for name in re.findall(r"`((?:\w+/)+\w*\.?\w*)`", text):
        folders = (ROOT, ROOT / "pinred", path.parent)
        assert any((folder / name).exists() for folder in folders), name


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_examples_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every example runs from anywhere."""
    monkeypatch.chdir(tmp_path)
    if path.name == "05_shooting.py":
        pytest.importorskip("crocoddyl")
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), {"__name__": "__main__"})

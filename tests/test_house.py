"""The house: imports point down from room to room, nothing goes in circles."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
import rooms
from rooms import PACKAGE, ROOMS, ROOT, Import


@pytest.mark.slow
def test_imports_point_down() -> None:
    """No room imports one above it, nor a face of the package: lazily, for types, or otherwise."""
    wrong = rooms.upward(rooms.imports())
    assert not wrong, "\n".join(f"{each.by}, line {each.line}: {each.of}" for each in wrong)


def test_no_circles() -> None:
    """No module needs itself through others."""
    assert rooms.circle(rooms.imports()) == []


@pytest.mark.parametrize(
    ("code", "needed"),
    [
        ("from ..views import motions", "pinred.views.motions"),
        ("def f():\n    from pinred.views.motions import plot", "pinred.views.motions"),
        ("import pinred.views.motions as m", "pinred.views.motions"),
        ("if TYPE_CHECKING:\n    from ..views.motions import plot", "pinred.views.motions"),
        ("from .. import views", "pinred.views"),
    ],
)
def test_an_arrow_up_is_seen(
    code: str, needed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However an import is written, it is found; those of the same room and below may be."""
    path = tmp_path / "at_a_shape.py"
    path.write_text(f"from ..common.arrays import Array\n{code}\n", "utf-8")
    known = rooms.modules()
    known["pinred.reduction.at_a_shape"] = path
    monkeypatch.setattr(rooms, "modules", lambda: known)
    wrong = [each for each in rooms.upward(rooms.imports()) if each.by.endswith(".at_a_shape")]
    assert {each.of for each in wrong} == {needed}


def test_a_circle_is_seen() -> None:
    """Two modules that import each other; a package that hands on names is none."""
    there, back = (
        Import("pinred.lie.a", 1, "pinred.lie.b"),
        Import("pinred.lie.b", 1, "pinred.lie.a"),
    )
    assert rooms.circle([there]) == []
    assert set(rooms.circle([there, back])) == {"pinred.lie.a", "pinred.lie.b"}
    face = [Import("pinred.lie", 1, "pinred.lie.a"), Import("pinred.lie.a", 1, "pinred.lie")]
    assert rooms.circle(face) == []


def test_every_file_is_in_a_room() -> None:
    """Beside the rooms there are the face, the entry, and the aliases that the README names."""
    beside = {path.stem for path in PACKAGE.glob("*.py")}
    assert beside == {"__init__", "__main__", "equations", "plots", "poisson", "signals"}
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(ROOMS)
    tested = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py")}
    assert tested <= set(ROOMS)


def test_rooms_say_what_they_are() -> None:
    """Each has a docstring, and says what it may import."""
    for room in ROOMS:
        text = ast.get_docstring(ast.parse((PACKAGE / room / "__init__.py").read_text("utf-8")))
        assert text is not None
        assert "Imports" in text or "imports it" in text, room


def test_the_drawing_is_of_today() -> None:
    """docs/architecture.md has the rooms as they are; tests/helpers/rooms.py draws them."""
    assert rooms.drawing() in rooms.DOCUMENT.read_text("utf-8")


def imports_at_load(node: ast.AST) -> Iterator[int]:
    """Yield the lines of imports that run when a module is loaded."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child.lineno
        elif isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            yield from imports_at_load(ast.Module(child.orelse, []))
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from imports_at_load(child)


def misplaced_laboratory_imports() -> list[str]:
    """Return the imports of `laboratory` from outside, except those inside functions of `cli`."""
    modules = rooms.modules()
    misplaced = []
    for each in rooms.imports():
        by, of = each.rooms
        if of == "laboratory" and by != "laboratory":
            loaded = imports_at_load(ast.parse(modules[each.by].read_text("utf-8")))
            if by != "cli" or each.line in loaded:
                misplaced.append(f"{each.by}, line {each.line}: {each.of}")
    return misplaced


def test_laboratory_is_imported_by_cli_functions_only() -> None:
    """Neither the library nor the start of the command line loads the laboratory."""
    assert misplaced_laboratory_imports() == []


@pytest.mark.parametrize(
    ("module", "code", "misplaced"),
    [
        ("cli.extra", "from ..laboratory import bench", True),
        ("cli.extra", "try:\n    import pinred.laboratory.bench\nexcept ImportError: pass", True),
        ("cli.extra", "class A:\n    from ..laboratory import bench", True),
        ("cli.extra", "def run():\n    from ..laboratory import bench", False),
        ("cli.extra", "if TYPE_CHECKING:\n    from ..laboratory import bench", False),
        ("views.extra", "def run():\n    from ..laboratory import bench", True),
        ("views.extra", "if TYPE_CHECKING:\n    from ..laboratory import bench", True),
    ],
)
def test_misplaced_laboratory_import_is_detected(
    module: str, code: str, misplaced: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only imports inside functions of `cli`, or for types there, are accepted."""
    path = tmp_path / "extra.py"
    path.write_text(code, "utf-8")
    modules = {**rooms.modules(), f"pinred.{module}": path}
    monkeypatch.setattr(rooms, "modules", lambda: modules)
    lines = [line for line in misplaced_laboratory_imports() if f"pinred.{module}," in line]
    assert bool(lines) is misplaced

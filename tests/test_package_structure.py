"""Packages import only lower packages, and modules have no import cycles."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import package_graph
import pytest
from package_graph import LIBRARY, PACKAGES, ROOT, Import


@pytest.mark.slow
def test_packages_import_only_lower_packages() -> None:
    """Lazy imports and type imports count; so do imports of modules directly in `pinred`."""
    upward = package_graph.find_upward_imports(package_graph.list_imports())
    assert not upward, "\n".join(f"{i.by}, line {i.line}: {i.of}" for i in upward)


def test_modules_have_no_import_cycle() -> None:
    """No module imports itself through other modules."""
    assert package_graph.find_cycle(package_graph.list_imports()) == []


def modules_of(*packages: str) -> dict[str, Path]:
    """Return the files of the modules of some packages by their full names."""
    modules = package_graph.list_modules()
    return {n: path for n, path in modules.items() if package_graph.package_of(n) in packages}


@pytest.mark.parametrize(
    ("code", "imported"),
    [
        ("from ..views import motions", "pinred.views.motions"),
        ("def f():\n    from pinred.views.motions import plot", "pinred.views.motions"),
        ("import pinred.views.motions as m", "pinred.views.motions"),
        ("if TYPE_CHECKING:\n    from ..views.motions import plot", "pinred.views.motions"),
        ("from .. import views", "pinred.views"),
    ],
)
def test_upward_import_of_any_syntax_is_detected(
    code: str, imported: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every syntax of an import is recognised; imports of lower packages are accepted."""
    path = tmp_path / "pointwise_reduction.py"
    path.write_text(f"from ..common.arrays import Array\n{code}\n", "utf-8")
    modules = modules_of("common", "views")
    modules["pinred.reduction.pointwise_reduction"] = path
    monkeypatch.setattr(package_graph, "list_modules", lambda: modules)
    upward = package_graph.find_upward_imports(package_graph.list_imports())
    assert {i.of for i in upward if i.by.endswith(".pointwise_reduction")} == {imported}


def test_import_cycle_is_detected() -> None:
    """Two modules that import each other form a cycle; a package that re-exports names does not."""
    forward, backward = (
        Import("pinred.lie.a", 1, "pinred.lie.b"),
        Import("pinred.lie.b", 1, "pinred.lie.a"),
    )
    assert package_graph.find_cycle([forward]) == []
    assert set(package_graph.find_cycle([forward, backward])) == {"pinred.lie.a", "pinred.lie.b"}
    reexport = [Import("pinred.lie", 1, "pinred.lie.a"), Import("pinred.lie.a", 1, "pinred.lie")]
    assert package_graph.find_cycle(reexport) == []


def test_every_module_belongs_to_a_package() -> None:
    """Only the public namespace, `__main__` and the documented aliases are outside of packages."""
    top_level = {path.stem for path in LIBRARY.glob("*.py")}
    assert top_level == {"__init__", "__main__", "equations", "plots", "poisson", "signals"}
    folders = {path.parent.name for path in LIBRARY.glob("*/__init__.py")}
    assert folders == set(PACKAGES)
    tested = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py")}
    assert tested <= {*PACKAGES, "device"}  # the latter tests several packages on a device


def test_package_docstrings_name_their_imports() -> None:
    """The docstring of each package names the packages that it imports."""
    for package in PACKAGES:
        text = ast.get_docstring(ast.parse((LIBRARY / package / "__init__.py").read_text("utf-8")))
        assert text is not None
        assert "imports" in text.lower(), package


def test_architecture_page_shows_current_packages() -> None:
    """docs/architecture.md is up to date; tests/helpers/package_graph.py rewrites it."""
    assert package_graph.render() in package_graph.DOCUMENT.read_text("utf-8")


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
    modules = package_graph.list_modules()
    misplaced = []
    for statement in package_graph.list_imports():
        by, of = statement.packages
        if of == "laboratory" and by != "laboratory":
            loaded = imports_at_load(ast.parse(modules[statement.by].read_text("utf-8")))
            if by != "cli" or statement.line in loaded:
                misplaced.append(f"{statement.by}, line {statement.line}: {statement.of}")
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
    modules = {**modules_of("laboratory"), f"pinred.{module}": path}
    monkeypatch.setattr(package_graph, "list_modules", lambda: modules)
    lines = [line for line in misplaced_laboratory_imports() if f"pinred.{module}," in line]
    assert bool(lines) is misplaced

"""Tests of the files that releases are built from: version, README of the index, workflows."""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

import pinred

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


@pytest.fixture
def hatch_build(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the module hatch_build.py, with a stand-in for hatchling."""
    interface = ModuleType("interface")
    vars(interface)["MetadataHookInterface"] = type("Hook", (), {"root": str(ROOT)})
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", interface)
    spec = spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_version_is_defined_in_one_file() -> None:
    """Only pinred/common/errors.py states the version; no other file of the release does."""
    assert (ROOT / PROJECT["tool"]["hatch"]["version"]["path"]).is_file()
    assert PROJECT["project"]["dynamic"] == ["version", "readme"]
    for name in ("pyproject.toml", "CITATION.cff", "README.md", "SECURITY.md", "hatch_build.py"):
        text = (ROOT / name).read_text("utf-8")
        assert not re.search(rf"(?<![\d.]){re.escape(pinred.__version__)}(?![\d.])", text), name


@pytest.mark.parametrize("address", ["", "https://host.example/pinred/"])
def test_readme_for_index_has_no_relative_link(hatch_build: ModuleType, address: str) -> None:
    """Relative links become absolute if the address is known, and plain text otherwise."""
    metadata = {"urls": {"Repository": address}} if address else {}
    hatch_build.ReadmeHook().update(metadata)
    readme = metadata["readme"]
    assert readme["content-type"] == "text/markdown"
    links = re.findall(r"\]\(([^)]+)\)", readme["text"])
    assert all(link.startswith(("https://", "#")) for link in links)
    base = f"https://host.example/pinred/blob/v{pinred.__version__}/docs/theory.md"
    assert (base in links) == bool(address)
    assert "docs/theory.md" in readme["text"]


def test_sdist_contains_what_its_build_and_tests_need() -> None:
    """Every path in the list of the source distribution exists; the build hook is one of them."""
    paths = PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert [path for path in paths if not (ROOT / path.strip("/")).exists()] == []
    assert "/hatch_build.py" in paths


def test_workflows_test_the_supported_versions_of_python() -> None:
    """The workflow tests each version that the classifiers name, lowest dependencies included."""
    text = (ROOT / ".github/workflows/test.yml").read_text("utf-8")
    listed = re.search(r"python: \[(.*)\]", text)
    assert listed is not None
    versions = re.findall(r":: (3\.\d+)", "\n".join(PROJECT["project"]["classifiers"]))
    assert re.findall(r'"(.*?)"', listed[1]) == versions
    assert PROJECT["project"]["requires-python"] == f">={versions[0]}"
    assert "lowest-direct" in text

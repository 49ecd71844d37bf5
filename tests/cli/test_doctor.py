"""Tests of `pinred doctor`."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from pinred.cli import installation_commands
from pinred.cli.command_line import main
from pinred.cli.installation_commands import Requirement, examine, read_requirements
from pinred.common.errors import __version__

VERSIONS = {"new": "2.10.0", "even": "2.9", "old": "2.8.5", "candidate": "3.0rc1"}


@pytest.fixture(autouse=True)
def packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the installed packages by VERSIONS, of which `old` and `absent` are faulty."""

    def version(name: str) -> str:
        if name not in VERSIONS:
            raise PackageNotFoundError(name)
        return VERSIONS[name]

    monkeypatch.setattr(installation_commands, "version", version)


def require(monkeypatch: pytest.MonkeyPatch, *requirements: Requirement) -> None:
    """Replace the requirements of pinred."""
    monkeypatch.setattr(installation_commands, "read_requirements", lambda: list(requirements))


def test_doctor_without_fault_exits_with_zero(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Versions are compared as numbers, and a missing extra is no fault."""
    require(
        monkeypatch, Requirement("new", "2.9", ""), Requirement("even", "2.9.0", ""),
        Requirement("candidate", "3", ""), Requirement("absent", "1", "figures"),
        Requirement("new", "", "other"), Requirement("new", "", "all"),
    )  # fmt: skip
    assert main(["doctor"]) == 0
    lines = {line[:20].strip(): line[21:] for line in capsys.readouterr().out.splitlines()}
    assert lines["pinred"].split() == ["ok", __version__]
    assert lines["machine code"].startswith("ok")
    command = 'pip install "pinred[figures]" (in a checkout: pip install ".[figures]")'
    assert lines["extra figures"].endswith(f"absent: not installed; {command}")
    assert lines["extra other"].split() == ["ok", "new", "2.10.0"]
    assert "extra all" not in lines


def test_doctor_names_faults_and_remedies(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Missing and old packages, a wrong CPU and an unusable cache are faults."""
    require(monkeypatch, Requirement("old", "2.9", ""), Requirement("absent", "1", ""))
    monkeypatch.setenv("PINRED_CPU", "pentium9")
    (tmp_path / "file").write_bytes(b"")
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path / "file" / "below"))
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert 'version 2.8.5 is older than 2.9; pip install "old>=2.9"' in out
    assert 'not installed; pip install "absent>=1"' in out
    assert "got 'pentium9'" in out
    assert "set PINRED_CACHE_DIR" in out
    assert out.splitlines()[-1] == "5 faults"


def test_requirements_are_read_from_the_metadata(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names, lowest versions and extras are parsed; a checkout has no metadata."""

    class Metadata:
        requires = ("pin>=4", "six", "a.b<6,>=5; extra == 'robots'", "p[x,y]; extra == 'all'")

    monkeypatch.setattr(installation_commands, "distribution", lambda _: Metadata())
    assert read_requirements() == [
        ("pin", "4", ""), ("six", "", ""), ("a.b", "5", "robots"), ("p", "", "all"),
    ]  # fmt: skip

    def missing(name: str) -> object:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(installation_commands, "distribution", missing)
    assert read_requirements() == []
    assert {finding.state for finding in examine()} <= {"ok", "missing"}

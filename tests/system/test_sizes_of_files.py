"""Files whose depth, size or numbers exceed the limits of parsers or floats."""

from __future__ import annotations

from pathlib import Path

import pytest
from robot_texts import FLOATING, link, robot, write

import pinred
from pinred.system import find_robot_files

_DEEP = 10_000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"<mujoco><worldbody>{'<body>' * _DEEP}{'</body>' * _DEEP}</worldbody></mujoco>", "450"),
        (robot("<link>" * _DEEP + "</link>" * _DEEP), "100 nested elements"),
        ("<robot>" + "<link>" * _DEEP, "100 nested elements"),
        (robot(*(link(f"l{k}") for k in range(20_001))), "20001 links, more than 20000"),
    ],
)
def test_too_deep_or_too_many_elements_are_refused(text: str, message: str, tmp_path: Path) -> None:
    """They are refused before a parser in C++ reads them."""
    with pytest.raises(pinred.LoadError, match=message):
        pinred.load(write(tmp_path, text))


def test_unknown_elements_count_towards_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All elements are counted, whatever their tag."""
    monkeypatch.setattr(find_robot_files, "_MOST_ELEMENTS", 50)
    with pytest.raises(pinred.LoadError, match="more than 50 elements"):
        pinred.load(write(tmp_path, robot("<x/>" * 100)))


def test_generated_system_file_is_not_read() -> None:
    """Reading /proc/kmsg would wait for ever; a file of size zero counts as empty."""
    with pytest.raises(pinred.LoadError, match="is empty"):
        pinred.load("/proc/kmsg")


@pytest.mark.parametrize("what", ['mass value="2.0"', 'ixx="1"'])
def test_huge_mass_is_refused(what: str, tmp_path: Path) -> None:
    """The message states the mass of 1e300."""
    name = what.partition('"')[0]
    with pytest.raises(pinred.ModelError, match=r"1\.0e\+300, above 1e\+100"):
        pinred.load(write(tmp_path, FLOATING.replace(what, f'{name}"1e300"')))

"""Loading from many threads keeps standard error and the output of others."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pinred.system.find_robot_files import library_output

ROOT = Path(__file__).parents[2]
MANY = """
import os, sys, threading
import pinred

robots, said = sys.argv[1:], []
before, done = os.fstat(2), threading.Event()

def talk():
    k = 0
    while not done.is_set() or k < 200:
        os.write(2, f"<{k}>\\n".encode())
        k += 1
        done.wait(1e-4)
    said.append(k)

def load(number):
    for k in range(50):
        path = robots[(k + number) % len(robots)]
        try:
            pinred.load(path)
        except pinred.LoadError as error:
            assert "broken" in path and "damping value (x)" in str(error), error

threads = [threading.Thread(target=load, args=(n,)) for n in range(8)]
talker = threading.Thread(target=talk)
for thread in (talker, *threads):
    thread.start()
for thread in threads:
    thread.join()
done.set()
talker.join()
after = os.fstat(2)
assert (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino)
print(said[0])
"""


def run(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a separate process."""
    return subprocess.run(
        [sys.executable, "-c", code, *words], cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.mark.by_hand
def test_threads_that_load_keep_output_of_others(tmp_path: Path) -> None:
    """Standard error is the same file, and has exactly the lines of the other thread."""
    broken = tmp_path / "broken.urdf"
    broken.write_text(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/><dynamics damping="x"/></joint>'
        "</robot>"
    )
    xml = tmp_path / "robot.xml"
    xml.write_text(
        '<mujoco><default><geom contype="0" conaffinity="0"/></default><worldbody><body>'
        '<freejoint/><geom size="1"/></body></worldbody></mujoco>'
    )
    caught = run(MANY, "falling_cat", str(xml), str(broken), "cartpole")
    assert caught.returncode == 0, caught.stderr[-2000:]
    count = int(caught.stdout)
    lines = re.findall(r"<(\d+)>\n", caught.stderr)
    assert sorted(map(int, lines)) == list(range(count))
    assert re.sub(r"<\d+>\n", "", caught.stderr) == ""


OWN = re.compile(rb"^mine:[^\n]*\n", re.MULTILINE)


def test_library_output_is_caught_and_other_output_passes(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """This holds after an error too; the library's messages are returned as a list of texts."""
    with library_output(OWN) as said:
        os.write(2, b"mine: one\ntheirs\nmine: two\nand more")
    assert said == ["mine: one", "mine: two"]
    assert capfd.readouterr().err == "theirs\nand more"

    def fail() -> None:
        with library_output(OWN):
            os.write(2, b"theirs\n")
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert capfd.readouterr().err == "theirs\n"


@pytest.mark.slow
def test_loading_without_standard_error() -> None:
    """A process without standard error can load robots."""
    code = (
        "import os, sys; import pinred; os.close(2); sys.stderr = None\n"
        "print(pinred.load('falling_cat').m)\n"
        "try: os.fstat(2)\nexcept OSError: print('none')"
    )
    caught = run(code)
    assert caught.stdout == "3\nnone\n"


def test_forked_child_has_standard_error() -> None:
    """A child that is forked while output is caught has the right standard error."""
    code = """
import os, re, threading, time
from pinred.system.find_robot_files import library_output
caught, out = threading.Event(), []

def catch():
    with library_output(re.compile(b"x^")):
        caught.set()
        time.sleep(0.3)

thread = threading.Thread(target=catch)
before = os.fstat(2)
thread.start()
caught.wait()
child = os.fork()
if not child:
    after = os.fstat(2)
    os._exit(0 if (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino) else 1)
thread.join()
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert run(code).stdout == "0\n"

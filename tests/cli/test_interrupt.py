"""Ctrl-C: every command ends soon after the first, with exit code 130 and one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from interruptions import BEGIN, interrupted

from pinred.common.arrays import Array
from pinred.common.interrupts import held_interrupt
from pinred.judge.hairer import Hairer


def check(at: float) -> None:
    """Interrupt a comparison that takes long, most of it in the full simulation."""
    code, _, error = interrupted(at, "-c", BEGIN, "compare", "falling_cat", "--time", "300")
    assert (code, error) == (130, "pinred: interrupted\n"), at


@pytest.mark.slow
@pytest.mark.parametrize("part", range(20))
def test_compare_ends(part: int) -> None:
    """At random times from its start on."""
    rng = np.random.default_rng(part)
    check(0.2 + 2.8 * (part + rng.random()) / 20)


@pytest.mark.slow
def test_compare_ends_in_the_full_simulation() -> None:
    """Where SciPy's compiled loop swallows what is raised."""
    check(3.0)


@pytest.mark.parametrize(
    "runs",
    [
        "    while True:\n        try:\n            time.sleep(0.01)\n"
        "        except KeyboardInterrupt:\n            pass\n",
        "    ctypes.CFUNCTYPE(None)(lambda: time.sleep(5.0))()\n    return 0\n",
    ],
    ids=["caught again and again", "in a callback of C, where Python prints it and goes on"],
)
def test_what_is_swallowed_ends_too(runs: str) -> None:
    """The process ends in one line even where nobody lets KeyboardInterrupt out."""
    swallowing = (
        "import ctypes, sys, time\nfrom pinred.cli import main\nfrom pinred.cli import entry\n"
        f"def run():\n    print('ready', flush=True)\n{runs}"
        "main.main = run\nsys.exit(entry.main())\n"
    )
    code, _, error = interrupted(0.5, "-c", swallowing)
    assert (code, error) == (130, "pinred: interrupted\n")


def _after(seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    return timer


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_python_gets_it_too(method: str) -> None:
    """KeyboardInterrupt comes out of a run from Python, and the handler is as before."""
    before = signal.getsignal(signal.SIGINT)
    fast = Hairer(
        lambda t, y: np.cos(1e6 * t) + 0.0 * y, method, np.ones(1), 0.0, 1e-12, 1e-14, 100.0
    )
    timer = _after(0.2)
    with pytest.raises(KeyboardInterrupt):
        fast.integrate(100.0)
    timer.join()
    assert signal.getsignal(signal.SIGINT) is before


def test_errors_come_out() -> None:
    """What a vector field raises is raised by the run, not swallowed by its compiled loop."""

    def rate(t: float, y: Array) -> Array:
        if t > 0.5:
            raise ZeroDivisionError("here")
        return -y

    with pytest.raises(ZeroDivisionError, match="here"):
        Hairer(rate, "dop853", np.ones(1), 0.0, 1e-10, 1e-12, 1.0).integrate(1.0)


def test_hairer_without_interruption() -> None:
    """The exponential, against its closed form."""
    y = Hairer(lambda _, y: -y, "dop853", np.ones(1), 0.0, 1e-13, 1e-15, 1.0).integrate(1.0)
    assert y is not None
    assert y[0] == pytest.approx(np.exp(-1.0), rel=1e-12)


def test_held_in_a_thread_is_nothing() -> None:
    """Signals come to the main thread only, and a thread may not ask for them."""
    told: list[bool] = []

    def work() -> None:
        with held_interrupt() as came:
            told.append(came())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert told == [False]


@pytest.mark.slow
def test_ignored_stays_ignored(tmp_path: Path) -> None:
    """A command that `nohup` or a shell's & has told to ignore Ctrl-C goes on."""
    code = (
        "import signal, sys\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        f"sys.argv[1:] = ['simulate', 'falling_cat', '--out', {str(tmp_path / 'a.npz')!r}]\n"
        "from pinred.cli.entry import main\nimport os\nos.kill(os.getpid(), signal.SIGINT)\n"
        "sys.exit(main())\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


@pytest.mark.slow
def test_interrupts_work_where_the_shell_ignores_them() -> None:
    """The tests of this file also pass below `nohup … &`, where SIGINT is ignored at first."""
    test = f"{__file__}::test_python_gets_it_too"
    code = (
        "import signal, subprocess, sys\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        f"run = [sys.executable, '-m', 'pytest', '-q', '-p', 'no:xdist', {test!r}]\n"
        "sys.exit(subprocess.run(run, capture_output=True).returncode)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0

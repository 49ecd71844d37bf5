"""Ctrl-C: every command ends soon after the first one, with exit code 130 and one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from interruptions import BEGIN, interrupted

from pinred.common.arrays import Array
from pinred.common.waiting import held_interrupt
from pinred.judge.reference_integrators import Hairer


def check(at: float) -> None:
    """Interrupt a comparison that takes long, most of it in the full simulation."""
    code, _, error = interrupted(at, "-c", BEGIN, "compare", "planar_chain5", "--duration", "3000")
    assert (code, error) == (130, "pinred: interrupted\n"), at


@pytest.mark.by_hand
@pytest.mark.parametrize("part", range(20))
def test_interrupt_at_random_times_ends_compare(part: int) -> None:
    """The interrupt arrives at random times after the start."""
    rng = np.random.default_rng(part)
    check(0.2 + 2.8 * (part + rng.random()) / 20)


@pytest.mark.slow
def test_interrupt_ends_compare_during_aba() -> None:
    """SciPy's compiled loop swallows the exception there.

    The process says when the full simulation begins, so that no speed of a machine counts.
    """
    announced = (
        "import sys\nfrom pinred.cli.entry import main\n"
        "from pinred.judge.reference_integrators import Hairer\n"
        "integrate = Hairer.integrate\n"
        "def announce(*arguments):\n"
        "    Hairer.integrate = integrate\n    print('ready', flush=True)\n"
        "    return integrate(*arguments)\n"
        "Hairer.integrate = announce\nsys.exit(main())\n"
    )
    code, _, error = interrupted(
        0.2, "-c", announced, "compare", "planar_chain5", "--duration", "3000", "--rtol", "1e-12"
    )
    assert (code, error) == (130, "pinred: interrupted\n")


@pytest.mark.parametrize(
    "runs",
    [
        "    while True:\n        try:\n            time.sleep(0.01)\n"
        "        except KeyboardInterrupt:\n            pass\n",
        "    ctypes.CFUNCTYPE(None)(lambda: time.sleep(5.0))()\n    return 0\n",
    ],
    ids=["caught again and again", "in a callback of C, where Python prints it and goes on"],
)
def test_swallowed_interrupt_ends_the_process(runs: str) -> None:
    """Libraries that swallow KeyboardInterrupt do not keep the process running."""
    swallowing = (
        "import ctypes, sys, time\nfrom pinred.cli import command_line, entry\n"
        f"def run():\n    print('ready', flush=True)\n{runs}"
        "command_line.main = run\nsys.exit(entry.main())\n"
    )
    code, _, error = interrupted(0.5, "-c", swallowing)
    assert (code, error) == (130, "pinred: interrupted\n")


def _after(seconds: float) -> threading.Timer:
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    return timer


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_interrupt_raises_keyboard_interrupt_in_python(method: str) -> None:
    """The signal handler is restored."""
    before = signal.getsignal(signal.SIGINT)
    fast = Hairer(
        lambda t, y: np.cos(1e6 * t) + 0.0 * y, method, np.ones(1), 0.0, 1e-12, 1e-14, 100.0
    )
    timer = _after(0.2)
    with pytest.raises(KeyboardInterrupt):
        fast.integrate(100.0)
    timer.join()
    assert signal.getsignal(signal.SIGINT) is before


def test_error_in_vector_field_is_raised() -> None:
    """SciPy's compiled loop does not swallow it."""

    def rate(t: float, y: Array) -> Array:
        if t > 0.5:
            raise ZeroDivisionError("here")
        return -y

    with pytest.raises(ZeroDivisionError, match="here"):
        Hairer(rate, "dop853", np.ones(1), 0.0, 1e-10, 1e-12, 1.0).integrate(1.0)


def test_hairer_integrates_the_exponential() -> None:
    """Without an interrupt, the result is the closed form."""
    y = Hairer(lambda _, y: -y, "dop853", np.ones(1), 0.0, 1e-13, 1e-15, 1.0).integrate(1.0)
    assert y is not None
    assert y[0] == pytest.approx(np.exp(-1.0), rel=1e-12)


def test_interrupt_handling_is_off_in_threads() -> None:
    """Only the main thread may handle signals."""
    told: list[bool] = []

    def work() -> None:
        with held_interrupt() as came:
            told.append(came())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert told == [False]


@pytest.mark.slow
def test_ignored_interrupt_stays_ignored() -> None:
    """As with `nohup`, or with `&` in a shell."""
    code = (
        "import signal, sys\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "sys.argv[1:] = ['robots']\n"
        "from pinred.cli.entry import main\nimport os\nos.kill(os.getpid(), signal.SIGINT)\n"
        "sys.exit(main())\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


@pytest.mark.by_hand
def test_interrupt_tests_pass_below_nohup() -> None:
    """SIGINT is ignored at first there."""
    test = f"{__file__}::test_interrupt_raises_keyboard_interrupt_in_python"
    code = (
        "import signal, subprocess, sys\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        f"run = [sys.executable, '-m', 'pytest', '-q', {test!r}]\n"
        "sys.exit(subprocess.run(run, capture_output=True).returncode)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0

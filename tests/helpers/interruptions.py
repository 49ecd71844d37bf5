"""Ctrl-C at random times of a command: `python tests/helpers/interruptions.py 100 [seed]`.

The command is a comparison of a long motion, most of which is the full simulation. The first Ctrl-C
has to end it, with exit code 130 and one line. A short form is in tests/cli/test_interrupt.py.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np

SOON = 0.5  # s, longest time from Ctrl-C to the end of the process
PATIENCE = 60.0  # s, after which a process counts as hanging and is killed
# The command line, which prints a line first: until then, tracebacks are Python's, not pinred's.
BEGIN = (
    "import sys\nfrom pinred.cli.entry import main\nprint('ready', flush=True)\nsys.exit(main())\n"
)
COMMAND = ("-c", BEGIN, "compare", "falling_cat", "--duration")


def interrupted(at: float, *command: str) -> tuple[int, float, str]:
    """Interrupt a Python process some time after its first line of output.

    Args:
        at: Time from the first line of output to the interrupt [s].
        command: Arguments of the Python interpreter.

    Returns:
        The exit code, the time from the interrupt to the end [s], and the standard error.
    """
    process = subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    try:
        process.wait(at)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    began = time.monotonic()
    try:
        _, error = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        _, error = process.communicate()
    return process.returncode, time.monotonic() - began, error


def main(arguments: list[str]) -> int:
    """Interrupt a command of a few seconds at random times; return 1 if one did not end well."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` ignores it
    count, seed = int(arguments[0]), int(arguments[1]) if len(arguments) > 1 else 0
    began = time.monotonic()
    subprocess.run([sys.executable, *COMMAND, "60"], capture_output=True, check=True)
    duration = time.monotonic() - began
    times = duration * np.random.default_rng(seed).random(count)
    delays, failures, finished = [], 0, 0
    for at in times.tolist():
        code, delay, error = interrupted(at, *COMMAND, "60")
        if code == 0:
            finished += 1
            continue
        delays.append(delay)
        if (code, error) != (130, "pinred: interrupted\n"):
            failures += 1
            print(f"{at:.3f} s: exit code {code}: {error[-300:]}", flush=True)
    late = sum(delay > SOON for delay in delays)
    print(
        f"{count} interrupts within {duration:.1f} s: {finished} came after the end, "
        f"{len(delays) - failures} ended the command well, {failures} did not; "
        f"the slowest took {max(delays, default=0.0):.2f} s, {late} more than {SOON} s"
    )
    return int(failures > 0 or late > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Ctrl-C at random times of a command: `python tests/helpers/interruptions.py 100 [seed]`.

The command is a comparison of a long motion, most of it in the full simulation.  It has to end by
the first Ctrl-C, with exit code 130 and one line.  The short form is part of the suite
(tests/cli/test_interrupt.py).
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np

SOON = 0.5  # s
BEGINS = 0.1  # s in which Python itself begins, whose tracebacks are not pinred's
COMMAND = ("-m", "pinred", "compare", "falling_cat", "--time")


def interrupted(at: float, *command: str) -> tuple[int, float, str]:
    """Return exit code, seconds to the end and standard error of a process stopped at a time."""
    process = subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        process.wait(at)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    began = time.monotonic()
    try:
        _, error = process.communicate(timeout=20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        _, error = process.communicate()
    return process.returncode, time.monotonic() - began, error


def main(arguments: list[str]) -> int:
    """Interrupt a command that takes a few seconds, at times from its start to its end."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # not ignored, as behind `&`
    count, seed = int(arguments[0]), int(arguments[1]) if len(arguments) > 1 else 0
    began = time.monotonic()
    subprocess.run([sys.executable, *COMMAND, "60"], capture_output=True, check=True)
    whole = time.monotonic() - began
    times = BEGINS + (whole - BEGINS) * np.random.default_rng(seed).random(count)
    took, wrong, done, early = [], 0, 0, 0
    for at in times.tolist():
        code, seconds, error = interrupted(at, *COMMAND, "60")
        if code == 0:  # it was done before
            done += 1
            continue
        if "KeyboardInterrupt" in error and "/pinred/" not in error:  # Python was still starting
            early += 1
            continue
        took.append(seconds)
        if (code, error) != (130, "pinred: interrupted\n"):
            wrong += 1
            print(f"{at:.3f} s: exit code {code}: {error[-300:]}", flush=True)
    late = sum(seconds > SOON for seconds in took)
    print(
        f"{count} times within {whole:.1f} s: {done} had ended, {early} came before "
        f"pinred began, {len(took) - wrong} ended well, "
        f"{wrong} not; the slowest took {max(took, default=0.0):.2f} s, {late} more than {SOON} s"
    )
    return int(wrong > 0 or late > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

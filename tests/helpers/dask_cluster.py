"""A Dask scheduler and workers on loopback, each a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
# Free ports on loopback, so that several clusters can run at once.
_LOCAL = ("--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0")


class DaskCluster:
    """A scheduler with workers, which can be killed.

    Attributes:
        address: Address of the scheduler.
        workers: Processes of the workers.
    """

    def __init__(self, folder: Path) -> None:
        """Start a scheduler.

        Args:
            folder: Folder for its files.
        """
        self._folder, self._processes = folder, list[subprocess.Popen[bytes]]()
        file = folder / "scheduler.json"
        words = ("--port", "0", "--scheduler-file", str(file))
        self._start("dask", "scheduler", *_LOCAL, *words)
        for _ in range(600):
            if file.exists() and file.read_text():
                break
            time.sleep(0.05)
        self.address = str(json.loads(file.read_text())["address"])
        self.workers: list[subprocess.Popen[bytes]] = []

    def add_worker(self, **environment: str) -> subprocess.Popen[bytes]:
        """Start a worker with one thread, without a nanny; return its process."""
        process = self._start(
            "dask", "worker", self.address, *_LOCAL, "--nthreads", "1", "--no-nanny",
            "--local-directory", str(self._folder), **environment,
        )  # fmt: skip
        self.workers.append(process)
        return process

    def _start(self, *words: str, **environment: str) -> subprocess.Popen[bytes]:
        log = self._folder / f"{words[1]}-{len(self._processes)}.log"
        with log.open("wb") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", *words], cwd=ROOT, stdout=file,
                stderr=file, env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
            )  # fmt: skip
        self._processes.append(process)
        return process

    def logs(self) -> str:
        """Return the output of all processes."""
        return "\n".join(path.read_text() for path in sorted(self._folder.glob("*.log")))

    def close(self) -> None:
        """End all processes."""
        for process in reversed(self._processes):
            process.kill()
            process.wait()

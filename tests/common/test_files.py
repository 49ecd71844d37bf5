"""Tests of atomic file writing and of temporary files left by killed processes."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path
from threading import Thread
from typing import BinaryIO

import pytest

import pinred
from pinred.common.files import check_path, remove_temporary_files, write_atomic
from pinred.common.names import quoted_path

WRITE = """
import sys, time
from pathlib import Path
from pinred.common.files import write_atomic

def slow(file):
    file.write(b"half")
    file.flush()
    print("writing", flush=True)
    time.sleep(20)

write_atomic(Path(sys.argv[1]), slow)
"""


def files_in(folder: Path) -> list[str]:
    """Return the sorted names in a folder."""
    return sorted(path.name for path in folder.iterdir())


def test_write_removes_temporary_file_of_killed_process(tmp_path: Path) -> None:
    """A temporary file stays while its process lives and is removed by the next writer."""
    with subprocess.Popen(
        [sys.executable, "-c", WRITE, str(tmp_path / "a.npz")], stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"writing\n"
        (temporary,) = files_in(tmp_path)
        write_atomic(tmp_path / "b.npz", lambda file: file.write(b"b"))
        assert files_in(tmp_path) == sorted([temporary, "b.npz"])
        process.send_signal(signal.SIGKILL)
    assert files_in(tmp_path) == sorted([temporary, "b.npz"])
    stranger = tmp_path / ".pinred-notes.tmp"
    stranger.write_text("not ours")
    write_atomic(tmp_path / "c.npz", lambda file: file.write(b"c"))
    assert files_in(tmp_path) == sorted([stranger.name, "b.npz", "c.npz"])


def test_temporary_files_are_removed_below_a_folder_unless_locked(tmp_path: Path) -> None:
    """Those of ended processes disappear from all folders; one that is being written stays."""
    inner = tmp_path / "c" / "0"
    inner.mkdir(parents=True)
    names = [f".pinred-{k:016x}.tmp" for k in range(2)]
    for folder, name in zip((tmp_path, inner), names, strict=True):
        (folder / name).write_bytes(b"half")

    def write(file: BinaryIO) -> None:
        (inner / names[0]).write_bytes(b"half")  # the writer has removed older ones
        remove_temporary_files(tmp_path)
        assert files_in(tmp_path) == ["c"]
        (locked,) = files_in(inner)
        assert locked not in names
        file.write(b"all")

    write_atomic(inner / "a.npz", write)
    assert files_in(inner) == ["a.npz"]


def test_write_atomic_in_parallel_threads_keeps_all_files(tmp_path: Path) -> None:
    """No thread removes the temporary file of another."""

    def work(number: int) -> None:
        for k in range(40):
            text = f"{number} {k}".encode()
            write_atomic(tmp_path / f"{number}.npz", lambda file, text=text: file.write(text))  # type: ignore[misc]
            check_path(tmp_path / f"{number}.npz")

    threads = [Thread(target=work, args=(n,)) for n in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [(tmp_path / f"{n}.npz").read_bytes() for n in range(6)] == [
        f"{n} 39".encode() for n in range(6)
    ]
    assert len(files_in(tmp_path)) == 6


def test_write_atomic_failure_keeps_old_file(tmp_path: Path) -> None:
    """A failed write leaves no temporary file; a new file has the rights that the umask allows."""
    path = tmp_path / "a.npz"
    write_atomic(path, lambda file: file.write(b"old"))
    before = os.umask(0o027)
    try:
        write_atomic(path, lambda file: file.write(b"old"))
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640

    def fail(_: object) -> None:
        raise KeyError

    with pytest.raises(KeyError):
        write_atomic(path, fail)
    assert path.read_bytes() == b"old"
    assert files_in(tmp_path) == ["a.npz"]


@pytest.mark.by_hand
@pytest.mark.slow
def test_check_path_rejects_protected_targets(tmp_path: Path) -> None:
    """`--out` rejects a read-only file, a FIFO and a folder before the simulation."""
    kept, pipe, folder = (tmp_path / f"{name}.npz" for name in ("kept", "pipe", "folder"))
    kept.write_bytes(b"kept")
    kept.chmod(0o444)
    os.mkfifo(pipe)
    folder.mkdir()
    for path, message in ((kept, "read-only"), (pipe, "a FIFO"), (folder, "a folder")):
        done = subprocess.run(
            [sys.executable, "-m", "pinred", "simulate", "falling_cat", "--out", str(path)],
            capture_output=True, text=True, check=False, timeout=60,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        )  # fmt: skip
        assert done.returncode == 2
        assert message in done.stderr
        assert done.stderr.count("\n") == 1
    assert kept.read_bytes() == b"kept"
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    link = tmp_path / "link.npz"
    link.symlink_to(kept)
    with pytest.raises(pinred.OutputError, match="read-only"):
        check_path(link)


def test_check_path_shortens_names_in_messages(tmp_path: Path) -> None:
    """A message shows a long path in one line, cut in the middle."""
    with pytest.raises(pinred.InputError) as caught:
        check_path(tmp_path / f"a\nb{'c' * 500}.txt")
    assert "\n" not in str(caught.value)
    assert "a b" in str(caught.value) or "…" in str(caught.value)
    assert len(str(caught.value)) < 300
    assert len(quoted_path("x" * 10_000)) == 202

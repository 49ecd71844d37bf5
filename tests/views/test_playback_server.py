"""The player: local access only, ports, Ctrl-C, and film errors."""

from __future__ import annotations

import contextlib
import http.client
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused

import pinred
from pinred.cli import view_commands
from pinred.cli.command_line import main
from pinred.views.motions import play_view
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.page import Player


def listeners(port: int) -> set[str]:
    """Return the addresses that listen at a port, from the kernel's tables."""
    result = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            address, at = line.split()[1].split(":")
            if line.split()[3] == "0A" and int(at, 16) == port:
                result.add(address)
    return result


def own_address() -> str:
    """Return an address of this machine other than loopback; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            pytest.skip("this machine has no address but the loopback's")
        return str(probe.getsockname()[0])


def answer(
    player: Player, path: str = "/", method: str = "GET", **headers: str
) -> tuple[int, bytes]:
    """Return status and body of a request."""
    link = http.client.HTTPConnection("127.0.0.1", int(player.url.split(":")[2].strip("/")))
    link.request(method, path, headers=headers)
    response = link.getresponse()
    body = response.read()
    link.close()
    return response.status, body


def test_player_listens_on_loopback_only() -> None:
    """A socket on all interfaces would be detected."""
    with Player(b"page") as player:
        port = int(player.url.split(":")[2].strip("/"))
        assert listeners(port) == {"0100007F"}
        with pytest.raises(OSError, match="refused"):
            socket.create_connection((own_address(), port), timeout=5.0)
    with socket.create_server(("", 0)) as everywhere:
        port = everywhere.getsockname()[1]
        assert listeners(port) == {"00000000"}
        socket.create_connection((own_address(), port), timeout=5.0).close()


def test_player_rejects_other_paths_and_hosts() -> None:
    """Other paths are not found; foreign host names are forbidden."""
    with Player(b"page") as player:
        assert answer(player) == (200, b"page")
        assert answer(player, method="HEAD") == (200, b"")
        assert answer(player, "/../etc/passwd")[0] == 404
        status, body = answer(player, Host="evil.example")
        assert status == 403
        assert b"page" not in body
        assert answer(player, method="POST")[0] == 501


def test_taken_port_is_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    """Without a port a free one is used; close() frees the port."""
    first = Player(b"1")
    port = int(first.url.split(":")[2].strip("/"))
    with pytest.raises(
        pinred.InputError, match=f"port {port} is taken; choose another port, or none"
    ):
        Player(b"2", port)
    with Player(b"2") as second:
        assert answer(first)[1] + answer(second)[1] == b"12"
    first.close()
    first.close()
    assert not listeners(port)
    with Player(b"3", port) as third:
        assert answer(third)[1] == b"3"
    for wrong in (0, 65536, True, "80", 80.5):
        with pytest.raises(pinred.InputError, match="port must be a whole number"):
            Player(b"", wrong)  # type: ignore[arg-type]
    # It is said before the motion is even read, or drawn.
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        words = f"port {port} is taken"
        with pytest.raises(pinred.InputError, match=words):
            play_view(None, View(), port=port)  # type: ignore[arg-type]
        assert main(["play", "gone.npz", "--port", str(port)]) == 2
        assert words in capsys.readouterr().err


def test_play_waits_in_scripts_only(capsys: pytest.CaptureFixture[str]) -> None:
    """In interactive sessions play() returns at once."""
    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=0.5)
    with pinred.play(traj, show=False, wait=False) as player:
        said = capsys.readouterr().out
        assert said == f"playing at {player.url}\n"
        status, body = answer(player)
        assert status == 200
        assert b"elroys_beanie" in body


# Ctrl-C during `play` in one process is tried by default.
@pytest.mark.by_hand
@pytest.mark.slow
def test_ctrl_c_ends_play_command(tmp_path: Path) -> None:
    """`pinred play` serves until Ctrl-C and ends with exit code 0."""
    path = tmp_path / "traj.npz"
    assert main(["simulate", "elroys_beanie", "--duration", "0.5", "--out", str(path)]) == 0
    # A job that a shell has put in the background ignores Ctrl-C, and so would its children.
    begin = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"{begin}; from pinred.cli.command_line import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, "play", str(path), "--no-open"]
    with (
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process,
        contextlib.ExitStack() as stack,
    ):
        stack.callback(process.kill)
        assert process.stdout is not None
        said = process.stdout.readline()
        port = int(said.split(":")[2].split("/")[0])
        assert said.startswith("playing at http://127.0.0.1:")
        assert listeners(port) == {"0100007F"}
        process.send_signal(signal.SIGINT)
        printed, err = process.communicate(timeout=20.0)
        assert (process.returncode, printed, err) == (0, "", "")
    assert not listeners(port)


@pytest.mark.parametrize("when", ["print", "open", "wait"])
def test_ctrl_c_during_play(when: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends the player; without waiting it raises KeyboardInterrupt."""
    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=0.1)
    players: list[Player] = []
    begin = Player.__init__

    def kept(player: Player, content: bytes, port: int | None = None) -> None:
        begin(player, content, port)
        players.append(player)

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Player, "__init__", kept)
    if when == "print":
        monkeypatch.setattr("builtins.print", interrupted)
    else:
        monkeypatch.setattr(Player, when, interrupted)
    pinred.play(traj, show=when == "open", wait=True)
    if when != "wait":
        with pytest.raises(KeyboardInterrupt):
            pinred.play(traj, show=when == "open", wait=False)
    assert len(players) == (1 if when == "wait" else 2)
    for player in players:
        assert not listeners(int(player.url.split(":")[2].strip("/")))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("traj.npy",), "no such file: traj.npy"),
        (("unknown_robot",), "unknown_robot"),
        (("cartpole", "--robot", "solo12"), "--robot applies to .npz files"),
        (("gone.npz",), "no such file: gone.npz"),
        (("gone.toml",), "gone.toml"),
        (("traj.npz", "--ghost"), "contains no forces"),
        (("traj.npz", "--robot", "solo12"), "name the right robot"),
        (("scene.toml", "--robot", "solo12"), "--robot applies to .npz files"),
        (("traj.npz", "--out", "film.avi"), "suffix must be .html or .rrd or .mp4 or .gif or .png"),
        (("traj.npz", "--speed", "0"), "speed must be finite and above zero"),
        (("traj.npz", "--pair", "a,b"), "pair: no joint 'a'; the joints are beanie"),
        (("traj.npz", "--port", "70000"), "port must be a whole number"),
        (("traj.npz", "--port", "0", "--out", "a.html"), "--port applies to playback in a browser"),
        (("traj.npz", "--fps", "1e12", "--out", "a.html"), "at its stored times"),
        (("traj.npz", "--fps", "30"), "--fps applies to films and scenes"),
    ],
)
def test_bad_input_is_reported_in_one_line(
    arguments: tuple[str, ...],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exit code 2, one line on standard error, no file."""
    monkeypatch.chdir(tmp_path)
    pinred.simulate(pinred.load("elroys_beanie"), duration=0.1).save("traj.npz")
    assert words in refused(capsys, "play", *arguments)
    assert [path.name for path in tmp_path.iterdir()] == ["traj.npz"]


@pytest.mark.parametrize("robot", ["satellite_two_arms", "cartpole", "four_bar", "pendulum.xml"])
@pytest.mark.sampled
def test_play_command_shows_a_robot_at_rest(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gravity and springs of the file do not move it."""
    monkeypatch.chdir(tmp_path)
    Path("pendulum.xml").write_text(
        '<mujoco><worldbody><body><joint type="hinge" axis="0 1 0" stiffness="3" springref="40"/>'
        '<geom size=".1" pos="1 0 0" contype="0" conaffinity="0"/><body pos="1 0 0"><joint '
        'axis="1 0 0"/><geom size=".1" pos="0 .3 0" contype="0" conaffinity="0"/></body></body>'
        "</worldbody></mujoco>"
    )
    shown: list[Any] = []
    monkeypatch.setattr(view_commands, "show_motion", lambda motion, *_, **__: shown.append(motion))
    assert main(["play", robot]) == 0
    (traj,) = shown
    assert traj.t.tolist() == [0.0, 1.0]
    assert np.abs(traj.v).max() < 1e-12
    assert np.abs(traj.q[1] - traj.q[0]).max() < 1e-12


def test_play_command_writes_pages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From a file and from a scene; the size is printed."""
    pinred.simulate(pinred.load("elroys_beanie"), duration=0.1).save(tmp_path / "traj.npz")
    scene = tmp_path / "scene.toml"
    scene.write_text('robot = "falling_cat"\n[run]\nduration = 0.2\n')
    for motion, more in ((tmp_path / "traj.npz", ()), (scene, ("--ghost",))):
        printed = tmp_path / "page.html"
        assert main(["play", str(motion), "--out", str(printed), *more]) == 0
        size = printed.stat().st_size
        assert f"written to {printed} ({size / 1e6:.2f} MB)" in capsys.readouterr().out
        assert size < 2e6
        printed.unlink()


def test_invalid_films_are_rejected_before_rendering(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Invalid options, and missing programs with instructions."""
    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=0.1)

    def refused(words: str, name: str, **options: Any) -> None:
        with pytest.raises(pinred.InputError, match=words):
            pinred.save_film(traj, tmp_path / name, **options)
        assert not list(tmp_path.iterdir())

    refused("two even numbers of pixels", "film.gif", size=(321, 240))
    refused("two even numbers of pixels", "film.gif", size=(320,))
    refused("two even numbers of pixels", "film.gif", size=320)
    refused("fps must be at most 120", "film.mp4", fps=200)
    refused(r"fps must be from 0\.01 to 50 in a gif.*got 60; an \.mp4", "film.gif", fps=60)
    refused(r"100001 frames are too many.*lower fps", "film.png", speed=1e-6, fps=1)
    refused("suffix must be .mp4 or .gif or .png", "film.avi")
    refused("no option 'frames'; the options are ghost", "film.gif", frames=3)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    refused(r"apt-get install ffmpeg, or pip install \"pinred\[film\]\"", "film.mp4")

"""Draw the pictures of docs/gallery.md again: `python docs/builder/draw.py [NAME …]`."""

from __future__ import annotations

import os
import re
import sys
import time
from pathlib import Path

DOCS = Path(__file__).parents[1]
FOLDERS = {
    ".png": "docs/pictures",
    ".zarr": "docs/generated",
}  # of files that commands write or read


def commands_of(text: str) -> dict[str, list[str]]:
    """Return the words of the commands that draw pictures, by the name of the picture.

    Args:
        text: Markdown with console blocks whose commands end with `--out NAME.png`.
    """
    found = {}
    for line in re.findall(r"^\$ pinred (.*)$", text, re.MULTILINE):
        if match := re.search(r"--out ([\w-]+)\.png$", line):
            found[match[1]] = line.split()
    return found


def sweeps_of(text: str) -> list[list[str]]:
    """Return the words of the commands that compute the results of sweeps."""
    return [line.split() for line in re.findall(r"^\$ pinred (sweep .*)$", text, re.MULTILINE)]


def draw(words: list[str]) -> None:
    """Run a command of the gallery in the current folder, with its files in folders of docs."""
    from pinred.cli.command_line import main as run

    code = run([f"{FOLDERS[s]}/{w}" if (s := Path(w).suffix) in FOLDERS else w for w in words])
    if code:
        raise SystemExit(f"pinred {' '.join(words)} ended with code {code}")


def shrink(path: Path, width: int = 1200) -> None:
    """Store a picture with a palette, so that it has some tens of kilobytes.

    Args:
        path: PNG file.
        width: Largest width [px].
    """
    from PIL import Image

    image = Image.open(path).convert("RGB")
    if image.width > width:
        height = round(image.height * width / image.width)
        image = image.resize((width, height), Image.Resampling.LANCZOS)
    image.quantize(224, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> None:
    """Draw the pictures that the arguments name, or all."""
    sys.path.insert(0, str(DOCS.parent))
    os.chdir(DOCS.parent)
    for folder in FOLDERS.values():
        Path(folder).mkdir(exist_ok=True)
    text = (DOCS / "gallery.md").read_text("utf-8")
    wanted = sys.argv[1:]
    commands = {k: words for k, words in commands_of(text).items() if not wanted or k in wanted}
    for words in sweeps_of(text):
        if any(words[-1] in command for command in commands.values()):  # of the store
            draw(words)
    for name, words in commands.items():
        start = time.monotonic()
        draw(words)
        shrink(DOCS / f"pictures/{name}.png")
        print(f"{name}.png: {time.monotonic() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()

"""find_file(): the model or mesh that a URI in an SDF file names.

Nothing is downloaded.  Models of Gazebo's server are searched in the given folders, and in the
folder in which Gazebo keeps what it has downloaded.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from ..common.files import is_file, is_folder
from ..common.names import listed, plain_path, quoted
from .robot_files import read_xml

NEWEST = (1, 12)  # newest version of SDF that pinred reads
_FOLDERS = (  # environment variables with folders of models
    "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH",
    "GAZEBO_RESOURCE_PATH", "ROS_PACKAGE_PATH",
)  # fmt: skip
# Folders of Gazebo's downloads: an environment variable, or a folder in the home folder.
_DOWNLOADS = (
    ("GZ_FUEL_CACHE_PATH", ".gz/fuel"),
    ("IGN_FUEL_CACHE_PATH", ".ignition/fuel"),
)
# Server, owner, name, version and inner path of a model.
_SERVED = re.compile(
    r"(?:https?|fuel)://(?P<server>[^/]+)/(?:\d[\d.]*/)?(?P<owner>[^/]+)/models/(?P<name>[^/]+)"
    r"(?:/(?P<version>\d+|tip))?(?:/files)?(?:/(?P<inside>.+))?"
)


def find_file(uri: str, file: Path, folders: Sequence[str]) -> Path | str:
    """Return the path of a model or mesh, or why there is none.

    Args:
        uri: URI in the file.
        file: Path of the file.
        folders: Folders in which models are searched, besides those of the environment and those
            above the file.
    Raises:
        LoadError: The config of a model is not XML.
    """
    scheme, mark, location = uri.partition("://")
    scheme, location = (scheme, location) if mark else ("", uri)
    above = [str(folder) for folder in file.resolve().parents]
    named = [*folders, *_environment()]
    if scheme in ("http", "https", "fuel"):
        candidates = list(_downloads(uri, named))
    elif scheme == "file":
        candidates = [Path(location)]
    elif scheme == "":
        candidates = [Path(folder, location) for folder in (above[0], *named)]
    elif scheme in ("model", "package"):
        first, _, inside = location.partition("/")
        candidates = [Path(folder, location) for folder in (*named, *above)]
        candidates += [Path(folder, inside) for folder in named if Path(folder).name == first]
    else:
        return f"unknown scheme {quoted(scheme)}; use model://, package:// or file://"
    for candidate in candidates if location else ():
        if is_file(candidate):
            return candidate
        if is_folder(candidate):
            return _model_file(candidate)
    if scheme in ("http", "https", "fuel"):
        served = _SERVED.fullmatch(uri)
        name = "the model" if served is None else quoted(unquote(served["name"]))
        return (
            f'pinred downloads nothing. Download the model (`gz fuel download -u "'
            f'{plain_path(uri)}"`), or pass a folder that contains {name} as meshes='
        )
    return (
        f"not found in {listed([plain_path(path.parent) for path in candidates], 4)}; pass the "
        "folder that contains the model as meshes=, or set GZ_SIM_RESOURCE_PATH"
    )


def _downloads(uri: str, named: Sequence[str]) -> Iterator[Path]:
    """Yield the places of a model of Gazebo's server: in folders, and among its downloads."""
    served = _SERVED.fullmatch(uri)
    if served is None:
        return
    name, inside = unquote(served["name"]), unquote(served["inside"] or "")
    yield from (Path(folder, name, inside) for folder in named)
    for variable, folder in _DOWNLOADS:
        cache = Path(os.environ.get(variable) or Path.home() / folder)
        # Gazebo writes owners and names in lower case, with a folder for each version.
        model = cache / served["server"] / unquote(served["owner"]).lower() / "models"
        model /= name.lower()
        versions = [path.name for path in model.glob("*") if path.name.isdigit()]
        stated = served["version"] or "tip"
        for version in sorted(versions, key=int, reverse=True):
            if stated in ("tip", version):
                yield model / version / inside


def _environment() -> list[str]:
    """Return the folders in the environment variables of Gazebo and ROS."""
    folders = [
        folder
        for variable in _FOLDERS
        for folder in os.environ.get(variable, "").split(os.pathsep)
        if folder
    ]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*folders, *(str(Path(prefix, "share")) for prefix in prefixes if prefix)]


def _model_file(folder: Path) -> Path | str:
    """Return the file of a model in the newest version that its config names, or why not."""
    best, source = None, folder
    version: tuple[int, ...] = (-1,)
    for name in ("model.config", "manifest.xml"):
        config = folder / name
        if best is not None or not is_file(config):
            continue
        source = config
        for entry in read_xml(config).findall("sdf"):
            number = version_of(entry)
            if version < number <= NEWEST and (entry.text or "").strip():
                best, version = (entry.text or "").strip(), number
        if best is None:
            return f"{plain_path(config)} names no SDF file of version 1.12 or less; add one"
    path = folder / (best or "model.sdf")
    if best is None and not is_file(path):
        return f"{plain_path(folder)} has no model.config that names its SDF file; add one"
    if not is_file(path):
        return (
            f"{plain_path(source)} names the file {quoted(best or '')}, which does not exist; "
            "generate it, or name another"
        )
    return path


def version_of(element: Element) -> tuple[int, ...]:
    """Return the version of SDF that an element states; (0,) if it is missing or not valid."""
    numbers = element.get("version", "").strip().split(".")
    return tuple(map(int, numbers)) if all(map(str.isdigit, numbers)) else (0,)

"""Metadata that the build computes: the README with links that work on a package index."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_IMAGE = re.compile(r"!\[([^]]*)\]\((?!https?://)([^)]+)\)")
_LINK = re.compile(r"\[([^]]+)\]\((?!https?://|#)([^)]+)\)")


def link_for_index(text: str, repository: str, version: str) -> str:
    """Replace relative links, which a package index cannot resolve.

    Args:
        text: Markdown.
        repository: Address of the repository, or "" if there is none.
        version: Version of the package, and the name of its tag without the `v`.
    Returns:
        The text, with absolute links; without an address, with the text of each link alone and
        without pictures.
    """
    if not repository:
        return _LINK.sub(r"\1", _IMAGE.sub("", text))
    root = repository.rstrip("/")
    text = _IMAGE.sub(rf"![\1]({root}/raw/v{version}/\2)", text)
    return _LINK.sub(rf"[\1]({root}/blob/v{version}/\2)", text)


class ReadmeHook(MetadataHookInterface):
    """Hook of hatchling that sets the field `readme`."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the README from README.md and the address under `[project.urls]`."""
        text = (Path(self.root) / "README.md").read_text("utf-8")
        source = (Path(self.root) / "pinred/common/errors.py").read_text("utf-8")
        (version,) = re.findall(r'^__version__ = "(.+)"$', source, re.MULTILINE)
        repository = metadata.get("urls", {}).get("Repository", "")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": link_for_index(text, repository, version),
        }

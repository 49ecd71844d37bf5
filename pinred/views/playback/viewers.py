"""Names of the viewers that play a motion, and suffixes of the files that contain one."""

from __future__ import annotations

PAGES = (".html", ".rrd")  # suffixes of files that play at any speed, in contrast to films
VIEWERS = {  # {name: description}
    "pinred": "pinred's page",
    "viser": "the page of viser, which the extra viser installs",
}
VIEWER = "pinred"  # the default viewer

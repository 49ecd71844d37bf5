"""The program of the child process that reads mesh files; see `urdf_shapes`.

It is run as a file by an isolated interpreter and imports nothing of pinred, so that it starts
fast.  Its input is one JSON object.  Its output is `READY`, then a record for each mesh: a header
with the numbers of vertices and faces, followed by both arrays.  The record of a mesh that cannot
be read has -1 vertices, the length of a message, and the message.
"""

from __future__ import annotations

import json
import os
import signal
import struct
import sys
from typing import Any, BinaryIO

READY = b"pinred reads meshes\n"
HEADER = struct.Struct("<qq")


def main() -> None:
    """Read the meshes that standard input lists, and write them to standard output."""
    request = json.load(sys.stdin)
    # Libraries may print, so they get standard error instead of the pipe to the parent.
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # end at once, even inside a library
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    _limit("RLIMIT_AS", request["memory"])
    _limit("RLIMIT_CORE", 0)
    sys.path[:] = request["path"]
    import coal

    output.write(READY)
    output.flush()
    # A tree of boxes is the bounding volume that takes the least time to build.
    loader = coal.MeshLoader(coal.NODE_TYPE.BV_AABB)
    for name in request["files"]:
        signal.setitimer(signal.ITIMER_REAL, request["seconds"])
        try:
            _write(output, loader.load(name), request["most"])
        except Exception as error:  # Boost.Python translates C++ exceptions to many types.
            text = (str(error) or type(error).__name__).encode(errors="replace")[:2000]
            output.write(HEADER.pack(-1, len(text)) + text)
        output.flush()


def _limit(name: str, value: int) -> None:
    """Lower a resource limit of this process."""
    import resource  # Windows has no such module

    what = getattr(resource, name)
    hard = resource.getrlimit(what)[1]
    lowest = value if hard == resource.RLIM_INFINITY else min(value, hard)
    resource.setrlimit(what, (lowest, hard))


def _write(output: BinaryIO, shape: Any, most: int) -> None:
    """Write the record of a mesh.  Raises ValueError if it is too large or not finite."""
    import numpy as np

    if shape.num_vertices + shape.num_tris > most:
        raise ValueError(f"it has more than {most} vertices and triangles")
    faces = np.empty((shape.num_tris, 3), dtype="<u4")
    for k, triangle in enumerate(map(shape.tri_indices, range(shape.num_tris))):
        faces[k] = triangle[0], triangle[1], triangle[2]
    vertices = np.asarray(shape.vertices(), dtype="<f8")
    if not np.isfinite(vertices).all():
        raise ValueError("its vertices are not finite")
    output.write(HEADER.pack(len(vertices), len(faces)) + vertices.tobytes() + faces.tobytes())


if __name__ == "__main__":
    main()

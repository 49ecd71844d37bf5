"""A robot file becomes a System: a group of the base times shape coordinates, read exactly.

Loading, the catalogue of robots, what is refused and why; `mjcf` reads what MuJoCo compiles.
Imports `common` and `lie`.
"""

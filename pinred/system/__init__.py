"""Systems from robot files: a symmetry group of the base times shape coordinates.

This subpackage loads files, lists known robots, and rejects models that cannot be reduced.  Its
subpackage `mjcf` reads MJCF through MuJoCo's compiler.  Imports `common` and `lie`.
"""

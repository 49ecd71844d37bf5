"""MJCF files, compiled by MuJoCo and converted to a pin.Model with its further contents.

`mujoco` is imported when a file, an MjModel or an MjSpec is read, never before.
"""

"""MJCF files: compiled by MuJoCo, and converted to a pin.Model and the file's other contents.

`mujoco` is imported when a file, an MjModel or an MjSpec is read, never before.
"""

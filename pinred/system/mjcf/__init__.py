"""MJCF through MuJoCo's own compiler: its numbers become a pin.Model, and what else acts is listed.

`mujoco` is imported when a file, an MjModel or an MjSpec is read, never before.
"""

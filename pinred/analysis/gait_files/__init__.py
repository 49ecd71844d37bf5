"""Gait files: a robot, its connection and a gait in one TOML file."""

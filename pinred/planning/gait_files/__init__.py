"""Gait files: a robot, its connection, a gait and objectives in one TOML file."""

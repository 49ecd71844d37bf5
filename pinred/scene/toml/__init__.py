"""Scene files: their keys, what may stand at each, and errors that name line and key."""

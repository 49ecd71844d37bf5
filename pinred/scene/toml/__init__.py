"""Scene files in TOML: value types, keys, JSON Schema, reader, and errors with line and key."""

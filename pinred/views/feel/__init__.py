"""A page on which joints are moved by hand and the base turns by the connection."""

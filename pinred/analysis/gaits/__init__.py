"""Gaits: closed paths in shape space, as immutable objects."""

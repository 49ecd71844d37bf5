"""Gaits: closed paths in shape space as values."""

"""Benchmarks, the stress suite and the corpus of robot files (the laboratory).

Imports any package except `cli`. Only `cli` imports it, inside functions of its commands.
"""

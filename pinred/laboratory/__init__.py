"""The laboratory: benchmarks, the stress suite and the corpus of robot files.

Imports any package but `cli`. Only `cli` imports it, when one of its commands is called.
"""

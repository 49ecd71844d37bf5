"""Benchmarks, the stress suite, published results and the corpus of robot files (the laboratory).

The laboratory may import any package except `cli`. Only `cli` imports the laboratory, inside the
functions of its commands.
"""

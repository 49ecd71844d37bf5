"""Judgement of results, of files and of speed: the judge by ABA, stress suite, corpus, benches.

Imports `simulation` and what lies below it; the judges take from there what they judge, and
nothing to judge it with.
"""

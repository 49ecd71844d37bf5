"""Judgement of results and of speed: the judge by ABA, the stress suite, the measurements.

Imports `simulation` and what lies below it; the judges take from there what they judge, and
nothing to judge it with.
"""

"""Motions that do what is asked of them: best gaits, and joint motion that turns the base.

Imports `judge` and the packages below it, since each plan can be judged.
"""

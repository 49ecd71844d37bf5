"""Motions that do what is asked of them: best gaits, and joint motion that turns the base.

Imports `verification` and what lies below it, since each plan can be judged.
"""

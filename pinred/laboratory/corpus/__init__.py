"""The corpus: all robot descriptions in some folders are loaded, simulated and validated.

`trial` tries one description: it decides without pinred's readers whether the description should
work, and compares it with MuJoCo's reading. `run_corpus` finds the descriptions, isolates trials in
child processes and builds the table of outcomes.
"""

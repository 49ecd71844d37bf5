"""The corpus: all robot descriptions in some folders are loaded, simulated and validated.

`corpus_entry` finds the descriptions. `trial` tries one description: it decides without pinred's
readers whether the description should work, and `second_reader` compares it with MuJoCo's reading.
`run_corpus` isolates trials in child processes and builds the table of outcomes.
"""

"""The corpus: all robot descriptions in some folders are loaded, simulated and validated.

`corpus_entry` finds the descriptions. `trial` tries one description: it decides without pinred's
readers whether the description should work, and `second_reader` compares it with MuJoCo's reading.
`worker` isolates trials in a child process. `run_corpus` builds the table of outcomes.
"""

"""The corpus: all robot descriptions in some folders are loaded, simulated and validated.

`description_files` finds the descriptions. `scope` decides without pinred's readers which of them
should work. `trial` tries one description, and `second_reader` compares it with MuJoCo's reading.
`worker` isolates trials in a child process. `run_corpus` builds the table of outcomes.
"""

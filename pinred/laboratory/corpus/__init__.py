"""The corpus: every robot description in some folders, loaded, simulated and judged, as a table.

`files` finds the descriptions, `scope` says without pinred's reader which of them should work,
`trial` tries one, with `second_reader` for what MuJoCo reads in it, `worker` keeps each trial
from the others, and `suite` makes the table.
"""

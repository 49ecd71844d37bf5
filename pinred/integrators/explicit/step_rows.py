"""The work rows of a step of an explicit method, see `state_rows` for the first two."""

# The state of a stage, the error rows, and the rates at both ends of a step. The rates of the other
# stages and the dense-output terms follow.
STAGE, ERROR, ERROR3, BEGIN_RATE, END_RATE, RATES = range(2, 8)

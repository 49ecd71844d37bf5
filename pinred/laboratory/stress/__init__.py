"""The stress suite: what pinred does where the numbers are hard.

Each check stands in a file of its own and yields cases, a number and the bound that it has to
keep.  On the other side of each number stand a closed form, Pinocchio's ABA on the full state,
or Pinocchio's energy and momentum; where a frame, a unit or the direction of time must not
matter, the same motion seen otherwise.  `suite` runs them; docs/stress.md says why the bounds.
"""

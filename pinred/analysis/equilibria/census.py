"""Census: the count of equilibria that a search found, and evidence of missing equilibria."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...common.argument_kinds import checks_arguments


@checks_arguments
@dataclass(frozen=True)
class Census:
    """The count of a search for relative equilibria, and the evidence for its completeness.

    Attributes:
        count: Number of distinct equilibria; a family counts once.
        families: Number of families among them.
        starts: Number of starts: random and symmetric ones, and walks from equilibria.
        converged: Number of starts that converged.
        seen_once: Number of equilibria that exactly one random start reached, directly or through
            an image under a symmetry.
        seen_twice: Number of equilibria that exactly two random starts reached.
        not_seen: Number of equilibria that only walks or minimisation reached.
        pending: Number of equilibria from which no walk started, because the limit was reached.
        morse_sum: Sum of (−1)^index over the equilibria in the unreduced shape space; None if an
            index is undefined or the sum does not apply.
        expected: Euler characteristic of that space, which the sum must equal; None if the sum
            does not apply.
        reason: Why the sum does not apply, or "".
    """

    count: int
    families: int
    starts: int
    converged: int
    seen_once: int
    seen_twice: int
    not_seen: int
    pending: int
    morse_sum: int | None
    expected: int | None
    reason: str

    @property
    def agrees(self) -> bool | None:
        """Whether the Morse sum is the expected one; None if it does not apply."""
        if self.morse_sum is None or self.expected is None:
            return None
        return self.morse_sum == self.expected

    @property
    def unseen(self) -> int:
        """Estimated number of missing equilibria, by Chao's estimator from the random starts.

        The estimator is a lower bound on average, and weak: equilibria with small basins do not
        contribute until a start has reached them.
        """
        once, twice = self.seen_once, self.seen_twice
        estimate = once * (once - 1) / (2.0 * (twice + 1.0))
        return max(0, math.ceil(estimate) - self.not_seen)

    @property
    def caveat(self) -> str:
        """The limitations of the search result, in full sentences."""
        if self.agrees is None:
            text = f"The Morse sum does not apply: {self.reason}. Equilibria can be missing."
        elif self.agrees:
            text = "Equilibria whose signs cancel in the sum can be missing."
        else:
            text = "Equilibria are missing, or are counted twice."
        if self.agrees is not None and self.families:
            text += " Families of odd dimension add nothing to the sum."
            text += " It does not show whether one is missing."
        if self.families:
            text += " Families of equal energy, index and dimension count as one."
        if self.pending:
            text += (
                f" The search stopped at its limit, before walks from {self.pending} equilibria: "
                "raise `limit`."
            )
        return text

    def __str__(self) -> str:
        seen = f"{self.seen_once} seen once, {self.seen_twice} twice"
        seen += f", estimated unseen {self.unseen} (Chao's estimator, a weak lower bound)"
        if self.agrees is None:
            return f"{seen}\n{self.caveat}"
        verb = "agrees with" if self.agrees else "differs from"
        text = f"Morse sum {self.morse_sum} {verb} the Euler characteristic {self.expected}"
        return f"{text}; {seen}\n{self.caveat}"

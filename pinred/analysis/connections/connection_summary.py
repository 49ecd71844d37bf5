"""The text and the notebook card of a connection."""

from __future__ import annotations

from ...common.html import Rows, Summary
from ...kernels.connection.connection_form import ConnectionForm
from .rotation_chart import RotationChart

_NAMES = 6  # largest number of joints that are named


class ConnectionSummary(Summary):
    """Base class of Connection that describes it by its form; nothing is compiled for this."""

    form: ConnectionForm
    turned_by_gravity: str
    chart: RotationChart | None

    def title(self) -> str:
        """Return the first line of the text."""
        return f"Connection({self.form.what}, {self.form.group.name}, m={self.form.m})"

    def rows(self) -> Rows:
        """Return the rows of the text: spaces, metric, and whether gravity changes momenta."""
        form = self.form
        names = [*form.joints[:_NAMES], *(["…"] if form.m > _NAMES else [])]
        joints = f": {', '.join(names)}" if names else ""
        rows = [
            ("group", f"{form.group.name}, r = {form.r}"),
            ("shape space", f"m = {form.m}{joints}"),
            ("metric", "on shape space" if form.symmetric else "none"),
        ]
        if self.turned_by_gravity:
            rows.append(("momenta", f"not conserved: {self.turned_by_gravity}"))
        if self.chart is not None:
            rows.append(("coordinates", self.chart.words))
        return rows

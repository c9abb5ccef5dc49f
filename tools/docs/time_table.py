"""Page of where the time goes, from the budget."""

from __future__ import annotations

from budget import LARGEST, read_budget
from reference_tables import table


def time_table() -> str:
    """Tabulate each figure's budget, and its earlier ones with the reasons for the change."""
    rows = [
        (name, f"{entry.value:g} {entry.unit}", entry.date, entry.because)
        for name, entries in read_budget().items()
        for entry in reversed(entries)
    ]
    headings = ("figure", "budget", "since", "because")
    return f"A change fails beyond {LARGEST:g} of the newest row of each figure.\n\n{table(headings, rows)}"

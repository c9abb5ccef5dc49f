"""Page of where the time goes, from the budget."""

from __future__ import annotations

import tomllib

from reference_tables import ROOT, table

BUDGET = ROOT / "tools" / "budget" / "budget.toml"


def time_table() -> str:
    """Tabulate each figure's budget, newest first, with the reason for each change."""
    budget = tomllib.loads(BUDGET.read_text(encoding="utf-8"))
    rows = [
        (name, f"{entry['value']:g} {entry['unit']}", entry["date"], entry["because"])
        for name, entries in budget.items()
        for entry in reversed(entries)
    ]
    return table(("figure", "budget", "since", "because"), rows)

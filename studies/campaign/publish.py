"""Writes the results of a study: tables as Markdown, CSV and JSON, and plots."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from ronna_hw.records import write_whole
from studies.campaign.code import code
from studies.campaign.table import Table

RESULTS, REPORT = "results.json", "report.md"


def publish(
    folder: Path,
    title: str,
    settings: Mapping[str, object],
    tables: Sequence[Table],
    plots: Mapping[str, bytes],
) -> Path:
    """Write everything into `folder`; returns the path of the report."""
    document = {
        "study": title,
        "settings": dict(settings),
        "code": code(),
        "tables": [table.document() for table in tables],
        "plots": sorted(plots),
    }
    write_whole(folder / RESULTS, json.dumps(document, indent=1, allow_nan=False).encode())
    for table in tables:
        write_whole(folder / f"{_file_name(table.title)}.csv", table.csv().encode())
    for name, png in plots.items():
        write_whole(folder / name, png)
    pictures = "".join(f"![{name}]({name})\n\n" for name in sorted(plots))
    listed = ", ".join(f"{key} {json.dumps(value)}" for key, value in settings.items())
    text = (
        f"# {title}\n\n{listed}; code {code()}\n\n"
        + "\n".join(table.markdown() for table in tables)
        + f"\n{pictures}"
    )
    write_whole(folder / REPORT, text.encode())
    return folder / REPORT


def _file_name(title: str) -> str:
    return "-".join("".join(c if c.isalnum() else " " for c in title.lower()).split())

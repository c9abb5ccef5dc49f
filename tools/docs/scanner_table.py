"""What faults of a scanner cost, from the figures that `benchmarks/scans/scanner_faults.py` wrote."""

from __future__ import annotations

import tomllib
from math import nan

from data_files import REFERENCE
from page_tables import table


def scanner_faults() -> str:
    """The table; a fault that refuses every scan has no figures."""
    rows = tomllib.loads((REFERENCE / "scanner-faults.toml").read_text(encoding="utf-8"))["fault"]
    return table(
        (
            "fault",
            "option",
            "error, µm (largest)",
            "after a rigid fit, µm",
            "chi² / 3n",
            "missed / false",
            "told",
        ),
        [
            (
                row["fault"],
                f"`{row['options']}`" if row["options"] else "",
                f"{row['error_um']:g} ({row['largest_um']:g})" if "error_um" in row else "",
                f"{row['fitted_um']:g}" if row.get("fitted_um", nan) > 0.0 else "",
                f"{row['chi2']:g}" if "chi2" in row else "",
                f"{row['missed']} / {row['false']} of {row['markers']}" if "missed" in row else "refused",
                row["told"],
            )
            for row in rows
        ],
    )

"""Cost of scanner faults, from the figures that `benchmarks/scans/scanner_faults.py` wrote."""

from __future__ import annotations

import tomllib
from math import nan
from typing import Any

from data_files import REFERENCE
from page_tables import table


def scanner_faults() -> str:
    """Word the quiet limits and tabulate the faults; one that refuses every scan has no figures."""
    data = tomllib.loads((REFERENCE / "scanner-faults.toml").read_text(encoding="utf-8"))
    quiet, rows = data["quiet"], data["fault"]
    without = (
        f"In {quiet['volumes']} scans of every family, protocol and kernel, half of them with overlap, "
        f"but without motion, tilt and error of the table, the largest values are "
        f"{quiet['across_mm']:g} mm sideways, "
        f"{quiet['share']:.0%} explained by a shift, and a change that correlates by "
        f"-{quiet['backwards']:g} with those around it (a warning needs 0.4 mm and 10 %, or -0.7), "
        f"{quiet['scale_percent']:g} % of scale, {quiet['shear_percent']:g} % of shear. "
        f"Told: {quiet['told'] or 'nothing'}."
    )
    return f"{without}\n\n" + table(
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
                _outcome(row),
                row["told"],
            )
            for row in rows
        ],
    )


def _outcome(row: dict[str, Any]) -> str:
    if "missed" not in row:
        return "refused"
    some = f"; {row['refused']} of {row['volumes']} scans refused" if row["refused"] else ""
    return f"{row['missed']} / {row['false']} of {row['markers']}{some}"

"""CSV tables of an export, and beside each the schema with which Slicer reads its columns as numbers.

Slicer reads `NAME.schema.csv` beside `NAME.csv`: the type of each column, and the value of an empty cell,
which would otherwise be 0.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from procedures.exchange.allowed_fields import TABLES

NOT_KNOWN = "nan"  # of an empty cell in a column of numbers
LPS, MILLIMETRE = "LPS", "mm"
IN_CT, CT_FROM_ROBOT, ROBOT_FROM_CT = "ct", "ct <- robot", "robot <- ct"
CT_FROM_LATER_CT = "ct <- later ct"


@dataclass(frozen=True)
class CtIdentity:
    """DICOM UIDs of the CT in whose coordinates an export is given; `study` is empty if not known."""

    series: str
    frame_of_reference: str
    study: str = ""

    def describe(self, direction: str) -> dict[str, str]:
        """Return the fields that say in which frame and unit a file is given."""
        return {
            "series_instance_uid": self.series,
            "frame_of_reference_uid": self.frame_of_reference,
            "study_instance_uid": self.study,
            "coordinate_system": LPS,
            "direction": direction,
            "unit": MILLIMETRE,
        }


def format_table(name: str, rows: Iterable[Mapping[str, object]]) -> str:
    """Format the rows of an exported table; a value that is missing or None leaves its cell empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [one.name for one in TABLES[name]], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def format_schema(name: str) -> str:
    """Format Slicer's schema of an exported table."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("columnName", "type", "nullValue", "unitLabel", "description"))
    for one in TABLES[name]:
        null = NOT_KNOWN if one.kind == "double" else ""
        writer.writerow((one.name, one.kind, null, one.unit, one.meaning))
    return text.getvalue()

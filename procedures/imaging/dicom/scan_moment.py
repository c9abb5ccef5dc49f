"""Moment at which a series was acquired, as far as its headers say, compared only by what both know.

An image may be made anew from old readings, so the times of acquisition come before those of content, series
and study. A time without an offset from UTC is that of the scanner's clock.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.imaging.dicom.attributes import read_attribute_text
from procedures.imaging.dicom.slice_headers import iterate_images, parse_date

if TYPE_CHECKING:
    from pydicom.dataset import FileDataset

KINDS = ("Acquisition", "Content", "Series", "Study")  # the nearest to the scan first
MOMENT, OFFSET = "AcquisitionDateTime", "TimezoneOffsetFromUTC"
DATED = tuple(f"{kind}Date" for kind in KINDS)
TAGS = (MOMENT, OFFSET, *DATED, *(f"{kind}Time" for kind in KINDS))
DATE_LETTERS = 8  # of a date at the beginning of a date-time
# Hours and minutes, perhaps seconds and their fraction; colons before the year 1993, and perhaps an offset.
_TIME = re.compile(r"(\d\d):?(\d\d)(?::?(\d\d)(?:\.\d+)?)?([+-]\d{4})?")
_OFFSET = re.compile(r"([+-])(\d\d)(\d\d)")


@dataclass(frozen=True)
class ScanMoment:
    """Date of a scan, and its local time and the offset from UTC if known."""

    local: datetime  # midnight without a time
    has_time: bool = False
    offset: timezone | None = None

    def is_before(self, other: ScanMoment) -> bool:
        """Whether this moment is known to be the earlier one."""
        if not (self.has_time and other.has_time):
            return self.local.date() < other.local.date()
        if self.offset is None or other.offset is None:
            return self.local < other.local
        return self.local.replace(tzinfo=self.offset) < other.local.replace(tzinfo=other.offset)

    def describe(self) -> str:
        """Return date and time in words, such as "20180602 14:00:00"."""
        if not self.has_time:
            return f"{self.local:%Y%m%d} at an unknown time"
        offset = "" if self.offset is None else f" {self.offset}"
        return f"{self.local:%Y%m%d %H:%M:%S}{offset}"


def read_moments(directory: Path) -> tuple[ScanMoment, ...]:
    """Return the moments of the slices of a folder that have a readable date, earliest local time first.

    Raises CT-001, CT-005, CT-012.
    """
    found = {_parse_moment(path, header) for path, header in iterate_images(directory, TAGS)}
    return tuple(sorted((one for one in found if one is not None), key=lambda one: one.local))


def read_stated_date(directory: Path) -> str:
    """Return the first date in a folder verbatim, readable or not; empty without any."""
    for path, header in iterate_images(directory, TAGS):
        if stated := next(filter(None, _texts(path, header, (MOMENT, *DATED))), ""):
            return stated
    return ""


def _texts(path: Path, header: FileDataset, tags: tuple[str, ...]) -> Iterator[str]:
    return (read_attribute_text(path, header, tag) for tag in tags)


def _parse_moment(path: Path, header: FileDataset) -> ScanMoment | None:
    whole = read_attribute_text(path, header, MOMENT)
    stated = [(whole[:DATE_LETTERS], whole[DATE_LETTERS:])]
    for kind in KINDS:
        day_text, time_text = _texts(path, header, (f"{kind}Date", f"{kind}Time"))
        stated.append((day_text, time_text))
    dated = [(day, time) for text, time in stated if (day := parse_date(text)) is not None]
    if not dated:
        return None
    day = dated[0][0]
    times = (_TIME.fullmatch(time.strip()) for other, time in dated if other == day)
    found = next((moment for match in times if match and (moment := _at(day, match)) is not None), None)
    if found is None:
        return ScanMoment(datetime(day.year, day.month, day.day))
    if found.offset is not None:
        return found
    return ScanMoment(found.local, True, _parse_offset(read_attribute_text(path, header, OFFSET)))


def _at(day: date, match: re.Match[str]) -> ScanMoment | None:
    hours, minutes, seconds, offset = match.groups()
    try:
        local = datetime(day.year, day.month, day.day, int(hours), int(minutes), int(seconds or 0))
    except ValueError:
        return None
    return ScanMoment(local, True, _parse_offset(offset or ""))


def _parse_offset(text: str) -> timezone | None:
    if (match := _OFFSET.fullmatch(text.strip())) is None:
        return None
    sign, hours, minutes = match.groups()
    size = timedelta(hours=int(hours), minutes=int(minutes))
    try:
        return timezone(-size if sign == "-" else size) if size else UTC
    except ValueError:  # a day or more
        return None

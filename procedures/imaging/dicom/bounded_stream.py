"""The bytes of one DICOM file with read limits, since a damaged file can cause endless reads."""

from __future__ import annotations

import io

from ronna_hw.bounded_input import InputRefused

MOST_READS = 50_000  # two to four per element; a slice has hundreds, with private sequences thousands
LONGEST_VALUE = 65_536  # of an attribute other than pixels; none in use exceeds a hundred bytes
DEFLATED = b"1.2.840.10008.1.2.1.99"  # everything after the meta header is deflated (PS3.5 A.5)
EXPLICIT = b"1.2.840.10008.1.2.1".ljust(len(DEFLATED), b"\0")  # the equivalent syntax once inflated


class DataSetDeflated(Exception):
    """The rest of the file is deflated, starting at `begin`."""

    def __init__(self, begin: int) -> None:
        self.begin = begin


class BoundedStream(io.BytesIO):
    """Raises INP-001 for too many reads or too long a value, DataSetDeflated when reading all the rest."""

    def __init__(self, content: bytes, longest_value: int) -> None:
        super().__init__(content)
        self._left = MOST_READS
        self._longest = longest_value

    def read(self, size: int | None = -1, /) -> bytes:
        """Like any stream's; only a deflated data set is read to the end at once."""
        if size is None or size < 0:
            raise DataSetDeflated(self.tell())
        self._left -= 1
        if self._left < 0:
            raise InputRefused("too many elements", limit=f"{MOST_READS} reads")
        if size > self._longest:
            raise InputRefused("a value is too long", limit=f"{self._longest} bytes", got=f"{size}")
        return super().read(size)

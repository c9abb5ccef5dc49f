"""Deflated data and ZIP files, unpacked only up to a limit."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib

from ronna_hw.bounded_input.refusal import InputRefused

LARGEST_ZIP_BYTES = 2_000_000  # its table of contents is read entirely
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # only these can be unpacked incrementally


def inflate(packed: bytes, limit_bytes: int, *, raw: bool = False) -> bytes:
    """Unpack the zlib format, or raw deflate with `raw`. Raises INP-001, also for damaged data."""
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS if raw else zlib.MAX_WBITS)
    try:
        content = unpacker.decompress(packed, limit_bytes + 1)
    except zlib.error as error:
        raise InputRefused(f"deflated data are damaged: {error}") from error
    if len(content) > limit_bytes:
        raise InputRefused("deflated data expand beyond the limit", limit=f"{limit_bytes} bytes")
    if not unpacker.eof:
        raise InputRefused("deflated data are truncated")
    return content


def unzip(packed: bytes, limit_bytes: int) -> bytes:
    """The first member of a ZIP file, stored or deflated. Raises INP-001, also for a damaged file."""
    if len(packed) > LARGEST_ZIP_BYTES:
        raise InputRefused("a ZIP file is too large", limit=f"{LARGEST_ZIP_BYTES} bytes")
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            member = archive.infolist()[0]
            if member.compress_type not in _METHODS:
                raise InputRefused("unsupported ZIP compression method", expected="stored or deflated")
            with archive.open(member) as file:
                content = file.read(limit_bytes + 1)
    except InputRefused:
        raise
    except (
        zipfile.BadZipFile, zlib.error, struct.error, ValueError, IndexError, OSError, EOFError,
        RuntimeError,  # it wants a password, or a feature that is missing here
        OverflowError,  # a 64-bit offset
    ) as error:  # fmt: skip
        raise InputRefused(f"a ZIP file cannot be read: {error}") from error
    if len(content) > limit_bytes:
        raise InputRefused("a packed file expands beyond the limit", limit=f"{limit_bytes} bytes")
    return content

"""Logs of a run as they are on disk, sealed or cut: their records, and a repaired copy of one.

Sizes are bounded: a log may have come from elsewhere. Reading ends where a log ends or is damaged.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from procedures.live.errors import EMPTY_LOG, FOREIGN_LOG
from procedures.live.log_writer import SOFTWARE
from ronna_hw.host.files import open_regular
from ronna_hw.records import PARTIAL

if TYPE_CHECKING:
    from mcap.records import McapRecord

MAGIC = b"\x89MCAP0\r\n"
LARGEST_RECORD_BYTES = 256_000_000  # also of an unpacked chunk, of which ours have a second each
NS_PER_S = 1e9


def read_log(path: Path) -> Iterator[McapRecord]:
    """Yield the records of a log in order, those of chunks too, up to its end or the first damaged one.

    Raises LIV-003 for a file that is no MCAP, and OSError.
    """
    import zstandard
    from mcap.exceptions import McapError
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    with open_regular(path, follow_links=True) as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise FOREIGN_LOG(f"{path.name} does not begin as an MCAP file does")
        reader = StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=LARGEST_RECORD_BYTES)
        try:
            for record in reader.records:
                if not isinstance(record, Chunk):
                    yield record
                elif record.uncompressed_size > LARGEST_RECORD_BYTES:
                    return
                else:
                    yield from breakup_chunk(record, validate_crc=True)
        except (McapError, ValueError, struct.error, zstandard.ZstdError):  # cut, or damaged from here on
            return


class RecoveredLog(NamedTuple):
    """Copy of a log with index and sums, and what is in it."""

    path: Path
    messages: int
    duration_s: float
    was_whole: bool


def recover_log(source: Path, out: Path) -> RecoveredLog:
    """Write a sealed copy of a log, as far as that can be read; the log itself stays as it is.

    Raises LIV-003 for a file that is no MCAP, LIV-004 for one without a message, and OSError.
    """
    part = out.with_name(f".{out.name}{PARTIAL}")
    try:
        recovered = _copy(source, part)
        os.replace(part, out)
    finally:
        part.unlink(missing_ok=True)
    return recovered._replace(path=out)


def _copy(source: Path, part: Path) -> RecoveredLog:
    from mcap.records import Attachment, Channel, Footer, Header, Message, Metadata, Schema
    from mcap.writer import Writer

    schemas, channels = {0: 0}, dict[int, int]()
    stamps_ns, was_whole = list[int](), False
    with part.open("xb") as file:
        writer = Writer(file, enable_data_crcs=True)
        is_started = False
        for record in read_log(source):
            if not is_started:
                writer.start(record.profile if isinstance(record, Header) else "", SOFTWARE)
                is_started = True
            match record:
                case Schema() if record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case Channel() if record.id not in channels:
                    channels[record.id] = writer.register_channel(
                        record.topic,
                        record.message_encoding,
                        schemas.get(record.schema_id, 0),
                        record.metadata,
                    )
                case Message() if record.channel_id in channels:
                    channel = channels[record.channel_id]
                    writer.add_message(
                        channel, record.log_time, record.data, record.publish_time, record.sequence
                    )
                    stamps_ns.append(record.log_time)
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Attachment():
                    writer.add_attachment(
                        record.create_time, record.log_time, record.name, record.media_type, record.data
                    )
                case Footer():
                    was_whole = True
                case _:
                    pass
        if not stamps_ns:
            raise EMPTY_LOG(f"{source.name} holds no message")
        writer.finish()  # type: ignore[no-untyped-call]  # of the library
        os.fsync(file.fileno())
    return RecoveredLog(part, len(stamps_ns), (max(stamps_ns) - min(stamps_ns)) / NS_PER_S, was_whole)

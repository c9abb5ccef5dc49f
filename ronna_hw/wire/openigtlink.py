"""Framing of OpenIGTLink: headers of version 1 and 2, metadata, check sums, a bounded reader of a stream.

Header, big-endian: version, type, device name, seconds and 2^-32 fractions since 1970 (UTC), size and CRC-64
of the body. The body of version 2 begins with an extended header and ends with metadata; peers of protocol 2
read such a body as garbage. The contents of the types are in `openigtlink_contents`. Lengths are in mm.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from ronna_hw.wire.crc64 import crc64

PORT: Final = 18944
LONGEST_NAME_BYTES: Final = 20  # of a device
LONGEST_TYPE_BYTES: Final = 12
LARGEST_BODY_BYTES: Final = 1 << 20  # that a reader takes, unless it is told otherwise
VERSIONS: Final = (1, 2)  # of the header; protocols 1 and 2 send the first, protocol 3 also the second
ASCII: Final = 3  # IANA's numbers of character sets
UTF_8: Final = 106

_HEADER: Final = struct.Struct(">H12s20sIIQQ")
_EXTENDED: Final = struct.Struct(
    ">HHII"
)  # own size, size of the metadata's header, of the metadata, message id
_COUNT: Final = struct.Struct(">H")
_ENTRY: Final = struct.Struct(">HHI")  # size of the key, encoding of the value, size of the value
_SECOND_NS: Final = 1_000_000_000
HEADER_BYTES: Final = _HEADER.size


class StreamBroken(ValueError):
    """The bytes are no OpenIGTLink stream, or exceed its bounds: the next message cannot be found."""


class Malformed(ValueError):
    """The content of a message does not have the layout of its type."""


class Message(NamedTuple):
    """Message as received. With a fault it has no content, and nothing in it may be used."""

    version: int
    kind: str  # the type, TRANSFORM for example
    name: str  # of the device
    stamp_ns: int  # since 1970, UTC; 0 where the sender gives none
    content: bytes
    metadata: Mapping[str, str]
    message_id: int = 0
    fault: str = ""

    @property
    def stamp_s(self) -> float:
        """Return the time stamp in seconds since 1970."""
        return self.stamp_ns / _SECOND_NS


def encode_message(
    kind: str,
    name: str,
    content: bytes = b"",
    stamp_ns: int = 0,
    *,
    version: int = 1,
    metadata: Mapping[str, str] | None = None,
    message_id: int = 0,
) -> bytes:
    """Encode a message; version 1 has no room for metadata and leaves them out.

    Raises ValueError for a type or a name that does not fit.
    """
    body = content if version == 1 else _extend(content, metadata or {}, message_id)
    seconds, rest = divmod(stamp_ns, _SECOND_NS)
    return (
        _HEADER.pack(
            version,
            encode_text(kind, LONGEST_TYPE_BYTES),
            encode_text(name, LONGEST_NAME_BYTES),
            seconds,
            (rest << 32) // _SECOND_NS,
            len(body),
            crc64(body),
        )
        + body
    )


def encode_text(text: str, longest_bytes: int) -> bytes:
    """Encode ASCII text for a field of fixed size. Raises ValueError if it does not fit."""
    if not text.isascii() or len(text) > longest_bytes:
        raise ValueError(f"{text!r} does not fit into {longest_bytes} bytes of ASCII")
    return text.encode()


def decode_text(field: bytes) -> str:
    """Decode a field of fixed size that is padded with zeros."""
    return field.partition(b"\0")[0].decode("ascii", "replace")


def _extend(content: bytes, metadata: Mapping[str, str], message_id: int) -> bytes:
    entries, texts = [_COUNT.pack(len(metadata))], []
    for key, value in metadata.items():
        key_bytes, value_bytes = key.encode(), value.encode()
        entries.append(_ENTRY.pack(len(key_bytes), ASCII if value.isascii() else UTF_8, len(value_bytes)))
        texts += [key_bytes, value_bytes]
    sizes = (_COUNT.size + _ENTRY.size * len(metadata), sum(map(len, texts)))
    return b"".join((_EXTENDED.pack(_EXTENDED.size, *sizes, message_id), content, *entries, *texts))


class MessageReader:
    """Cuts a stream into messages. Keeps at most one body of the largest size, and what arrived with it."""

    def __init__(self, largest_body_bytes: int = LARGEST_BODY_BYTES) -> None:
        """Set the size of the largest body; a larger one breaks the stream."""
        self._largest = largest_body_bytes
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Take bytes and return the messages that are complete by now.

        A wrong check sum or a damaged extension is a fault of its message, and the stream goes on. Raises
        StreamBroken for a version that does not exist, or a body over the limit. Take all messages before
        more bytes.
        """
        self._buffer += data
        begin = 0
        try:
            while len(self._buffer) - begin >= HEADER_BYTES:
                header = _HEADER.unpack_from(self._buffer, begin)
                self._check(*header)
                end = begin + HEADER_BYTES + header[5]
                if len(self._buffer) < end:
                    break
                body = bytes(memoryview(self._buffer)[begin + HEADER_BYTES : end])
                begin = end
                yield _read(header, body)
        finally:
            del self._buffer[:begin]

    def _check(
        self, version: int, kind: bytes, _name: bytes, _s: int, _fraction: int, size: int, _crc: int
    ) -> None:
        if version not in VERSIONS:
            raise StreamBroken(f"no OpenIGTLink header: version {version}, expected 1 or 2")
        if size > self._largest:
            shown = decode_text(kind)
            raise StreamBroken(f"a body of {size} bytes ({shown!r}); at most {self._largest} are taken")


def _read(header: tuple[int, bytes, bytes, int, int, int, int], body: bytes) -> Message:
    version, kind, name, seconds, fraction, _size, crc = header
    stamp_ns = seconds * _SECOND_NS + ((fraction * _SECOND_NS + (1 << 31)) >> 32)
    message = Message(version, decode_text(kind), decode_text(name), stamp_ns, b"", {})
    if crc64(body) != crc:
        return message._replace(fault="wrong check sum")
    if version == 1:
        return message._replace(content=body)
    try:
        content, metadata, message_id = _unextend(body)
    except (struct.error, ValueError) as error:
        return message._replace(fault=f"damaged extended header or metadata: {error}")
    return message._replace(content=content, metadata=metadata, message_id=message_id)


def _unextend(body: bytes) -> tuple[bytes, dict[str, str], int]:
    """Split a body of version 2 into content, metadata and message id. Raises ValueError or struct.error."""
    own, entries_size, texts_size, message_id = _EXTENDED.unpack_from(body)
    entries_at = len(body) - texts_size - entries_size
    if not _EXTENDED.size <= own <= entries_at:
        raise ValueError("sizes that exceed the body")
    metadata: dict[str, str] = {}
    if entries_size:
        (count,) = _COUNT.unpack_from(body, entries_at)
        if entries_size != _COUNT.size + _ENTRY.size * count:
            raise ValueError(f"{count} entries of metadata in {entries_size} bytes")
        at = entries_at + entries_size
        for number in range(count):
            key, _, value = _ENTRY.unpack_from(body, entries_at + _COUNT.size + _ENTRY.size * number)
            middle, end = at + key, at + key + value
            if end > len(body):
                raise ValueError("metadata that exceed the body")
            metadata[body[at:middle].decode("utf-8", "replace")] = body[middle:end].decode("utf-8", "replace")
            at = end
    return body[own:entries_at], metadata, message_id

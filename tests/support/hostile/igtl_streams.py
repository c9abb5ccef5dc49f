"""Streams of OpenIGTLink messages, spoilt: half of them keep a right check sum, so that contents are read."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Iterator

import numpy as np
from mutations import mutations

from ronna_hw.wire.crc64 import crc64
from ronna_hw.wire.openigtlink import HEADER_BYTES, Malformed, MessageReader, StreamBroken, encode_message
from ronna_hw.wire.openigtlink_contents import (
    TRACKING_6D,
    Command,
    Status,
    Subscription,
    TrackedTool,
    decode_command,
    decode_quaternion_tracking,
    decode_status,
    decode_string,
    decode_subscription,
    decode_tracking,
    decode_transform,
    encode_command,
    encode_quaternion_tracking,
    encode_status,
    encode_string,
    encode_subscription,
    encode_tracking,
    encode_transform,
)

DECODERS: dict[str, Callable[[bytes], object]] = {
    "TRANSFORM": decode_transform,
    "TDATA": decode_tracking,
    "QTDATA": decode_quaternion_tracking,
    "STATUS": decode_status,
    "STRING": decode_string,
    "COMMAND": decode_command,
    "STT_TDATA": decode_subscription,
}
POSE = np.array([[0.0, -1.0, 0.0, 10.0], [1.0, 0.0, 0.0, 20.0], [0.0, 0.0, 1.0, 30.0], [0.0, 0.0, 0.0, 1.0]])
TOOL = TrackedTool("Pointer", TRACKING_6D, POSE)
CONTENTS = {
    "TRANSFORM": encode_transform(POSE),
    "TDATA": encode_tracking([TOOL, TOOL]),
    "QTDATA": encode_quaternion_tracking([TOOL]),
    "STATUS": encode_status(Status(1, "all is well")),
    "STRING": encode_string("<b>µ</b>"),
    "COMMAND": encode_command(Command(7, "Move", "<Command/>")),
    "STT_TDATA": encode_subscription(Subscription(20, "Ras")),
}
SEEDS = tuple(
    encode_message(
        kind, "Device", content, 1_700_000_000_123_456_789, version=version, metadata={"k": "wert"}
    )
    for kind, content in CONTENTS.items()
    for version in (1, 2)
)


def spoilt_streams(count: int, seed: int) -> Iterator[bytes]:
    """Yield `count` streams, the same for a seed."""
    chosen = random.Random(seed)
    for stream in mutations(SEEDS, count, seed):
        body = stream[HEADER_BYTES:]
        if chosen.random() < 0.5 and len(stream) >= HEADER_BYTES:
            size = chosen.choice((len(body), len(body), len(body) + 1, 0, 2**63))
            stream = b"".join((stream[:42], size.to_bytes(8, "big"), crc64(body).to_bytes(8, "big"), body))
        yield stream + chosen.choice(SEEDS)


def read_all(stream: bytes, largest_body_bytes: int) -> int:
    """Read a stream as a peer does; return how many messages were usable. Another exception is a failure."""
    usable = 0
    with contextlib.suppress(StreamBroken):
        for message in MessageReader(largest_body_bytes).feed(stream):
            if message.fault or message.kind not in DECODERS:
                continue
            with contextlib.suppress(Malformed):
                DECODERS[message.kind](message.content)
                usable += 1
    return usable

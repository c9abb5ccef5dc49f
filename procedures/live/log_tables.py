"""Topics of a run's log as tables, in millimetres and radians."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from procedures.live.errors import NO_LOG
from procedures.live.flight_log import log_files
from procedures.live.log_reading import read_log
from procedures.live.log_topics import M_PER_MM, PLAN, SPHERES
from procedures.live.log_writer import EPOCH, METADATA
from ronna_hw.arguments import WrongArgument
from ronna_hw.loaded_run import RunColumn, RunTable
from ronna_hw.near_names import did_you_mean
from ronna_hw.wire import ros2
from ronna_hw.wire.ros2 import CdrReader

Values = tuple[object, ...]
TIME = RunColumn("time_s", float, "theatre time of the measurement or change")
UTC = RunColumn("utc_ns", "i8", "the same as UTC since 1970")
POSITION = RunColumn("position_mm", float, "origin of the frame in its parent", (3,))
ROTATION = RunColumn("rotation_wxyz", float, "its rotation, scalar first", (4,))
PARENT, CHILD = RunColumn("parent", str, "frame it is in"), RunColumn("child", str, "frame")
JOINTS = "joints_rad"  # as many as the arm has


class Decoded(NamedTuple):
    """Columns of a type of message, besides its times, and what reads the rows of one."""

    columns: tuple[RunColumn, ...]
    rows: Callable[[CdrReader], Iterator[Values]]


def _joints(reader: CdrReader) -> Iterator[Values]:
    reader.header()
    for _ in range(reader.number("I")):
        reader.text()
    yield (reader.doubles(),)


def _pose(reader: CdrReader) -> Iterator[Values]:
    parent = reader.header()
    yield (parent, *_millimetres(reader))


def _transforms(reader: CdrReader) -> Iterator[Values]:
    for _ in range(reader.number("I")):
        parent, child = reader.header(), reader.text()
        yield (parent, child, *_millimetres(reader))


def _millimetres(reader: CdrReader) -> Values:
    position_m, rotation = reader.pose()
    return tuple(value / M_PER_MM for value in position_m), rotation


def _picture(reader: CdrReader) -> Iterator[Values]:
    reader.header()
    reader.text()
    yield (reader.blob(),)


def _said(reader: CdrReader) -> Iterator[Values]:
    reader.number("i")
    reader.number("I")
    level = reader.number("B")
    reader.text()
    yield (level, reader.text())


def _text(reader: CdrReader) -> Iterator[Values]:
    yield (reader.text(),)


DECODED = {
    ros2.JOINTS: Decoded((RunColumn(JOINTS, float, "from the base outwards"),), _joints),
    ros2.POSE: Decoded((PARENT, POSITION, ROTATION), _pose),
    ros2.TF: Decoded((PARENT, CHILD, POSITION, ROTATION), _transforms),
    ros2.IMAGE: Decoded((RunColumn("jpeg", object, "picture as a JPEG file"),), _picture),
    ros2.LOG: Decoded(
        (RunColumn("level", int, "20 said, 30 warned, 40 failed"), RunColumn("text", str, "line")), _said
    ),
    ros2.TEXT: Decoded((RunColumn("text", str, "JSON"),), _text),
}


def read_topic(run: Path, topic: str) -> RunTable:
    """Return all messages of a topic as a table, over all programs that had the run.

    Raises LIV-005 for a run without a log, ARG-001 for a topic that is not in it, LIV-003 and OSError.
    """
    if not (files := log_files(run)):
        raise NO_LOG(f"{run.name} has no log")
    topics, tables = set[str](), list[tuple[str, list[Values]]]()
    for file in files:
        topics_there, message, rows = _read_file(file, topic)
        topics |= topics_there
        if message is not None:
            tables.append((message, rows))
    if not tables and topic in (SPHERES, PLAN):
        raise WrongArgument(
            f"the topic {topic} has markers for viewers, and no table",
            expected=f"one of {', '.join(sorted(topics))}",
            action="run.spheres and run.plan have them; or read the file with mcap or rosbags.",
        )
    if not tables:
        raise WrongArgument(
            f"the log of {run.name} has no topic {topic}",
            expected=f"one of {', '.join(sorted(topics)) or 'none, for it is empty'}",
            action=did_you_mean(topic, topics) or "Name one of these.",
        )
    message = tables[0][0]
    rows = [row for other, rows in tables if other == message for row in rows]
    columns = DECODED[message].columns
    if message == ros2.JOINTS:
        axes = len(rows[0][-1]) if rows else 0  # type: ignore[arg-type]  # a tuple
        columns = tuple(replace(one, size=(axes,)) for one in columns)
    return RunTable.of((TIME, UTC, *columns), rows)


def _read_file(file: Path, topic: str) -> tuple[set[str], str | None, list[Values]]:
    """Return the topics of a log that have tables, and the type and rows of one of them."""
    from mcap.records import Channel, Message, Metadata, Schema

    schemas, channels, epoch_ns = dict[int, str](), dict[int, Channel](), 0
    rows: list[Values] = []
    for record in read_log(file):
        match record:
            case Metadata(name=name) if name == METADATA:
                epoch_ns = int(record.metadata.get(EPOCH, 0))
            case Schema():
                schemas[record.id] = record.name
            case Channel() if schemas.get(record.schema_id) in DECODED:
                channels[record.id] = record
            case Message() if (channel := channels.get(record.channel_id)) and channel.topic == topic:
                times = (record.log_time - epoch_ns) / ros2.NS, record.log_time
                decoded = DECODED[schemas[channel.schema_id]]
                with suppress(ValueError, struct.error):  # a message of another form
                    rows += [(*times, *row) for row in decoded.rows(CdrReader(record.data))]
            case _:
                pass
    named = {one.topic: schemas[one.schema_id] for one in channels.values()}
    return set(named), named.get(topic), rows

"""Writer of one log file: MCAP with the profile of ROS 2, in chunks that a flush completes."""

from __future__ import annotations

from collections.abc import Callable
from typing import BinaryIO

from procedures.live.log_entries import LogEntry
from procedures.live.log_topics import LogMessages, Topic
from procedures.live.records import Began
from ronna_hw.wire import ros2

PROFILE, ENCODING, SCHEMA_ENCODING = "ros2", "cdr", "ros2msg"
SOFTWARE = "ronna-hw"  # that wrote it, as the first record says
METADATA = "ronna"  # name of the record with the run and the time at which its theatre time is 0
EPOCH = "epoch_ns"


class LogWriter:
    """Writer of entries. Raises OSError, and ValueError for an entry that has no form as a message."""

    def __init__(self, file: BinaryIO, began: Began, without_names: Callable[[str], str]) -> None:
        """Write the beginning of a log; `without_names` replaces names that may identify the patient."""
        from mcap.writer import Writer  # a tenth of a second, which only a log needs

        self._messages = LogMessages(began, without_names)
        self._writer = Writer(file, enable_data_crcs=True)
        self._writer.start(PROFILE, SOFTWARE)
        self._writer.add_metadata(METADATA, {"run": began.run, EPOCH: str(began.epoch_ns)})
        self._channels: dict[Topic, int] = {}
        self._schemas: dict[str, int] = {}
        self.written = 0  # messages
        self.flush()

    def write(self, entry: LogEntry, host_ns: int) -> None:
        """Write the messages of an entry that was taken at this UTC time of the host."""
        for topic, stamp_ns, data in self._messages.of(entry):
            self._writer.add_message(self._channel(topic), stamp_ns, data, host_ns)
            self.written += 1

    def flush(self) -> None:
        """Complete the chunk and hand it to the system: what is in it survives this program."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # of the library

    def finish(self) -> None:
        """Write index, statistics and sums."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # of the library

    def _channel(self, topic: Topic) -> int:
        if topic not in self._channels:
            if topic.message not in self._schemas:
                definition = ros2.definition_of(topic.message).encode()
                schema = self._writer.register_schema(topic.message, SCHEMA_ENCODING, definition)
                self._schemas[topic.message] = schema
            schema = self._schemas[topic.message]
            self._channels[topic] = self._writer.register_channel(topic.name, ENCODING, schema)
        return self._channels[topic]

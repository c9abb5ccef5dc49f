"""mcap, the reader of the format's own project."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress

from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from our_log import COUNTS, killed_log, sealed_log


def reads_every_message() -> None:
    with sealed_log().open("rb") as file:
        found = Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())
    assert found == COUNTS


def finds_index_and_check_sums_right() -> None:
    with sealed_log().open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(list(reader.iter_messages())) == sum(COUNTS.values())


def reads_a_log_whose_program_was_killed() -> None:
    found: Counter[str] = Counter()
    with killed_log().open("rb") as file, suppress(EndOfFile):  # where it was cut
        for _, channel, _ in NonSeekingReader(file).iter_messages(log_time_order=False):
            found[channel.topic] += 1
    assert found == COUNTS

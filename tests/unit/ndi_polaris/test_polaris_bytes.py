"""What passes on the tracker's line, as the unit has it at its end."""

from recorded_bytes import RecordedBytes

from ronna_hw.devices.byte_sink import RecordsBytes


def test_all_bytes_of_the_line_are_handed_over_with_changes_of_rate(make_tracker) -> None:
    tracker, sink = make_tracker(), RecordedBytes()
    assert isinstance(tracker, RecordsBytes)
    tracker.record_bytes(sink)
    with tracker.active():
        tracker.read_frame()
    tracker.close()
    assert b"TSTART:" in sink.sent("tracker")
    assert sink.received("tracker").count(b"OKAYA896\r") > 3
    assert sink.notes[-1][0] == "tracker"
    assert "baud" in sink.notes[-1][1]

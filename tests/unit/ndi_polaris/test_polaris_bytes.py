"""The bytes on the tracker's line are recorded as the unit sends and receives them."""

from recorded_bytes import RecordedBytes

from ronna_hw.devices.capabilities import RecordsBytes


def test_all_bytes_on_the_line_and_changes_of_rate_are_recorded(make_tracker) -> None:
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

"""A server's time stamps are placed in theatre time by the least delayed of them."""

from __future__ import annotations

import pytest

from drivers.openigtlink_tracker.measurements import CLOCK_WINDOW_S, StampClock

SECOND_NS = 1_000_000_000
NOW_NS = 1_700_000_000 * SECOND_NS


def test_a_late_message_is_placed_where_its_stamp_says() -> None:
    clock = StampClock()
    assert clock.place(NOW_NS, 10.0) == pytest.approx(10.0)
    assert clock.place(NOW_NS + SECOND_NS, 11.4) == pytest.approx(11.0)
    assert clock.place(NOW_NS + 2 * SECOND_NS, 11.9) == pytest.approx(11.9)  # the first was late as well
    assert clock.place(NOW_NS + 3 * SECOND_NS, 12.9) == pytest.approx(12.9)


def test_a_quick_message_is_forgotten_after_a_minute() -> None:
    clock = StampClock()
    clock.place(NOW_NS, 0.0)
    later_s = CLOCK_WINDOW_S + 1.0
    assert clock.place(NOW_NS + round(later_s * SECOND_NS), later_s + 0.3) == pytest.approx(later_s + 0.3)

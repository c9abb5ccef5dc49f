"""Rows of a reading in the monitor: every tool, stray, axis and side, with units in the heads."""

from __future__ import annotations

import math

import numpy as np

from procedures.cli.monitor import tabulate_reading
from ronna_hw.arm.universal_robots.inverse import AXIS_NAMES
from ronna_hw.devices.readings import (
    ArmReading,
    Stamp,
    StereoReading,
    StrayReading,
    ToolReading,
    TrackerFrame,
    Validity,
)

STAMP = Stamp(1, 1, 0.0)


def test_a_frame_has_a_row_for_each_tool_and_stray_and_a_hidden_tool_has_no_place() -> None:
    hidden = ToolReading("guide_frame", Validity.MISSING, None, None, None)
    stray = StrayReading((1.0, 2.0, -1500.0), Validity.OK)
    rows = tabulate_reading(TrackerFrame(STAMP, Validity.OK, (hidden,), (stray,)))
    assert [row["what"] for row in rows] == ["guide_frame", "stray 1"]
    assert [row["z_mm"] for row in rows] == [None, -1500.0]
    assert rows[0]["validity"] == "missing"


def test_an_empty_frame_says_that_nothing_is_in_view() -> None:
    (row,) = tabulate_reading(TrackerFrame(STAMP, Validity.OK, (), ()))
    assert row["what"] == "nothing in view"


def test_an_arm_has_a_row_for_each_axis_in_degrees_and_its_force_if_it_senses_one() -> None:
    joints_rad = (math.pi / 2,) * 6
    reading = ArmReading(STAMP, Validity.OK, joints_rad, None, False, (3.0, 4.0, 0.0))
    rows = tabulate_reading(reading, AXIS_NAMES)
    assert [row["what"] for row in rows] == [*AXIS_NAMES, "force on the tool"]
    assert rows[0]["measured_deg"] == 90.0
    assert rows[0]["commanded_deg"] is None
    assert rows[-1]["force_N"] == 5.0


def test_a_side_without_a_picture_is_shown_as_such() -> None:
    rows = tabulate_reading(StereoReading(STAMP, Validity.MISSING, None, None))
    assert [(row["what"], row["mean_grey"]) for row in rows] == [("left", None), ("right", None)]
    assert not any(isinstance(value, np.generic) for row in rows for value in row.values())

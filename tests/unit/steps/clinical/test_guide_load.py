"""The load on an arm as the workcell hands it to the estimate: fresh signals of a known model, or nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest

from procedures.steps.clinical.guide_load import as_standstill
from ronna_hw.arm.load_model import KR6, UR5E, LoadModel
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.readings import Stamp, Validity

HOME_RAD = (0.0, -1.5, -1.5, -1.5, 1.5, -1.5)
LOADS = AxisLoads(Stamp(7, 70, 0.7), Validity.OK, HOME_RAD, 100)
KUKA = replace(LOADS, current_percent=(1.0, -30.0, 12.0, 0.0, -4.0, 0.0))
UR = replace(
    LOADS,
    current_A=(1.0, 2.0, 3.0, 0.0, 0.0, 0.0),
    expected_current_A=(1.5, 2.0, 2.0, 0.0, 0.0, 0.0),
    force_N=(1.0, 2.0, 3.0),
)


def test_currents_are_as_stated_or_less_what_the_controller_expects() -> None:
    kuka, ur = as_standstill(KUKA, KR6, "guide"), as_standstill(UR, UR5E, "guide")
    assert kuka is not None
    assert ur is not None
    assert (kuka.signal, kuka.force_N, kuka.cycles) == (KUKA.current_percent, None, 100)
    assert ur.signal == pytest.approx((-0.5, 0.0, 1.0, 0.0, 0.0, 0.0))
    assert (ur.force_N, ur.joints_rad, ur.tool) == ((1.0, 2.0, 3.0), HOME_RAD, "guide")


@pytest.mark.parametrize(
    ("loads", "model"),
    [
        (None, KR6),
        (replace(KUKA, validity=Validity.MISSING), KR6),
        (replace(KUKA, validity=Validity.STALE), KR6),
        (LOADS, KR6),
        (replace(UR, expected_current_A=None), UR5E),
        (KUKA, None),
    ],
)
def test_without_fresh_signals_or_assumptions_there_is_no_estimate(
    loads: AxisLoads | None, model: LoadModel | None
) -> None:
    assert as_standstill(loads, model, "guide") is None

"""The pass over all axes at once finds what the rules one by one find, next to every limit."""

from __future__ import annotations

from itertools import pairwise
from math import inf, nan, nextafter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ronna_hw.wire.kuka_context import AxisCorrection, AxisMonitor
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.drives import Supervision
from sim.kuka.rsi.signal_flow import AxisCorrector
from sim.world.nominal_arm import AXES, description

ARM = description("kr6_r900_sixx")
NO_NUMBERS = (-0.0, nan, inf, -inf)
NUDGES = st.sampled_from([-inf, 0.0, inf])


def nudged(value: float, towards: float) -> float:
    """Neighbouring doubles of a number, and the number itself."""
    return nextafter(value, towards) if towards else value


@settings(max_examples=150)
@given(data=st.data(), step_share=st.sampled_from([0.25, 1.0, 2.0]), window_s=st.sampled_from([0.012, 0.04]))
def test_the_supervision_stops_the_drives_exactly_by_its_rules(
    data: st.DataObject, step_share: float, window_s: float
) -> None:
    parameters = ControllerParameters(step_share=step_share, acceleration_window_s=window_s)
    fast, exact = (Supervision(ARM, 0.004, parameters) for _ in range(2))
    exact._usual_step_deg = [-1.0] * AXES  # no step is usual: the rules judge each
    axis = data.draw(st.integers(0, AXES - 1))
    joint, bend = ARM.joints[axis], fast._bend_deg[axis]
    full = joint.full_speed_deg_s * 0.004
    start = data.draw(st.sampled_from([0.0, joint.lower_deg, joint.upper_deg]))
    past, commands = [start] * (2 * fast._window), [[0.0] * axis + [start] + [0.0] * (AXES - 1 - axis)]
    for _ in range(data.draw(st.integers(1, 12))):
        last, middle, oldest = past[-1], past[-fast._window], past[-2 * fast._window]
        away = data.draw(st.sampled_from([1.0, -1.0]))
        limits = [
            *(last + away * step for step in (fast._step_deg[axis], full, full / 8)),
            *(middle + middle - oldest + away * by for by in (bend, 0.0)),
            *(fast._lower_deg[axis], fast._upper_deg[axis], last, start),
        ]
        angle = nudged(data.draw(st.sampled_from([*limits, *NO_NUMBERS])), data.draw(NUDGES))
        past.append(angle)
        commands.append([angle if number == axis else 0.0 for number in range(AXES)])
    for before, command in pairwise(commands):
        has_reply = data.draw(st.booleans())
        sent = before if not has_reply else command  # a held value is the same object
        said = [one.judge(sent, before, has_reply=has_reply) for one in (fast, exact)]
        assert said[0] == said[1]
        assert (fast._hard_cycles, fast._fast_cycles) == (exact._hard_cycles, exact._fast_cycles)


@pytest.mark.parametrize("relative", [False, True])
@settings(max_examples=100)
@given(data=st.data(), largest_deg=st.sampled_from([4.0, 5.0, 6.0]), within_deg=st.sampled_from([None, 1.0]))
def test_axis_corrections_are_clamped_and_monitored_as_beside_an_axis_that_is_not_a_number(
    relative: bool, data: st.DataObject, largest_deg: float, within_deg: float | None
) -> None:
    limits = AxisCorrection(), AxisMonitor(max_deg=(largest_deg,) * AXES)
    fast, exact = (AxisCorrector(ARM, [0.0] * AXES, *limits, relative=relative) for _ in range(2))
    ends = [sign * end for sign in (1.0, -1.0) for end in (0.0, 1.0, 4.0, 5.0, 6.0)]
    near = st.builds(nudged, st.sampled_from([*ends, *NO_NUMBERS]), NUDGES)
    for _ in range(2):
        five = data.draw(st.tuples(*[near] * (AXES - 1)))
        said = [fast.apply([*five, 0.0]), exact.apply([*five, nan])]  # by A6 the rules judge each
        assert said[0] == said[1]
        assert repr(fast.totals_deg[:-1]) == repr(exact.totals_deg[:-1])
        assert fast.stat == exact.stat
        assert fast.narrow(within_deg) == exact.narrow(within_deg)

"""Ways of both arms along an axis: what was announced, how each ended, and how the arm came home."""

from __future__ import annotations

from procedures.journal.journal import Entry, JournalValue, Line
from procedures.reporting.arm_ways import list_arm_ways

OUT = (
    "first: the instrument moves 192 mm\nclosest: instrument clears fiducial 3 by 14 mm\nspeed: up to 40 mm/s"
)


def line(entry: Entry, time_s: float, **more: JournalValue) -> Line:
    return {"entry": entry.value, "theatre_time_s": time_s, **more}


def motion(time_s: float, number: int, what: str, arm: str = "assistant") -> Line:
    axis = {"travel_mm": 191.75} if what in ("insert", "withdraw") else None
    return line(
        Entry.MOTION, time_s, arm=arm, number=number, what=what, to=[0.0] * 3, trajectory="T1", axis=axis
    )


def moved(time_s: float, number: int, arm: str = "assistant", **more: JournalValue) -> Line:
    return line(Entry.MOVED, time_s, arm=arm, number=number, **{"at_home": False, **more})


def test_a_way_out_has_its_announced_clearance_and_the_way_home_with_its_stops() -> None:
    (way,) = list_arm_ways(
        [
            line(Entry.CONFIRMATION, 1.0, topic="retreat:T1", value=OUT, answer="yes"),
            motion(2.0, 1, "withdraw"),
            moved(9.5, 1),
            motion(9.5, 2, "home"),
            moved(10.0, 2, error="ARM-007"),
            motion(10.0, 3, "back"),
            moved(14.0, 3, at_home=True),
        ]
    )
    assert (way.trajectory, way.name, way.travel_mm, way.lasted_s) == ("T1", "instrument out", 191.75, 7.5)
    assert way.clearance == "instrument clears fiducial 3 by 14 mm"
    assert way.home_s == 14.0
    assert way.ending == "home after 2 motions, ARM-007 on the way: back as it came"


def test_ways_of_both_arms_are_told_apart_and_each_question_belongs_to_the_next_way() -> None:
    ways = list_arm_ways(
        [
            line(Entry.CONFIRMATION, 0.0, topic="approach:T1", value="closest: end of the guide by 15 mm"),
            motion(1.0, 1, "insert", "master"),
            moved(2.0, 1, "master"),
            motion(3.0, 1, "insert"),
            moved(4.0, 1, error="UR-010"),
            motion(5.0, 2, "withdraw"),
        ]
    )
    assert [one.name for one in ways] == ["guide in", "instrument in", "instrument out"]
    assert [one.clearance for one in ways] == ["end of the guide by 15 mm", "", ""]
    assert [one.ending for one in ways] == ["arrived", "stopped: UR-010", "not ended"]


def test_a_case_without_motions_along_an_axis_has_no_ways() -> None:
    assert list_arm_ways([line(Entry.OPENED, 0.0), motion(1.0, 1, "home"), moved(2.0, 1)]) == ()

import pytest

from sim.errors import BadFaultScript
from sim.theatre.built_in import built_in_scene
from sim.theatre.faults import FaultBoard, parse_faults
from sim.theatre.world import World


def test_a_script_is_read_line_by_line_with_comments() -> None:
    faults = parse_faults(
        "# a bad day\nat 12.5 s: tracker occlude marker 3 for 2 s\n\n"
        "when step == relocalization:T1: robot drop 5 % for 1 s  # burst\n"
    )
    assert [(f.device, f.kind, f.argument, f.duration_s) for f in faults] == [
        ("tracker", "occlude_marker", "3", 2.0),
        ("robot", "drop", "5", 1.0),
    ]
    assert (faults[0].at_s, faults[1].step) == (12.5, "relocalization:T1")


@pytest.mark.parametrize(
    "line", ["at 3 s tracker occlude marker 1 for 2 s", "at 3 s: tea for 2 s", "at 3 s:"]
)
def test_a_line_that_is_no_fault_is_refused_with_its_place(line: str) -> None:
    with pytest.raises(BadFaultScript, match="line 2"):
        parse_faults("# first\n" + line)


def test_a_fault_acts_from_its_onset_for_its_duration() -> None:
    world = World.create(built_in_scene("mini"), paced=False)
    board = FaultBoard(world, "tracker")
    world.set_fault_script("at 1 s: tracker occlude marker 2 for 0.5 s")
    seen = []
    for _ in range(4):
        seen.append(board.active("occlude_marker"))
        world.clock.sleep(0.5)
    assert seen == [(), (), ("2",), ()]


def test_a_fault_of_a_step_begins_with_the_step_and_concerns_its_device_only() -> None:
    world = World.create(built_in_scene("mini"), paced=False)
    world.set_fault_script("when step == relocalization: robot drop 5 % for 1 s")
    robot, tracker = FaultBoard(world, "robot"), FaultBoard(world, "tracker")
    assert robot.active("drop") == ()
    world.clock.sleep(3.0)
    world.enter_step("relocalization:T1")
    assert robot.active("drop") == ("5",)
    assert tracker.active("drop") == ()
    world.clock.sleep(1.0)
    assert robot.active("drop") == ()

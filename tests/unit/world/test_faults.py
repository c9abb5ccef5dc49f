import re
from pathlib import Path

import pytest

from ronna_hw.arm.catalogue import ArmChoice
from sim.errors import BadFaultScript
from sim.world.faults import (
    FAULT_KINDS,
    FaultBoard,
    begin_now,
    begin_with_step,
    check_faults,
    language,
    parse_faults,
    parse_request,
    read_faults,
)
from sim.world.faults.fault import TERMINALS, FaultKind
from sim.world.faults.plain_lines import read_plain_line
from sim.world.options import ArmRole
from sim.world.scene.assistant import add_assistant
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World


@pytest.fixture
def world() -> World:
    return World.create(draw_scene("mini"), paced=False)


def arguments(board: FaultBoard, kind: str) -> tuple[str, ...]:
    return tuple(fault.argument for fault in board.active(kind))


def test_a_script_is_read_line_by_line_with_comments() -> None:
    faults = parse_faults(
        "# a bad day\nat 12.5 s: tracker occlude marker 3 for 2 s\n\n"
        "when step == relocalization:T1: robot drop 5 % for 1 s  # burst\n"
    )
    assert [(f.kind.device, f.kind.name, f.argument, f.duration_s) for f in faults] == [
        ("tracker", "occlude_marker", "3", 2.0),
        ("robot", "drop", "5", 1.0),
    ]
    assert (faults[0].at_s, faults[1].step) == (12.5, "relocalization:T1")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "at 3 s robot drop 5 %",
            "line 2, column 8: expected ':', got 'robot'. Write for example: at 12.5 s: ",
        ),
        (
            "at 3 s: tea for 2 s",
            "line 2, column 9: expected 'assistant', 'camera', .*, got 'tea'. Write for example: at 12.5 s: ",
        ),
        (
            "at 3 s:",
            "line 2, column 8: expected 'assistant', 'camera', .*, got the end of the line",
        ),
        (
            "at 3 s: robot dorp 5 %",
            "line 2, column 15: expected a fault of the robot, got 'dorp 5 %': it has no such fault. "
            "Did you mean: at 3 s: robot drop 5 %",
        ),
        (
            "when step == relocalization:T1: robot dorp 5 % for 1 s",
            "line 2, .* Did you mean: when step == relocalization:T1: robot drop 5 % for 1 s",
        ),
        (
            "since step == relocalization: robot dorp 5 % for 1 s",
            "line 2, .* Did you mean: since step == relocalization: robot drop 5 % for 1 s",
        ),
        ("at 3 s: robot", "line 2, column 14: expected a fault of the robot, got the end of the line. "),
        (
            "at 3 s: assistant robot local mode for 1 s",
            "line 2, column 25: expected a fault of the robot, got 'local mode': it has no such fault. "
            "Write for example: at 12.5 s: assistant robot ",
        ),
        ("at 3 s: assistant ur cable puled", "line 2, .* mean: at 3 s: assistant ur cable pulled"),
        ("at 3 s: camera bump", "line 2, .* Did you mean: at 3 s: tracker bump"),
        # A number in another unit is not that number of the right one.
        (
            "at 3 s: camera hand 5 cm",
            r"line 2, .*expected 'mm', got 'cm'\. (?!.*Did you mean).*Write for example: ",
        ),
        # A direction takes three numbers, and the example keeps the line's own words.
        (
            "at 3 s: room shift head 2 mm for 4 s",
            "line 2, column 27: expected three numbers, for x, y and z, got one before 'mm'. "
            "Write for example: at 3 s: room shift head 2 0 0 mm for 4 s. ",
        ),
        (
            "at 3 s: room loosen marker 2 1.5 -1",
            "line 2, column 36: expected three numbers, for x, y and z, got two before the end of the line. "
            "Write for example: at 3 s: room loosen marker 2 1.5 -1 0 mm. ",
        ),
        ("at 3 s: room loosen marker 2 mm", "line 2, column 30: expected a number, got 'mm'. "),
        (
            "since step == positioning:T1 after 5: room shift head 0 2 0 mm",
            "line 2, column 37: expected 's', got ':'. "
            "Did you mean: since step == positioning:T1 after 5 s: room shift head 0 2 0 mm",
        ),
        (
            "at 3: robot drop 5 % for 2",
            "line 2, column 5: expected 's', got ':'. Did you mean: at 3 s: robot drop 5 % for 2 s",
        ),
        (
            "at 3 s: room slip head 2 mm",
            "line 2, column 14: .* it has no such fault; its nearest word is slipping_head. "
            "Write for example: at 3 s: room shift slipping_head 2 0 0 mm. ",
        ),
        (
            "at 3 s: room slip head",
            "line 2, column 14: .* Write for example: at 12.5 s: room shift slipping_head -1.5 ",
        ),
        ("at 3 s: room loosen screw 1", "line 2, .* expected 'marker', got 'screw'. Write for example: "),
        (
            "robot drop 5 %",
            "line 2, column 1: expected 'at', 'when' or 'since', to say when the fault begins, got 'robot'. "
            "Did you mean: at 12.5 s: robot drop 5 %",
        ),
    ],
)
def test_a_wrong_line_is_refused_with_its_position_the_expectation_and_a_suggestion(
    line: str, said: str
) -> None:
    with pytest.raises(BadFaultScript, match=f"SIM-003: {said}"):
        parse_faults("# first\n" + line)


def test_a_fault_acts_from_its_onset_for_its_duration(world: World) -> None:
    board = FaultBoard(world, "tracker")
    world.set_fault_script("at 1 s: tracker occlude marker 2 for 0.5 s")
    seen = []
    for _ in range(4):
        seen.append(arguments(board, "occlude_marker"))
        world.clock.sleep(0.5)
    assert seen == [(), (), ("2",), ()]


def test_a_fault_tied_to_a_step_begins_with_it_and_affects_only_its_device(world: World) -> None:
    world.set_fault_script("when step == relocalization: robot drop 5 % for 1 s")
    robot, tracker = FaultBoard(world, "robot"), FaultBoard(world, "tracker")
    assert robot.active("drop") == ()
    world.clock.sleep(3.0)
    world.enter_step("relocalization:T1")
    assert arguments(robot, "drop") == ("5",)
    assert tracker.active("drop") == ()
    world.clock.sleep(1.0)
    assert robot.active("drop") == ()


def test_every_wrong_line_is_reported() -> None:
    script = "at 1 s: tea for 2 s\nat 2 s: robot drop 5 % for 1 s\nat 3 s robot drop 5 % for 1 s\nnow: tea"
    with pytest.raises(BadFaultScript, match=r"SIM-003: line 1, .*; line 3, .*; line 4, ") as caught:
        parse_faults(script)
    assert "line 2" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("at 3 s: robot drop 500 % for 1 s", "expected at most 100 %, got 500"),
        ("at 1e400 s: tracker cold", "expected at most 100000 s, got inf"),
        ("at 3 s: tracker cold for 1e12 s", "expected at most 100000 s, got 1e[+]12"),
        (f"at 3 s: room shift head {'9' * 400} 0 0 mm", "expected at most 2000 mm, got inf"),
        ("at 3 s: room shift head 0 -1000000 0 mm", "expected at most 2000 mm, got -1e[+]06"),
        ("at 3 s: room bad seat 1 mm 100000 deg", "expected at most 180 deg, got 100000"),
        ("at 3 s: room unlocked cart 0 0 9000 mm per min", "expected at most 2000 mm per min, got 9000"),
        ("at 3 s: robot delay 5000 cycles", "expected at most 1000 cycles, got 5000"),
        ("at 3 s: room shift head 1 0 0 mm over 0 s", "expected a time longer than 0 s"),
    ],
)
def test_a_fault_outside_the_scene_or_beyond_its_unit_is_refused(line: str, said: str) -> None:
    with pytest.raises(BadFaultScript, match=f"SIM-003: line 2: {said}"):
        check_faults(parse_faults("\n" + line), draw_scene("mini"))


@pytest.mark.parametrize("kind", FAULT_KINDS, ids=lambda kind: kind.name)
def test_every_number_of_a_fault_has_a_bound(kind: FaultKind) -> None:
    arguments = [word for word in kind.phrase.split() if word in TERMINALS]
    for place, word in enumerate(arguments):
        assert word == "NAME" or place in kind.units or (word == "INT" and kind.checks), kind.usage


def test_the_effect_of_a_fault_is_described_with_its_time_and_meaning() -> None:
    (fault,) = parse_faults("at 3 s: robot drop 5 % for 2 s")
    assert fault.effect == (
        "robot drop 5 %, from theatre time 3.000 s on, for 2 s. That share of the RSI replies never arrives."
    )
    assert parse_request("when step == set_up: tracker bump").effect.startswith(
        "tracker bump, whenever step set_up begins, once. "
    )
    assert parse_request("when step == registration: room loosen marker 2 1 0 0 mm").effect.startswith(
        "room loosen marker 2 1 0 0 mm, whenever step registration begins, until that step ends. "
    )


@pytest.mark.parametrize("step", ["tea", "relocalization:left-STN"])
def test_a_step_of_any_name_is_accepted(step: str) -> None:
    check_faults(parse_faults(f"when step == {step}: robot drop 5 % for 1 s"), draw_scene("mini"))


def test_a_script_that_fits_the_scene_is_accepted_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "faults.txt"
    path.write_text(
        "at 0 s: tracker occlude marker 3 for 1 s\nat 1 s: tracker occlude tool robot_frame for 1 s\n"
        "when step == at_target:T1: camera drop 100 % for 1 s\n"
    )
    assert read_faults(path, draw_scene("mini")) == path.read_text()


def test_a_script_that_is_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "faults.txt"
    path.write_bytes(b"at 0 s: \xff\xfe")
    with pytest.raises(BadFaultScript, match=r"SIM-003: faults.txt is not UTF-8 text"):
        read_faults(path, draw_scene("mini"))
    with pytest.raises(BadFaultScript, match="cannot read"):
        read_faults(tmp_path, draw_scene("mini"))


def test_a_fault_without_a_duration_lasts_to_the_end(world: World) -> None:
    world.set_fault_script("now: robot drop 5 %")
    world.clock.sleep(1e6)
    assert arguments(FaultBoard(world, "robot"), "drop") == ("5",)


def test_now_is_replaced_by_the_time_of_the_request() -> None:
    assert begin_now("now: robot drop 5 % for 1 s", 12.5) == "at 12.500000000 s: robot drop 5 % for 1 s"
    assert begin_now("at 1 s: robot drop 5 %", 12.5) == "at 1 s: robot drop 5 %"


def test_a_fault_that_begins_now_acts_while_the_clock_is_stopped(world: World) -> None:
    world.clock.sleep(1 / 60)  # as after a frame of the tracker: no whole microsecond
    world.set_fault_script(begin_now("robot drop 5 %", world.clock.now_s()))
    assert arguments(FaultBoard(world, "robot"), "drop") == ("5",)


def test_a_fault_requested_again_after_clearing_happens_again_with_a_stopped_clock(
    world: World,
) -> None:
    board = FaultBoard(world, "robot")
    happened = []
    for script in ("at 0 s: robot collision", "", "at 0 s: robot collision", "at 0 s: robot drives off"):
        world.set_fault_script(script)
        happened.append(len(board.happened("collision")) + len(board.happened("drives_off")))
    assert happened == [1, 0, 1, 1]


def test_the_example_of_every_fault_kind_is_valid() -> None:
    alone = draw_scene("mini")
    both = add_assistant(alone)
    for kind in FAULT_KINDS:
        (fault,) = parse_faults(kind.example)
        check_faults((fault,), both if kind.device == "room" else alone, (kind.device,))
        assert fault.kind is kind
        assert kind.meaning.endswith(".")
    assert len({kind.name for kind in FAULT_KINDS}) == len(FAULT_KINDS)


def test_a_fault_since_a_step_may_begin_some_time_after_it() -> None:
    script = "since step == positioning:T1 after 1.5 s: room turn head 0 0 1 deg"
    (fault,) = parse_faults(script)
    assert (fault.lasts, fault.step, fault.after_s) == (True, "positioning:T1", 1.5)
    assert begin_with_step(script, "tool_check", 10.0) == script
    assert begin_with_step(script, "positioning:T1", 10.0) == "at 11.500000000 s: room turn head 0 0 1 deg"
    assert "1.5 s after step positioning:T1 begins" in fault.effect


def test_a_fault_of_the_assistant_acts_on_no_other_arm() -> None:
    world = World.create(add_assistant(draw_scene("mini")), paced=False)
    world.set_fault_script("at 0 s: assistant robot network cut")
    assert FaultBoard(world, "robot").empty
    own = FaultBoard(World.open(world.endpoint, ArmRole.ASSISTANT), "robot")
    assert [fault.phrase for fault in own.acting()] == ["assistant robot network cut"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("now: assistant robot network cut", "there is no assistant here"),
        ("now: assistant room shift head 1 0 0 mm", "only an arm can be the assistant"),
    ],
)
def test_a_fault_of_an_assistant_that_is_not_there_is_refused(line: str, said: str) -> None:
    with pytest.raises(BadFaultScript, match=said):
        check_faults(parse_faults(line), draw_scene("mini"))


@pytest.mark.parametrize(
    ("arm", "assistant_arm", "line", "said", "role"),
    [
        (
            ArmChoice.UR5E,
            ArmChoice.KR6,
            "now: assistant ur local mode",
            "expected a fault of the robot, got 'assistant ur local mode': "
            "the assistant here is made by KUKA, its faults begin with 'assistant robot'. ",
            "assistant ",
        ),
        (
            ArmChoice.UR5E,
            ArmChoice.KR6,
            "now: robot emergency stop",
            "expected a fault of the ur, got 'robot emergency stop': "
            "the master here is made by Universal Robots, its faults begin with 'ur'. ",
            "",
        ),
    ],
)
def test_a_fault_of_the_other_make_is_answered_with_a_fault_that_this_arm_can_have(
    arm: ArmChoice, assistant_arm: ArmChoice, line: str, said: str, role: str
) -> None:
    scene = add_assistant(draw_scene("mini", arm=arm), assistant_arm)
    with pytest.raises(BadFaultScript, match=re.escape(said)) as caught:
        check_faults(parse_faults(line), scene)
    example = str(caught.value).partition("Write for example: ")[2].partition(". `")[0]
    assert example.startswith(f"at 12.5 s: {role}")
    check_faults(parse_faults(example), scene)


@pytest.mark.parametrize(
    "beginning", ["at 12.5 s: ", "at cycle 40: ", "now: ", "now: assistant ", "at cycle 40: assistant "]
)
def test_a_plain_line_reads_as_by_the_grammar(monkeypatch: pytest.MonkeyPatch, beginning: str) -> None:
    endings = {True: ("",), False: ("", " for 2 s", " for 0.25 s")}
    lines = [
        beginning + kind.example.partition(": ")[2].partition(" for ")[0] + ending
        for kind in FAULT_KINDS
        for ending in endings[kind.momentary]
    ]
    plain = [read_plain_line(line, number, FAULT_KINDS) for number, line in enumerate(lines, 1)]
    monkeypatch.setattr(language, "read_plain_line", lambda *_: None)
    assert None not in plain
    assert tuple(plain) == parse_faults("\n".join(lines))


@pytest.mark.parametrize(
    "line",
    [
        "",
        "# nothing",
        "now: assistant",
        "now: ur protective stop for 1 s",
        "at 1 s: ur lose five %",
        "robot drop 5 %",
    ],
)
def test_other_lines_are_left_to_the_grammar(line: str) -> None:
    assert read_plain_line(line, 1, FAULT_KINDS) is None

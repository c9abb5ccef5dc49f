"""Rules for the motions of several arms: one at a time, never too close, and what stops one stops all."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from math import radians

import pytest
from coded_errors import raises
from ideal_arm import Controller, IdealArm

from procedures.workcell.arms import Arms
from procedures.workcell.errors import INSTRUMENT_IN_GUIDE, BothArmsHalted, OtherArmUnknown
from ronna_hw.arm.clearance.bodies import Capsule, Part, Surroundings
from ronna_hw.arm.errors import ForceLimitExceeded, NotClear
from ronna_hw.arm.pose import Pose
from ronna_hw.clock import Clock, HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.contact import Inserted, Insertion
from ronna_hw.devices.errors import PersonNotNamed
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.devices.readings import ArmReading, Validity
from ronna_hw.devices.robot import JointMove, RobotArm, StopKind
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.vectors import JointVector, Vector3, joint_vector, vector3

HOST = DeviceConfig(driver="ideal", endpoint="host:")
ACROSS = Pose.from_kuka(-1300.0, 0.0, 0.0, 180.0, 0.0, 0.0)  # face to face: both arms reach to the middle
CLOCK = HostClock()


class WatchedArm(IdealArm):
    """An ideal arm whose last state is always new, unless it is frozen."""

    def __init__(self, name: str, joints_rad: JointVector, clock: Clock = CLOCK) -> None:
        super().__init__(name, HOST, clock)
        self.controller = Controller(joints_rad)
        self.frozen: ArmReading | None = None
        self.stopped_by: RonnaError | None = None  # a fault whose cause shows only once it is asked for
        self.on_step: Callable[[], None] = lambda: None

    def observe(self) -> LastKnown[ArmReading]:
        self.on_step()
        joints_rad = self.controller.joints_rad
        now = ArmReading(self._stamp(), Validity.OK, joints_rad, joints_rad, self._under_way.locked())
        return self.guard.last_known(self.frozen or now, stopped=self.stopped_by is not None)

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        if self.stopped_by is None:
            super().stop(kind, timeout_s)
        else:
            self.guard.latch(self.stopped_by)


def turned(arm: WatchedArm, base_deg: float) -> JointMove:
    first, *others = arm.controller.joints_rad
    return JointMove((first + radians(base_deg), *others))


HOME_RAD = IdealArm.kinematics.home_rad
STRETCHED_RAD = (0.0, radians(-20.0), radians(20.0), radians(-90.0), radians(-90.0), 0.0)


@pytest.fixture
def master() -> Iterator[WatchedArm]:
    arm = WatchedArm("robot.master", HOME_RAD)
    started(arm)
    yield arm
    arm.close()


@pytest.fixture
def assistant() -> Iterator[WatchedArm]:
    arm = WatchedArm("robot.assistant", HOME_RAD)
    started(arm)
    yield arm
    arm.close()


def started(arm: WatchedArm) -> None:
    arm.connect()
    arm.configure()
    arm.activate()


def across(
    arms: Mapping[str, RobotArm], clock: Clock, instrument_inside: Callable[[], str | None] = lambda: None
) -> Arms:
    """Return two arms that face each other, both bases known."""
    pair = Arms(arms, (MASTER, ASSISTANT), clock, instrument_inside)
    pair.place(ASSISTANT, ACROSS)
    return pair


@pytest.fixture
def pair(master: WatchedArm, assistant: WatchedArm) -> Arms:
    return across({MASTER: master, ASSISTANT: assistant}, CLOCK)


def test_an_arm_alone_moves_in_the_thread_that_asks_and_its_own_errors_pass_through(
    master: WatchedArm,
) -> None:
    alone, movers = Arms({MASTER: master}, (MASTER,), CLOCK), set[int]()
    master.on_step = lambda: movers.add(threading.get_ident())
    alone.move(MASTER, turned(master, 5.0))
    assert movers <= {threading.get_ident()}
    master.on_step = lambda: None
    master.stop(StopKind.PROTECTIVE)
    with pytest.raises(RonnaError) as refused:
        alone.move(MASTER, JointMove(HOME_RAD))
    assert not isinstance(refused.value, BothArmsHalted)
    alone.halt_for_fault()
    assert alone.halted is None


def test_no_arm_moves_before_the_bases_of_all_are_known(master: WatchedArm, assistant: WatchedArm) -> None:
    both = Arms({MASTER: master, ASSISTANT: assistant}, (MASTER, ASSISTANT), CLOCK)
    for role in (MASTER, ASSISTANT):
        with pytest.raises(OtherArmUnknown, match="where the assistant stands is not known"):
            both.move(role, JointMove(HOME_RAD))
    both.place(ASSISTANT, ACROSS)
    both.move(MASTER, turned(master, 2.0))


def test_a_third_arm_is_an_obstacle_and_is_watched_like_the_second(
    master: WatchedArm, assistant: WatchedArm
) -> None:
    third = WatchedArm("robot.third", HOME_RAD)
    started(third)
    three = Arms({MASTER: master, ASSISTANT: assistant, "third": third}, (MASTER, ASSISTANT, "third"), CLOCK)
    three.place(ASSISTANT, Pose.from_kuka(0.0, 3000.0, 0.0, 0.0, 0.0, 0.0))
    three.place("third", ACROSS)
    third.controller.joints_rad = STRETCHED_RAD
    with pytest.raises(NotClear, match="of the third"):
        three.move(MASTER, JointMove(STRETCHED_RAD))
    third.guard.latch(ForceLimitExceeded("pressed"))
    with pytest.raises(BothArmsHalted, match="the third has gone to fault: pressed"):
        three.move(MASTER, turned(master, 10.0))
    third.close()


def test_the_resting_arm_is_an_obstacle_of_the_other(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    assistant.controller.joints_rad = STRETCHED_RAD
    with pytest.raises(NotClear, match="of the assistant"):
        pair.move(MASTER, JointMove(STRETCHED_RAD))
    assert master.controller.joints_rad == HOME_RAD
    assert pair.halted is None  # nothing was stopped


def test_what_is_previewed_knows_the_other_arm_where_it_is_now(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    pair.surround(MASTER, Surroundings())
    assert master.preview(JointMove(STRETCHED_RAD), start_rad=HOME_RAD).refused is None
    assistant.controller.joints_rad = STRETCHED_RAD
    pair.look_around(MASTER)
    refused = master.preview(JointMove(STRETCHED_RAD), start_rad=HOME_RAD).refused
    assert refused is not None
    assert refused.first.endswith(" of the master")
    assert refused.second.endswith(" of the assistant")


def test_no_motion_begins_while_another_is_under_way(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    refused: list[RonnaError] = []

    def try_other() -> None:
        master.on_step = lambda: None
        try:
            pair.move(ASSISTANT, turned(assistant, 5.0))
        except RonnaError as error:
            refused.append(error)

    master.on_step = try_other
    pair.move(MASTER, turned(master, 10.0))
    assert [error.code for error in refused] == ["DUAL-002"]


HOME_POSE = IdealArm.kinematics.forward(HOME_RAD)
HAND_MM = ACROSS.compose(HOME_POSE).position_mm  # of the assistant
MIDDLE_MM = vector3([(a + b) / 2.0 for a, b in zip(HOME_POSE.position_mm, HAND_MM, strict=True)])


def reaching(name: str, role: str, place_mm: Vector3) -> Part:
    """Return a rod from the flange of an arm at home to a place in the common frame."""
    base = Pose((0.0, 0.0, 0.0)) if role == MASTER else ACROSS
    return Part(name, Capsule((0.0, 0.0, 0.0), base.compose(HOME_POSE).inverse().apply(place_mm), 5.0))


@pytest.mark.hazard(58)
def test_only_the_named_parts_of_both_tools_may_come_close_to_each_other(
    pair: Arms, assistant: WatchedArm
) -> None:
    pair.surround(MASTER, Surroundings(tool=(reaching("tube", MASTER, MIDDLE_MM),)))
    pair.surround(ASSISTANT, Surroundings(tool=(reaching("instrument", ASSISTANT, MIDDLE_MM),)))
    assert not pair.rests_apart(MASTER, HOME_RAD)
    pair.placed.allow_contact(MASTER, ASSISTANT, ["bridge"], ["instrument"])
    assert not pair.rests_apart(MASTER, HOME_RAD)
    pair.placed.allow_contact(MASTER, ASSISTANT, ["tube"], ["instrument"])
    assert pair.rests_apart(MASTER, HOME_RAD)
    pair.watch()
    assert pair.halted is None
    pair.move(ASSISTANT, turned(assistant, 1.0))


@pytest.mark.hazard(58)
def test_a_part_that_may_touch_the_instrument_keeps_its_distance_from_the_rest_of_the_other_arm(
    pair: Arms,
) -> None:
    pair.surround(MASTER, Surroundings(tool=(reaching("tube", MASTER, HAND_MM),)))
    pair.surround(ASSISTANT, Surroundings(tool=(reaching("instrument", ASSISTANT, HAND_MM),)))
    pair.placed.allow_contact(MASTER, ASSISTANT, ["tube"], ["instrument"])
    assert not pair.rests_apart(MASTER, HOME_RAD)
    pair.watch()
    assert pair.halted is not None
    assert "tube of the master" in pair.halted.reason


@pytest.mark.hazard(58)
def test_an_arm_that_has_stopped_halts_the_other_before_its_controller_says_why(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    def stops() -> None:
        master.on_step = lambda: None
        assistant.stopped_by = ForceLimitExceeded("pressed")

    master.on_step = stops
    with pytest.raises(BothArmsHalted, match="the assistant has gone to fault: pressed"):
        pair.move(MASTER, turned(master, 10.0))
    assert {master.state, assistant.state} == {Lifecycle.FAULT}


@pytest.mark.hazard(58)
def test_arms_that_are_closer_than_a_doubt_about_the_base_allows_may_still_go_home(pair: Arms) -> None:
    pair.place(ASSISTANT, ACROSS, 5000.0)
    *others, wrist_rad = HOME_RAD
    pair.move(MASTER, JointMove(joint_vector((*others, wrist_rad + radians(30.0)))))  # comes no closer
    assert pair.halted is None


def stop_on_the_way(arm: WatchedArm, kind: StopKind) -> Callable[[], None]:
    def stop() -> None:
        arm.on_step = lambda: None
        arm.stop(kind)

    return stop


@pytest.mark.hazard(58)
@pytest.mark.parametrize("moved", [MASTER, ASSISTANT])
def test_a_fault_between_two_motions_halts_both(
    pair: Arms, master: WatchedArm, assistant: WatchedArm, moved: str
) -> None:
    assistant.stop(StopKind.PROTECTIVE)
    with pytest.raises(BothArmsHalted, match="the assistant has gone to fault"):
        pair.move(moved, turned(master, 10.0))
    assert master.controller.joints_rad == assistant.controller.joints_rad == HOME_RAD
    assert {master.state, assistant.state} == {Lifecycle.FAULT}


@pytest.mark.hazard(58)
def test_a_fault_that_a_step_finds_between_two_motions_latches_both(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    pair.halt_for_fault()
    assert pair.halted is None
    assistant.stop(StopKind.PROTECTIVE)
    pair.halt_for_fault()
    assert {master.state, assistant.state} == {Lifecycle.FAULT}
    assistant.recover("Ann")
    with pytest.raises(BothArmsHalted, match="the assistant has gone to fault"):
        pair.move(ASSISTANT, turned(assistant, 1.0))


@pytest.mark.hazard(58)
@pytest.mark.parametrize("kind", [StopKind.HOLD, StopKind.PROTECTIVE])
@pytest.mark.parametrize("stopped", [MASTER, ASSISTANT])
def test_a_stop_of_one_arm_stops_and_holds_both(
    pair: Arms, master: WatchedArm, assistant: WatchedArm, kind: StopKind, stopped: str
) -> None:
    arm = master if stopped == MASTER else assistant
    watched = threading.Event()

    def stop_once_moving() -> None:
        if master.state is Lifecycle.ACTIVE and pair_is_moving(master) and not watched.is_set():
            watched.set()
            stop_on_the_way(arm, kind)()

    arm.on_step = stop_once_moving
    with pytest.raises(BothArmsHalted, match="DUAL-001"):
        pair.move(MASTER, turned(master, 10.0))
    after = Lifecycle.HOLD if kind is StopKind.HOLD else Lifecycle.FAULT
    assert (master.state, assistant.state) == (after, after)
    with pytest.raises(BothArmsHalted):
        pair.move(ASSISTANT, turned(assistant, 1.0))


def pair_is_moving(arm: WatchedArm) -> bool:
    return arm.controller.joints_rad != HOME_RAD


def test_an_arm_whose_state_is_old_stops_both(pair: Arms, master: WatchedArm, assistant: WatchedArm) -> None:
    assistant.frozen = assistant.read_state()

    def move_on() -> None:
        if pair_is_moving(master):
            stamp = replace(assistant.frozen.stamp, theatre_time_s=CLOCK.now_s() - 0.11)
            assistant.frozen = replace(assistant.frozen, stamp=stamp)

    master.on_step = move_on
    with pytest.raises(BothArmsHalted, match="last state of the assistant is old"):
        pair.move(MASTER, turned(master, 1.0))
    assert master.state is Lifecycle.FAULT


@pytest.mark.hazard(58)
def test_an_interruption_by_the_operator_holds_both_arms_without_a_fault(
    pair: Arms, master: WatchedArm, assistant: WatchedArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def watch() -> None:
        if pair_is_moving(master):
            raise KeyboardInterrupt

    monkeypatch.setattr(pair, "watch", watch)
    with pytest.raises(KeyboardInterrupt):
        pair.move(MASTER, turned(master, 10.0))
    assert {master.state, assistant.state} == {Lifecycle.HOLD}


class LeapingClock(HostClock):
    """A clock that can be ahead of the host's."""

    ahead_s = 0.0

    def now_s(self) -> float:
        return super().now_s() + self.ahead_s


def test_a_thread_that_the_host_suspends_takes_no_arm_for_silent() -> None:
    clock = LeapingClock()

    class SuspendedArm(WatchedArm):
        def observe(self) -> LastKnown[ArmReading]:
            known = super().observe()
            clock.ahead_s += 1.0  # until its reader goes on
            return known

    arms = {role: SuspendedArm(f"robot.{role}", HOME_RAD, clock) for role in (MASTER, ASSISTANT)}
    for arm in arms.values():
        started(arm)
    pair = across(arms, clock)
    goal = turned(arms[MASTER], 1.0)
    assert pair.move(MASTER, goal).joints_rad == pytest.approx(goal.target_rad)
    for arm in arms.values():
        arm.close()


def test_an_arm_whose_telegrams_have_stopped_is_called_old(pair: Arms, assistant: WatchedArm) -> None:
    assistant.frozen = replace(assistant.read_state(), validity=Validity.STALE)
    with pytest.raises(OtherArmUnknown, match="the last state of the assistant is old"):
        pair.move(MASTER, JointMove(HOME_RAD))


def test_an_arm_whose_state_is_not_known_keeps_the_other_at_rest(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    stamp = replace(assistant.read_state().stamp, theatre_time_s=CLOCK.now_s() - 1.0)
    assistant.frozen = replace(assistant.read_state(), stamp=stamp)
    with pytest.raises(OtherArmUnknown, match="DUAL-003"):
        pair.move(MASTER, turned(master, 10.0))
    assert master.controller.joints_rad == HOME_RAD


@pytest.mark.hazard(58)
def test_both_arms_keep_as_much_more_distance_as_the_base_is_uncertain(
    pair: Arms, assistant: WatchedArm
) -> None:
    shares = [number / 200 for number in range(200)]
    way = [
        joint_vector(a + share * (b - a) for a, b in zip(HOME_RAD, STRETCHED_RAD, strict=True))
        for share in shares
    ]
    assistant.controller.joints_rad = STRETCHED_RAD
    (*_, nearest_rad) = (one for one in way if pair.rests_apart(MASTER, one))
    pair.place(ASSISTANT, ACROSS, 10.0)
    assert not pair.rests_apart(MASTER, nearest_rad)
    with pytest.raises(NotClear, match="of the assistant"):
        pair.move(MASTER, JointMove(nearest_rad))
    pair.place(ASSISTANT, ACROSS, 0.0)
    assert pair.move(MASTER, JointMove(nearest_rad)).joints_rad == pytest.approx(nearest_rad)


@pytest.mark.hazard(58)
def test_arms_that_come_too_close_are_stopped(pair: Arms, master: WatchedArm, assistant: WatchedArm) -> None:
    """Only the watch sees it: the arm that was to rest is pushed, as no plan foresees."""

    def push() -> None:
        if pair_is_moving(master):
            assistant.controller.joints_rad = STRETCHED_RAD
            master.controller.joints_rad = STRETCHED_RAD

    master.on_step = push
    with pytest.raises(BothArmsHalted, match=r"apart|moves although"):
        pair.move(MASTER, turned(master, 10.0))


def test_nothing_moves_with_an_instrument_in_the_guide(master: WatchedArm, assistant: WatchedArm) -> None:
    pair = across({MASTER: master, ASSISTANT: assistant}, CLOCK, lambda: "T1")
    for role in (MASTER, ASSISTANT):
        with raises(INSTRUMENT_IN_GUIDE, match="T1"):
            pair.move(role, JointMove(HOME_RAD))


def test_a_halt_ends_when_both_arms_are_ready_and_a_person_acknowledges(
    pair: Arms, master: WatchedArm, assistant: WatchedArm
) -> None:
    pair.stop("the room asked for it")
    with pytest.raises(BothArmsHalted, match="the master is not ready"):
        pair.acknowledge("Ada Surgeon")
    for arm in (master, assistant):
        arm.recover("Ada Surgeon")
        arm.activate()
    with pytest.raises(PersonNotNamed):
        pair.acknowledge("")
    pair.acknowledge("Ada Surgeon")
    pair.move(MASTER, turned(master, 2.0))


def test_a_halt_names_the_place_of_the_instrument(master: WatchedArm, assistant: WatchedArm) -> None:
    pair = across({MASTER: master, ASSISTANT: assistant}, CLOCK, lambda: "T2")
    pair.stop("a fault")
    with pytest.raises(BothArmsHalted, match="an instrument is in the guide, and in T2"):
        pair.move(MASTER, JointMove(HOME_RAD))


class PressingArm(WatchedArm):
    """An arm that meets the force limit of every insertion."""

    senses_force = True

    def insert(self, insertion: Insertion, *, timeout_s: float = 120.0) -> Inserted:
        self.stop(StopKind.HOLD)
        raise ForceLimitExceeded("the force on the tool", limit=f"{insertion.force_limit_N} N", got="16 N")


@pytest.mark.hazard(56)
def test_an_insertion_that_meets_its_force_limit_holds_and_latches_nothing(master: WatchedArm) -> None:
    """The arm's own error passes through; both arms can be led on, or back, once they are resumed."""
    pressing = PressingArm("robot.assistant", HOME_RAD)
    started(pressing)
    pair = across({MASTER: master, ASSISTANT: pressing}, CLOCK, lambda: "T1")
    target = Transform.of(Frame.ROBOT, Frame.TOOL)
    insertion = Insertion(target, Transform.of(Frame.FLANGE, Frame.TOOL), force_limit_N=15.0)
    with pytest.raises(ForceLimitExceeded):
        pair.insert(ASSISTANT, insertion)
    assert pressing.state is Lifecycle.HOLD
    assert pair.halted is None
    pressing.close()


def test_the_answers_to_a_motion_are_recorded_by_the_thread_that_moves(
    pair: Arms, master: WatchedArm
) -> None:
    readers: list[int] = []

    @contextmanager
    def reading() -> Iterator[None]:
        readers.append(threading.get_ident())
        yield

    pair.reading = reading
    pair.move(MASTER, turned(master, 5.0))
    assert len(readers) == 1
    assert readers != [threading.get_ident()]

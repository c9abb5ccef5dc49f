"""The arms of a theatre: who may move, how close they may come, and what stops all of them.

One arm moves at a time, with the others at rest as obstacles. While it moves, all are watched: their
distances, the age of what is known of each, and their states. Whatever stops one brings all to rest, and
holds them until a person has acknowledged it. Nothing retreats by itself, and nothing moves with an
instrument in the guide. An arm alone has nothing to be kept from: its own driver watches it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from typing import NoReturn, TypeVar

from procedures.workcell.errors import INSTRUMENT_IN_GUIDE, OTHER_ARM_MOVING, BothArmsHalted, OtherArmUnknown
from procedures.workcell.placed_arms import PlacedArms, RolePair
from ronna_hw.arm.clearance.arm_pair import APART_MM
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.live_pair import LivePair
from ronna_hw.arm.errors import ForceLimitExceeded
from ronna_hw.arm.pose import Pose
from ronna_hw.clock import Clock
from ronna_hw.devices import Lifecycle, Motion, RobotArm
from ronna_hw.devices.contact import Inserted, Insertion, InsertsInstruments
from ronna_hw.devices.lifecycle import RUNNING, LastKnown, require_person
from ronna_hw.devices.readings import ArmReading, Validity
from ronna_hw.devices.robot import StopKind
from ronna_hw.errors import RonnaError, summary_of
from ronna_hw.logs import logger
from ronna_hw.roles import MASTER
from ronna_hw.vectors import JointVector

# Safety against the other arm, not where it was last seen (U).
OLDEST_S = 0.1  # what is known of an arm while another moves
# The arms keep step there: a state is old because the host is busy, or because its arm stands still and the
# clock (`STREAM_SILENCE_NS`, 2.5 s) has just let the other one go on without it.
# Safety against the other arm, not where it was last seen. Source: `STREAM_SILENCE_NS`.
OLDEST_IN_LOCK_STEP_S = 2.4

WATCH_S = 0.02  # theatre time between two looks at both arms: 5 mm at reduced speed, of the 30 mm kept
# Safety against an arm that moves although it should rest (U).
STILL_RAD = 2e-3  # an arm at rest does not move by this much: 1 mm at half a metre

HALTED = "both arms are stopped"  # event of the log
# Safety against two arms that meet (U).
STOP_LIMIT_S = 5.0  # host time
LEAVING_MM = 1.0  # by which arms that are closer than they should be may come closer on their way apart

STOPPED_FOR_UNKNOWN = "the {} has stopped, and its controller has not said why"
R = TypeVar("R")


@dataclass(frozen=True)
class Halt:
    """Why all arms were brought to rest; `instrument` is where one was in the guide at that moment."""

    arm: str
    reason: str
    instrument: str | None
    kind: StopKind = StopKind.PROTECTIVE


class Arms:
    """Arms of one theatre by role, and the rules for their motions."""

    def __init__(
        self,
        arms: Mapping[str, RobotArm],
        roles: Sequence[str],
        clock: Clock,
        instrument_inside: Callable[[], str | None] = lambda: None,
    ) -> None:
        """Watch the arms of these roles, the master first: its base is the robot frame.

        `instrument_inside` tells where an instrument is, or may be, in the guide.
        """
        self._open, self.roles = arms, tuple(roles)
        self.placed = PlacedArms(roles, lambda role: arms[role].kinematics)
        self._clock = clock
        self.instrument_inside = instrument_inside
        self._moving = threading.Lock()  # held by the motion under way
        self._at_rest_rad: dict[str, JointVector] = {}  # of arms that must not move meanwhile
        self._expected: dict[str, Lifecycle] = {}  # states of all arms during the motion under way
        self._live: dict[RolePair, LivePair] = {}
        self._least_mm: dict[RolePair, float] = {}  # between the arms in the motion under way
        self.halted: Halt | None = None
        # Held by the thread that moves one of several arms.
        self.reading: Callable[[], AbstractContextManager[None]] = nullcontext

    def __getitem__(self, role: str) -> RobotArm:
        """Return the arm of a role, made on first use."""
        return self._open[role]

    def items(self) -> Iterator[tuple[str, RobotArm]]:
        return ((role, self._open[role]) for role in self.roles)

    def surround(self, role: str, surroundings: Surroundings) -> None:
        """Declare the tool and the surroundings of one arm, in its own base, without the other arms."""
        self.placed.around[role] = surroundings
        self[role].surround(surroundings)
        with suppress(OtherArmUnknown):  # else before its next motion
            self.look_around(role)

    def look_around(self, role: str) -> None:
        """Surround one arm with the others where they are now, as `move` does, before motions are previewed.

        Raises DUAL-003 if the state of another is unknown.
        """
        if self.placed.pairs and self.placed.are_all_placed:
            self._surround_with(role, self.placed.others(role))

    def rests_apart(self, role: str, joints_rad: JointVector) -> bool:
        """Return whether an arm, at these joints, would keep the planned distance from the others at rest."""
        at_rad = {one: arm.read_state().joints_rad for one, arm in self.items()} | {role: joints_rad}
        return self.placed.are_apart(at_rad)

    def place(self, role: str, base: Pose, uncertain_mm: float = 0.0) -> None:
        """Take a pose ROBOT <- base of an arm: once all are known, any may move.

        By `uncertain_mm` it may be elsewhere: it keeps that much more distance from the other arms, and from
        all that surrounds it.
        """
        self.placed.place(role, base, uncertain_mm)
        for one in self.roles:
            with suppress(OtherArmUnknown):  # else before its next motion
                self.look_around(one)

    def acknowledge(self, confirmed_by: str) -> None:
        """Release a halt once all arms can move again. Raises DEV-006 without a name, DUAL-001 otherwise."""
        require_person(confirmed_by)
        for role, arm in self.items():
            if arm.state not in (Lifecycle.CONFIGURED, *RUNNING):
                raise BothArmsHalted(f"the {role} is not ready", got=f"it is {arm.state}")
        self.halted = None

    def release_held(self, by: str) -> bool:
        """Release a halt of arms that are only held, as by an operator; return whether they were."""
        if not all(arm.state in RUNNING for _, arm in self.items()):
            return False
        self.acknowledge(by)
        return True

    def move(self, role: str, motion: Motion, *, with_instrument: bool = False) -> ArmReading:
        """Move one arm while the others rest, and return the reading at the end.

        `with_instrument` allows an instrument in the guide, which this motion moves along its axis.

        Raises DUAL-001 while all are halted, also if they are halted on the way, DUAL-002 while one moves,
        and DUAL-003 if the place or the state of another is unknown. ARM-007 means that another is in the
        way, TOOL-001 that an instrument is in the guide. The arm's own errors pass through.
        """
        return self._drive_one(role, lambda arm: arm.move(motion), with_instrument=with_instrument)

    def insert(self, role: str, insertion: Insertion) -> Inserted:
        """Have one arm insert an instrument while the others rest. Raises as `move`, and as that arm."""

        def drive(arm: RobotArm) -> Inserted:
            assert isinstance(arm, InsertsInstruments), "an arm that inserts"
            return arm.insert(insertion)

        return self._drive_one(role, drive, with_instrument=True)

    def _drive_one(self, role: str, drive: Callable[[RobotArm], R], *, with_instrument: bool) -> R:
        if not self.placed.pairs:
            return drive(self[role])
        with self._under_way(with_instrument=with_instrument):
            self._at_rest_rad = self._surround_with(role, self.placed.others(role))
            return self._drive(role, drive)

    def _surround_with(self, role: str, others: Sequence[str]) -> dict[str, JointVector]:
        """Surround an arm with others, where they rest; return the joints of those."""
        rest_rad = {other: self._joints_now(other) for other in others}
        self[role].surround(self.placed.surroundings_among(role, rest_rad))
        return rest_rad

    def stop(self, reason: str, arm: str = MASTER, kind: StopKind = StopKind.PROTECTIVE) -> None:
        """Bring all arms to rest and hold them there; never raises."""
        if self.halted is None:
            self.halted = Halt(arm, reason, self.instrument_inside(), kind)
            with suppress(ValueError):  # the clock is closed: the program ends
                now_s = round(self._clock.now_s(), 3)
                logger(device=f"robot.{arm}").warning(HALTED, cause=reason, theatre_time_s=now_s)
        stops = [
            threading.Thread(target=self._stop_one, args=(one, kind))
            for _, one in self.items()
            if one.observe().state in RUNNING
        ]
        for stop in stops:
            stop.start()
        for stop in stops:
            stop.join()

    def halt_for_fault(self) -> None:
        """Halt all for a fault since the last motion, as for one on the way; never raises."""
        for role, arm in self.items() if self.placed.pairs and self.placed.are_all_placed else ():
            if arm.state is Lifecycle.FAULT:
                self.stop(_tell_state(role, arm.observe()), role)

    def watch(self) -> None:
        """Look at all arms once; stop all for what stopped one, a distance, or an age."""
        found = self._find_trouble()
        if found is not None:
            role, reason, kind = found
            self.stop(reason, role, kind)
            self._ask_why(role)

    def _find_trouble(self) -> tuple[str, str, StopKind] | None:
        joints: dict[str, JointVector] = {}
        for role, arm in self.items():
            # First: a thread that the host suspends in between finds no arm silent.
            now_s = self._clock.now_s()
            seen = arm.observe()  # `state` may wait for a cause, and the other arm moves meanwhile
            if seen.state is not self._expected.get(role, seen.state):
                kind = StopKind.HOLD if seen.state is Lifecycle.HOLD else StopKind.PROTECTIVE
                return role, _tell_state(role, seen), kind
            if seen.stopped:
                return role, STOPPED_FOR_UNKNOWN.format(role), StopKind.PROTECTIVE
            try:
                joints[role] = self._joints(role, seen.reading, now_s)
            except OtherArmUnknown as error:
                return role, error.summary, StopKind.PROTECTIVE
            if (rests_rad := self._at_rest_rad.get(role)) is not None:
                moved_rad = max(abs(a - b) for a, b in zip(joints[role], rests_rad, strict=True))
                if moved_rad > STILL_RAD:
                    return role, f"the {role} moves although the other arm does", StopKind.PROTECTIVE
        for pair, live in (self._live or self.placed.live()).items():
            least_mm = self._least_mm.get(pair, APART_MM)
            near = live.find_near(joints[pair.first], joints[pair.second], least_mm)
            if near is not None:
                bodies = f"{near.first} of the {pair.first} and {near.second} of the {pair.second}"
                closer_mm = live.closeness.allowance_mm(near.first, near.second)
                words = f"{bodies} are {near.distance_mm - closer_mm:.1f} mm apart"
                limit_mm = least_mm - closer_mm
                return pair.first, f"{words}: expected at least {limit_mm:g} mm", StopKind.PROTECTIVE
        return None

    def _ask_why(self, role: str) -> None:
        """Have the halt say why an arm stopped that had not told it: stopping it has waited for that."""
        seen, halt = self[role].observe(), self.halted
        if halt is not None and halt.reason == STOPPED_FOR_UNKNOWN.format(role) and seen.fault is not None:
            self.halted = replace(halt, reason=_tell_state(role, seen))

    @contextmanager
    def _under_way(self, *, with_instrument: bool = False) -> Iterator[None]:
        """Hold the right to move. Raises DUAL-001 to DUAL-003, TOOL-001."""
        self.placed.require_all_placed()
        if not self._moving.acquire(blocking=False):
            raise OTHER_ARM_MOVING("another motion is under way")
        try:
            self._require_released()
            self.halt_for_fault()
            self._require_released()
            if not with_instrument and (place := self.instrument_inside()) is not None:
                raise INSTRUMENT_IN_GUIDE(f"an instrument is in the guide, and in {place}")
            self._live = self.placed.live()
            self._least_mm = {pair: self._find_least_mm(pair, live) for pair, live in self._live.items()}
            yield
        finally:
            self._live, self._expected, self._at_rest_rad, self._least_mm = {}, {}, {}, {}
            self._moving.release()

    def _find_least_mm(self, pair: RolePair, live: LivePair) -> float:
        """Return the distance that the motion which begins now must keep between two arms.

        Where one may be elsewhere, more than between arms at rest; but arms that have come closer
        than that before it was doubted may stay so, or move apart: else nothing could go home any more.
        """
        if not (doubt_mm := self.placed.doubt_mm(pair)):
            return APART_MM
        at_start = live.distance(self._joints_now(pair.first), self._joints_now(pair.second))
        return max(APART_MM, min(APART_MM + doubt_mm, at_start.distance_mm - LEAVING_MM))

    def _drive(self, role: str, motion: Callable[[RobotArm], R]) -> R:
        """Drive a motion, watched, and return what it returns once it has ended."""
        resting = {one: arm.state for one, arm in self.items() if one != role}
        for one, state in resting.items():
            if state not in RUNNING:
                raise OtherArmUnknown(f"the {one} is not started", got=f"it is {state}")
        self._expected = {role: Lifecycle.ACTIVE, **resting}
        self.watch()
        self._require_released()
        ends: list[R] = []
        errors: list[Exception] = []

        def drive() -> None:
            try:
                with self.reading():
                    ends.append(motion(self[role]))
            except Exception as error:
                errors.append(error)

        thread = threading.Thread(target=drive, daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                self.watch()
                self._clock.sleep(WATCH_S)
        except BaseException as ended:  # an operator's interruption is no fault, and casts no doubt
            kind = StopKind.HOLD if isinstance(ended, KeyboardInterrupt) else StopKind.PROTECTIVE
            self.stop("the program was interrupted", kind=kind)
            raise
        finally:
            thread.join()
        if not errors:
            self._require_released()
            return ends[0]
        (error,) = errors
        if self.halted is None:  # refused before it began, or stopped since the last look
            self.watch()
        # All arms are held, as asked for: nothing is latched, unless something else has stopped them.
        if isinstance(error, ForceLimitExceeded) and (halt := self.halted) is not None:
            self.halted = None if halt.kind is StopKind.HOLD and halt.arm == role else halt
        if self.halted is not None:
            self._refuse(error)
        raise error

    def _require_released(self) -> None:
        if self.halted is not None:
            self._refuse(None)

    def _refuse(self, cause: BaseException | None) -> NoReturn:
        assert self.halted is not None
        inside = self.halted.instrument
        where = "" if inside is None else f"; an instrument is in the guide, and in {inside}"
        raise BothArmsHalted(f"both arms are halted: {self.halted.reason}{where}") from cause

    def _joints_now(self, role: str) -> JointVector:
        """Return the joints of an arm as last reported. Raises as `_joints`."""
        now_s = self._clock.now_s()
        return self._joints(role, self[role].observe().reading, now_s)

    def _joints(self, role: str, reading: ArmReading | None, now_s: float) -> JointVector:
        """Return the joints in the last reading of an arm. Raises DUAL-003 if it is too old."""
        if reading is None or reading.validity not in (Validity.OK, Validity.STALE):
            raise OtherArmUnknown(f"the state of the {role} is not known")
        age_s = now_s - reading.stamp.theatre_time_s
        oldest_s = OLDEST_S if self._clock.paced else OLDEST_IN_LOCK_STEP_S
        if age_s > oldest_s or reading.validity is Validity.STALE:
            raise OtherArmUnknown(
                f"the last state of the {role} is old",
                limit=f"{1000 * oldest_s:.0f} ms",
                got=f"{1000 * age_s:.0f} ms",
            )
        return reading.joints_rad

    def _stop_one(self, arm: RobotArm, kind: StopKind) -> None:
        if kind is StopKind.HOLD and arm.state is Lifecycle.HOLD:
            return
        try:
            arm.stop(kind, STOP_LIMIT_S)
        except Exception as error:  # the other must be stopped nevertheless; its link stops it when it ends
            logger(device=arm.name).error("may not be at rest: the stop failed", cause=error)
            with suppress(RonnaError):
                arm.stop(StopKind.LINK, STOP_LIMIT_S)


class ReplayedArms(Arms):
    """Stand-ins for arms: what stopped one is in its answers, and nothing comes close."""

    def look_around(self, role: str) -> None:
        """Do nothing."""

    def _drive_one(self, role: str, drive: Callable[[RobotArm], R], *, with_instrument: bool) -> R:
        return drive(self[role])


def _tell_state(role: str, seen: LastKnown[ArmReading]) -> str:
    why = "" if seen.fault is None else f": {summary_of(seen.fault)}"
    return f"the {role} has gone to {seen.state}{why}"

"""Two arms in one theatre: who may move, how close they may come, and what stops both.

One arm moves at a time, with the other at rest as an obstacle; both at once only along paths that were
checked against each other in time. While one moves, both are watched: their distance, the age of what is
known of each, and their states. Whatever stops one brings both to rest, and holds both until a person has
acknowledged it. Nothing retreats by itself, and nothing moves with an instrument in the guide.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import NoReturn, TypeVar

from procedures.workcell.errors import BothArmsHalted, InstrumentInGuide, OtherArmMoving, OtherArmUnknown
from ronna_hw.arm.clearance.arm_pair import (
    APART_MM,
    NO_CLOSENESS,
    PLANNED_APART_MM,
    ArmPairWorld,
    Closeness,
    PlacedArm,
    SampledPath,
    name_of,
    require_apart,
)
from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.live_pair import LivePair
from ronna_hw.arm.errors import ForceLimitExceeded
from ronna_hw.arm.pose import Pose
from ronna_hw.clock import Clock
from ronna_hw.config import ASSISTANT, MASTER
from ronna_hw.devices import Lifecycle, Motion, RobotArm
from ronna_hw.devices.contact import Inserted, Insertion, InsertsInstruments
from ronna_hw.devices.lifecycle import RUNNING, LastKnown, require_person
from ronna_hw.devices.readings import ArmReading, Validity
from ronna_hw.devices.robot import StopKind
from ronna_hw.errors import RonnaError, summary_of
from ronna_hw.logs import logger
from ronna_hw.preview import plan_motion
from ronna_hw.vectors import JointVector

OLDEST_S = 0.1  # what is known of an arm while another moves
# The arms keep step there: a state is old because the host is busy, or because its arm stands still and the
# clock (`STREAM_SILENCE_NS`, 2.5 s) has just let the other one go on without it.
OLDEST_IN_LOCK_STEP_S = 2.4
WATCH_S = 0.02  # theatre time between two looks at both arms: 5 mm at 250 mm/s, of the 30 mm kept
STILL_RAD = 2e-3  # an arm at rest does not move by this much: 1 mm at half a metre
HALTED = "both arms are stopped"  # event of the log
STOP_LIMIT_S = 5.0  # host time
LEAVING_MM = 1.0  # by which arms that are closer than they should be may come closer on their way apart
LARGEST_LAG_S = 0.5  # of one arm behind the other on checked paths: both starts, and a stop from full speed
STOPPED_FOR_UNKNOWN = "the {} has stopped, and its controller has not said why"
ROLES = (MASTER, ASSISTANT)
R = TypeVar("R")


@dataclass(frozen=True)
class Halt:
    """Why both arms were brought to rest; `instrument` is where one was in the guide at that moment."""

    arm: str
    reason: str
    instrument: str | None
    kind: StopKind = StopKind.PROTECTIVE


class ArmPair:
    """Master and assistant, and the rules for their motions."""

    def __init__(
        self,
        arms: Mapping[str, RobotArm],
        assistant_base: Pose,
        clock: Clock,
        instrument_inside: Callable[[], str | None] = lambda: None,
    ) -> None:
        """Watch the arms of both roles; `assistant_base` is ROBOT <- base of the assistant.

        `instrument_inside` tells where an instrument is, or may be, in the guide.
        """
        self._arms = {role: arms[role] for role in ROLES}
        self._bases = {MASTER: Pose((0.0, 0.0, 0.0)), ASSISTANT: assistant_base}
        self._uncertain_mm = 0.0  # of the assistant's base, at its arm
        self._clock = clock
        self._instrument_inside = instrument_inside
        self._around = dict.fromkeys(ROLES, Surroundings())
        self._closeness = NO_CLOSENESS  # of the master, then the assistant
        self._moving = threading.Lock()  # held by the motion under way
        self._at_rest_rad: dict[str, JointVector] = {}  # of arms that must not move meanwhile
        self._expected: dict[str, Lifecycle] = {}  # states of both arms during the motion under way
        self._live: LivePair | None = None
        self._least_mm = APART_MM  # between the arms in the motion under way
        self.halted: Halt | None = None
        self.reading: Callable[[], AbstractContextManager[None]] = (
            nullcontext  # held by the thread that moves
        )

    def surround(self, role: str, surroundings: Surroundings) -> None:
        """Declare the tool and the surroundings of one arm, in its own base, without the other arm."""
        self._around[role] = replace(surroundings, owner=role)
        with suppress(OtherArmUnknown):  # else before its next motion
            self.look_around(role)

    def look_around(self, role: str) -> None:
        """Surround one arm with the other where that is now, as `move` does, before motions are previewed.

        Raises DUAL-003 if the state of the other is unknown.
        """
        self._surround_with_other(role)

    def rest_apart(self, joints_rad: Mapping[str, JointVector]) -> bool:
        """Return whether both arms, at these joints, would keep the distance that is planned between them."""
        world = ArmPairWorld(self._placed(MASTER), self._placed(ASSISTANT), self._closeness)
        apart_mm = world.distance(joints_rad[MASTER], joints_rad[ASSISTANT]).distance_mm
        return apart_mm >= PLANNED_APART_MM + self._uncertain_mm

    def place_assistant(self, base: Pose, uncertain_mm: float) -> None:
        """Take another pose ROBOT <- base of the assistant, as measured better.

        By `uncertain_mm` the assistant may be elsewhere: both arms keep that much more distance, and the
        assistant does so from all that surrounds it.
        """
        self._bases[ASSISTANT], self._uncertain_mm = base, uncertain_mm

    def allow_contact(self, of_master: Collection[str], of_assistant: Collection[str]) -> None:
        """Let these parts of one tool touch these of the other, and no others any more.

        The rest of the assistant may come as close to these parts of the master as to a guide.
        """
        self._closeness = Closeness(frozenset(product(of_master, of_assistant)), frozenset(of_master))

    def acknowledge(self, confirmed_by: str) -> None:
        """Release a halt once both arms can move again. Raises DEV-006 without a name, DUAL-001 otherwise."""
        require_person(confirmed_by)
        for role, arm in self._arms.items():
            if arm.state not in (Lifecycle.CONFIGURED, *RUNNING):
                raise BothArmsHalted(f"the {role} is not ready", got=f"it is {arm.state}")
        self.halted = None

    def move(self, role: str, motion: Motion, *, with_instrument: bool = False) -> ArmReading:
        """Move one arm while the other rests, and return the settled reading.

        `with_instrument` allows an instrument in the guide, which this motion moves along its axis.

        Raises DUAL-001 while both are halted, also if they are halted on the way, DUAL-002 while one moves,
        and DUAL-003 if the state of the other is unknown. ARM-007 means that the other is in the way,
        TOOL-001 that an instrument is in the guide. The arm's own errors pass through.
        """
        with self._under_way(with_instrument=with_instrument):
            self._at_rest_rad = {_other(role): self._surround_with_other(role)}
            return self._drive({role: motion.drive})[role]

    def insert(self, role: str, insertion: Insertion) -> Inserted:
        """Have one arm insert an instrument while the other rests. Raises as `move`, and as that arm."""
        arm = self._arms[role]
        assert isinstance(arm, InsertsInstruments), "an arm that inserts"
        with self._under_way(with_instrument=True):
            self._at_rest_rad = {_other(role): self._surround_with_other(role)}
            return self._drive({role: lambda _: arm.insert(insertion)})[role]

    def _surround_with_other(self, role: str) -> JointVector:
        """Surround an arm with the other one, where it rests; return the joints of that."""
        other, around = _other(role), self._around[role]
        rests_rad = self._joints_now(other)
        near, grown_mm = self._closeness.near if role == ASSISTANT else (), self._grown_mm(role)
        obstacles = self._placed(other).as_obstacles(rests_rad, self._bases[role], grown_mm, near)
        if role == ASSISTANT:
            around = around.thickened(self._uncertain_mm)
        contacts = (pair if role == MASTER else pair[::-1] for pair in self._closeness.contacts)
        self._arms[role].surround(
            replace(
                around,
                obstacles=(*around.obstacles, *obstacles),
                contacts=tuple((own, name_of(part, other)) for own, part in contacts),
            )
        )
        return rests_rad

    def move_together(self, motions: Mapping[str, Motion]) -> Mapping[str, ArmReading]:
        """Move both arms at once, if their paths are clear of each other in time.

        Raises ARM-011 before anything moves if they are not, otherwise as `move`.
        """
        with self._under_way():
            self._at_rest_rad = {}
            paths = {role: self._sampled_path(role, motions[role]) for role in ROLES}
            world = ArmPairWorld(paths[MASTER].arm, paths[ASSISTANT].arm, self._closeness)
            margin_mm = PLANNED_APART_MM + self._uncertain_mm
            require_apart(world, paths[MASTER], paths[ASSISTANT], LARGEST_LAG_S, margin_mm)
            for role, arm in self._arms.items():
                arm.surround(self._around[role])
            return self._drive({role: motion.drive for role, motion in motions.items()})

    def stop(self, reason: str, arm: str = MASTER, kind: StopKind = StopKind.PROTECTIVE) -> None:
        """Bring both arms to rest and hold them there; never raises."""
        if self.halted is None:
            self.halted = Halt(arm, reason, self._instrument_inside(), kind)
            with suppress(ValueError):  # the clock is closed: the program ends
                now_s = round(self._clock.now_s(), 3)
                logger(device=f"robot.{arm}").warning(HALTED, cause=reason, theatre_time_s=now_s)
        stops = [
            threading.Thread(target=self._stop_one, args=(one, kind))
            for one in self._arms.values()
            if one.observe().state in RUNNING
        ]
        for stop in stops:
            stop.start()
        for stop in stops:
            stop.join()

    def halt_for_fault(self) -> None:
        """Halt both for a fault since the last motion, as for one on the way; never raises."""
        for role, arm in self._arms.items():
            if arm.state is Lifecycle.FAULT:
                self.stop(_tell_state(role, arm.observe()), role)

    def watch(self) -> None:
        """Look at both arms once; stop both for what stopped one, a distance, or an age."""
        found = self._find_trouble()
        if found is not None:
            role, reason, kind = found
            self.stop(reason, role, kind)
            self._ask_why(role)

    def _find_trouble(self) -> tuple[str, str, StopKind] | None:
        joints: dict[str, JointVector] = {}
        for role, arm in self._arms.items():
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
        live = self._live or self._watched_pair()
        least_mm = self._least_mm
        near = live.find_near(joints[MASTER], joints[ASSISTANT], least_mm)
        if near is not None:
            bodies = f"{near.first} of the {MASTER} and {near.second} of the {ASSISTANT}"
            closer_mm = live.closeness.allowance_mm(near.first, near.second)
            words = f"{bodies} are {near.distance_mm - closer_mm:.1f} mm apart"
            limit_mm = least_mm - closer_mm
            return MASTER, f"{words}: expected at least {limit_mm:g} mm", StopKind.PROTECTIVE
        return None

    def _ask_why(self, role: str) -> None:
        """Have the halt say why an arm stopped that had not told it: stopping it has waited for that."""
        seen, halt = self._arms[role].observe(), self.halted
        if halt is not None and halt.reason == STOPPED_FOR_UNKNOWN.format(role) and seen.fault is not None:
            self.halted = replace(halt, reason=_tell_state(role, seen))

    @contextmanager
    def _under_way(self, *, with_instrument: bool = False) -> Iterator[None]:
        """Hold the right to move. Raises DUAL-001, DUAL-002, TOOL-001."""
        if not self._moving.acquire(blocking=False):
            raise OtherArmMoving("another motion is under way")
        try:
            self._require_released()
            self.halt_for_fault()
            self._require_released()
            if not with_instrument and (place := self._instrument_inside()) is not None:
                raise InstrumentInGuide(f"an instrument is in the guide, and in {place}")
            self._live = self._watched_pair()
            self._least_mm = self._find_least_mm(self._live)
            yield
        finally:
            self._live, self._expected, self._at_rest_rad, self._least_mm = None, {}, {}, APART_MM
            self._moving.release()

    def _find_least_mm(self, live: LivePair) -> float:
        """Return the distance that the motion which begins now must keep.

        Where the assistant may be elsewhere, more than between arms at rest; but arms that have come closer
        than that before it was doubted may stay so, or move apart: else nothing could go home any more.
        """
        if not self._uncertain_mm:
            return APART_MM
        at_start = live.distance(self._joints_now(MASTER), self._joints_now(ASSISTANT))
        return max(APART_MM, min(APART_MM + self._uncertain_mm, at_start.distance_mm - LEAVING_MM))

    def _drive(self, motions: Mapping[str, Callable[[RobotArm], R]]) -> Mapping[str, R]:
        """Drive the motions, watched, and return what each returns once all have ended."""
        resting = {role: arm.state for role, arm in self._arms.items() if role not in motions}
        for role, state in resting.items():
            if state not in RUNNING:
                raise OtherArmUnknown(f"the {role} is not started", got=f"it is {state}")
        self._expected = {**dict.fromkeys(motions, Lifecycle.ACTIVE), **resting}
        self.watch()
        self._require_released()
        ends: dict[str, R] = {}
        errors: dict[str, Exception] = {}

        def drive(role: str, motion: Callable[[RobotArm], R]) -> None:
            try:
                with self.reading() if len(motions) == 1 else nullcontext():
                    ends[role] = motion(self._arms[role])
            except Exception as error:
                errors[role] = error

        threads = [threading.Thread(target=drive, args=item, daemon=True) for item in motions.items()]
        for thread in threads:
            thread.start()
        try:
            while any(thread.is_alive() for thread in threads):
                self.watch()
                if errors and len(motions) > 1:
                    role, error = next(iter(errors.items()))
                    self.stop(f"the {role} failed: {summary_of(error)}", role)
                self._clock.sleep(WATCH_S)
        except BaseException as ended:  # an operator's interruption is no fault, and casts no doubt
            kind = StopKind.HOLD if isinstance(ended, KeyboardInterrupt) else StopKind.PROTECTIVE
            self.stop("the program was interrupted", kind=kind)
            raise
        finally:
            for thread in threads:
                thread.join()
        if errors and self.halted is None:  # refused before it began, or stopped since the last look
            self.watch()
        for error in errors.values():
            # Both arms are held, as asked for: nothing is latched, unless something else has stopped them.
            if isinstance(error, ForceLimitExceeded) and (halt := self.halted) is not None:
                self.halted = None if halt.kind is StopKind.HOLD and halt.arm in errors else halt
        if self.halted is not None:
            self._refuse(next(iter(errors.values()), None))
        for error in errors.values():
            raise error
        return ends

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
        return self._joints(role, self._arms[role].observe().reading, now_s)

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

    def _sampled_path(self, role: str, motion: Motion) -> SampledPath:
        arm, limits = self._arms[role], self._arms[role].limits()
        plan = plan_motion(arm.kinematics, self._joints_now(role), motion, limits)
        return SampledPath.driven(self._placed(role), arm.kinematics, plan, limits.cycle_s)

    def _placed(self, role: str) -> PlacedArm:
        bodies = Bodies(self._arms[role].kinematics, self._around[role])
        return PlacedArm(role, bodies, self._bases[role])

    def _watched_pair(self) -> LivePair:
        return LivePair(self._placed(MASTER), self._placed(ASSISTANT), self._closeness)

    def _grown_mm(self, role: str) -> float:
        """Return the thickening of the other arm that turns obstacle margins into those between two arms."""
        around = self._around[role]
        grown_mm = max(APART_MM - around.live_margin_mm, PLANNED_APART_MM - around.margin_mm)
        return grown_mm + self._uncertain_mm

    def _stop_one(self, arm: RobotArm, kind: StopKind) -> None:
        if kind is StopKind.HOLD and arm.state is Lifecycle.HOLD:
            return
        try:
            arm.stop(kind, STOP_LIMIT_S)
        except Exception as error:  # the other must be stopped nevertheless; its link stops it when it ends
            logger(device=arm.name).error("may not be at rest: the stop failed", cause=error)
            with suppress(RonnaError):
                arm.stop(StopKind.LINK, STOP_LIMIT_S)


class ReplayedPair(ArmPair):
    """Pair of stand-ins: what stopped an arm is in its answers, and nothing comes close."""

    def look_around(self, role: str) -> None:
        """Do nothing."""

    def move(self, role: str, motion: Motion, *, with_instrument: bool = False) -> ArmReading:
        """Return the recorded end of the motion."""
        return motion.drive(self._arms[role])

    def insert(self, role: str, insertion: Insertion) -> Inserted:
        """Return the recorded end of the insertion."""
        arm = self._arms[role]
        assert isinstance(arm, InsertsInstruments), "an arm that inserts"
        return arm.insert(insertion)


def _other(role: str) -> str:
    return ASSISTANT if role == MASTER else MASTER


def _tell_state(role: str, seen: LastKnown[ArmReading]) -> str:
    why = "" if seen.fault is None else f": {summary_of(seen.fault)}"
    return f"the {role} has gone to {seen.state}{why}"

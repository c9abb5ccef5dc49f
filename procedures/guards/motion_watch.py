"""Watches the patient with the tracker while the arm moves, and while an instrument is at its target.

A thread of its own reads the tracker; it stops the arm when the spheres on the head are not where they were
localized, or when a guide approaches them unseen for too long. It reads every fourth frame, and every frame
while there is doubt. What it saw is reported by the moving thread, when the motion has ended.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from procedures.engine.context import CaseMemory
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.guide_still import PUSHED_MM, GuideAtRest
from procedures.guards.head_frames import HeadFrames
from procedures.guards.room_reading import read_room
from procedures.guards.room_watch import PATIENT_LIMIT_MM, RoomWatch
from procedures.guards.tracker_link import late_s
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.frame_as_tool import with_its_spheres
from ronna_hw.clock import Clock
from ronna_hw.config import WatchPatient
from ronna_hw.devices.errors import MotionInterrupted, WrongState
from ronna_hw.devices.lifecycle import RUNNING, Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.errors import LinkTimeout, ProtocolError, RonnaError, summary_of

FRAME_S = 1 / 60  # of the tracker's frame counter
PASSED_FRAMES = 3  # unread, while there is no doubt
PASSED_S = (PASSED_FRAMES - 0.5) * FRAME_S  # theatre time
LONGEST_UNSEEN_S = 5.0  # theatre time under way; then it is a finding
FIRST_FRAME_S = 1.0  # host time to wait for the first frame; without it the motion begins all the same
REPEATING_S = 1.0  # theatre time without a new frame, after which it is told
UNSEEN_LOOK_S = 0.05  # host time between two looks at the clock once the tracker has failed
READ_LIMIT_S = 3.0  # host time: above what a simulated controller waits for a reply

MOVED = "the head, or the tracker, has moved"
PUSHED = "the guide was pushed or pulled"
LATE = "the head was watched late: the replies of the tracker were delayed"
UNSEEN = "the tracker has not seen the head for too long"


@dataclass
class MotionWatch:
    """One for a run. `find` and `void` write to the journal, `tell` shows at once, from any thread."""

    workcell: Workcell
    clock: Clock
    memory: CaseMemory
    when: WatchPatient
    find: Callable[[str], None]
    tell: Callable[[str], object]
    void: Callable[[RonnaError], None]
    beside: Callable[[], AbstractContextManager[None]] = nullcontext  # held while it reads for itself
    _room: RoomWatch | None = None
    _head: HeadFrames = field(init=False)
    _unseen_s: float = 0.0

    @contextmanager
    def watching(self, what: str, arm_moves: bool) -> Iterator[None]:
        """Around a motion or a wait. Raises PRO-020 when the head has moved; the arm is at rest then."""
        room = self.memory.find(RoomWatch)
        if room is None or not self._wanted:
            yield
            return
        if (state := self.workcell.tracker.state) is not Lifecycle.CONFIGURED:
            self.find(f"the head was not watched during {what}: the tracker is {state}")
            yield
            return
        if self._room is not room or self._head.spheres_mm is not room.spheres_mm:
            self._room, self._head, self._unseen_s = room, HeadFrames(room.spheres_mm), 0.0
        looking = _Looking(
            self.workcell,
            self.clock,
            arm_moves,
            room,
            self._head,
            what,
            self.tell,
            guide=self.memory.find(GuideAtRest),
        )
        room.begin_motion(self.clock.now_s())
        try:
            looking.begin()  # waits for a frame: may be interrupted as well
            yield
        except RonnaError as error:
            seen = looking.end()
            # An alarm before the motion began makes the arm refuse it: what was seen is what has to be told.
            if isinstance(error, MotionInterrupted | WrongState) or seen.moved_mm is not None:
                self._conclude(seen, what)
            raise
        except BaseException:  # also an interruption: the arm comes to rest
            try:
                self.workcell.stop()  # first: the last frame may take its time
            finally:
                looking.end()
            raise
        self._conclude(looking.end(), what)

    @property
    def _wanted(self) -> bool:
        if self.when is WatchPatient.INSTRUMENT:
            return self.workcell.tool is MountedTool.GUIDE
        return self.when is WatchPatient.ALWAYS

    def _conclude(self, seen: _Looking, what: str) -> None:
        if seen.moved_mm is not None:
            moved = self._named(seen.room, seen.moved_mm, what)
            self.void(moved)  # first: as long as that is not written, the watch goes on
            self.memory.drop(RoomWatch)  # the way out is not to be stopped by the same
            raise moved
        if seen.pushed_mm > PUSHED_MM:
            self.find(f"{PUSHED} by up to {seen.pushed_mm:.2f} mm during {what}")
        if seen.problem:
            self.find(f"the head was not watched during {what}: {seen.problem}")
        if seen.late_s > 0.0:
            self.find(f"{LATE} by up to {seen.late_s:.2f} s during {what}")
        already_noted = self._unseen_s > LONGEST_UNSEEN_S
        self._unseen_s = seen.unseen_s + (0.0 if seen.has_seen else self._unseen_s)
        if self._unseen_s > LONGEST_UNSEEN_S and not already_noted:
            self.find(f"the tracker has not seen the head for {self._unseen_s:.0f} s, up to {what}")

    def _named(self, room: RoomWatch, moved_mm: float, what: str) -> BaseShifted | PatientMoved:
        """What has moved, by one more reading at rest: that compares the frame on the arm as well."""
        try:
            with self.beside():
                room.check(read_room(self.workcell, self.clock, room.robot_from_tracker))
        except BaseShifted as found:
            shifted = BaseShifted(f"{found.what}, during {what}", limit=found.limit, got=found.got)
            shifted.cart = found.cart
            return shifted
        except PatientMoved as found:
            return PatientMoved.by(f"{found.what}, during {what}", found.moved_mm, PATIENT_LIMIT_MM)
        except RonnaError as problem:  # what was seen is told all the same
            self.find(f"no further reading after {what}: {problem.summary}")
        return PatientMoved.by(f"{MOVED} during {what}", moved_mm, PATIENT_LIMIT_MM)


@dataclass
class _Looking:
    """Reads frames until it is ended. `unseen_s` is theatre time since the head was seen last."""

    workcell: Workcell
    clock: Clock
    arm_moves: bool
    room: RoomWatch
    head: HeadFrames
    what: str  # the motion or the wait
    tell: Callable[[str], object]
    moved_mm: float | None = None
    pushed_mm: float = 0.0  # the guide, at most
    late_s: float = 0.0  # how long replies took at most, if that was too long
    problem: str = ""  # why nothing looks any more
    has_seen: bool = False
    unseen_s: float = 0.0
    _seen_s: float = 0.0
    _overdue: bool = False
    _stop_wanted: bool = False
    _stopping: threading.Thread | None = None
    guide: GuideAtRest | None = None  # as it was held, while somebody works through it
    _silence_reported: bool = False
    _pushed: bool = False

    def __post_init__(self) -> None:
        self._seen_s = self.clock.now_s()
        self._ending, self._first = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="patient watch", daemon=True)

    def begin(self) -> None:
        """Start; returns when the first frame has been read and, if it shows a shift, the arm is stopped."""
        if self.guide is not None:
            self.guide.begin_watch()
        self._thread.start()
        self._first.wait(FIRST_FRAME_S)
        if self._stopping is not None:  # the motion that would begin now is refused
            self._stopping.join()

    def end(self) -> _Looking:
        """Stop looking; the fields hold what was seen."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._stopping is not None:
            self._stopping.join()
        return self

    def _run(self) -> None:
        tracker = self.workcell.tracker
        try:
            tracker.activate()
            self._read()
        except Exception as problem:  # recorded when the motion ends; what lasts is latched by the tracker
            self.problem = summary_of(problem)
            self._tell_silence(self.problem)
        finally:
            self._first.set()
            if tracker.state in RUNNING:
                with contextlib.suppress(RonnaError):
                    tracker.deactivate()
        while not self._ending.wait(UNSEEN_LOOK_S):  # nothing looks any more, but the time counts
            self._meet_unseen()
            self._stop_again()

    def _read(self) -> None:
        tracker, new_s = self.workcell.tracker, self._seen_s
        while not self._ending.is_set():
            self._stop_again()
            try:
                frame = tracker.read_frame(READ_LIMIT_S)
            except (LinkTimeout, ProtocolError) as problem:  # costs one frame
                self._meet_unseen()
                if tracker.state is not Lifecycle.ACTIVE:
                    raise
                if isinstance(problem, LinkTimeout):
                    self._tell_silence(problem.summary)
                continue
            if frame.validity is Validity.STALE:
                self._meet_unseen()
                if self.clock.now_s() - new_s > REPEATING_S:
                    self._tell_silence("the tracker repeats its last frame")
                self._ending.wait(FRAME_S / 2)
                continue
            self.head.take(with_its_spheres(tracker, frame))
            self._meet_push(frame)
            self._meet_late()
            new_s = self.clock.now_s()
            if self.head.seen:
                self.has_seen, self._seen_s, self.room.seen_s = True, new_s, new_s
            self._meet_unseen()
            if self.moved_mm is None and (self.head.moved_mm or 0.0) >= PATIENT_LIMIT_MM:
                self.moved_mm = self.head.moved_mm
                self._begin_alarm(MOVED, stop=True)
            self._first.set()  # after the alarms: the motion begins with it
            if self.head.doubtful:
                continue
            if self.arm_moves:
                self.clock.sleep(PASSED_S)
            else:  # host time: whoever waits for theatre time makes a simulated arm at rest hurry
                self._ending.wait(PASSED_S)

    def _meet_unseen(self) -> None:
        now_s = self.clock.now_s()
        self.unseen_s = now_s - self._seen_s
        if not self._overdue and self.room.overdue(now_s):
            self._overdue = True
            self._begin_alarm(UNSEEN, stop=self.arm_moves)

    def _meet_late(self) -> None:
        """Tell it once, while it is under way; the guard at the next checkpoint suspends while it lasts."""
        late = late_s(self.workcell.tracker) or 0.0
        if late > 0.0 and self.late_s == 0.0:
            self.tell(f"{LATE} by {late:.2f} s")
        self.late_s = max(self.late_s, late)

    def _meet_push(self, frame: TrackerFrame) -> None:
        """Tell it once each time; the guard at the next checkpoint suspends while it lasts."""
        if self.guide is None or not self.guide.worked:
            return
        self.guide.take(frame, self.workcell.calibrations.tracker_frame.tool)
        self.pushed_mm = max(self.pushed_mm, self.guide.now_mm)
        pushed = self.guide.now_mm > PUSHED_MM
        if pushed and not self._pushed:
            self.tell(f"{PUSHED}: {self.guide.now_mm:.2f} mm from where it was held")
        self._pushed = pushed

    def _begin_alarm(self, why: str, *, stop: bool) -> None:
        self._stop_wanted |= stop
        if self._stops:  # what was seen is told when it rests
            return
        if stop:
            self._begin_stop()
        self.tell(f"{why} during {self.what}" + (": the arm is stopped" if stop else ""))

    def _stop_again(self) -> None:
        """While the arm may still move: a stop may fail, for example by its time limit."""
        wanted = self._stop_wanted and not self._stops
        if wanted and self.workcell.arm.observe().state is Lifecycle.ACTIVE:
            self._begin_stop()

    @property
    def _stops(self) -> bool:
        return self._stopping is not None and self._stopping.is_alive()

    def _begin_stop(self) -> None:
        # Stopping waits for the arm to rest; in lock-step it does not come to rest while no frame is read.
        stopping = threading.Thread(target=self.workcell.stop, name="stop by the patient watch", daemon=True)
        stopping.start()
        self._stopping = stopping

    def _tell_silence(self, why: str) -> None:
        """Once, and at once: the motion that nothing watches any more may take its time."""
        if not self._silence_reported:
            self._silence_reported = True
            self.tell(f"the head is not watched: {why}")

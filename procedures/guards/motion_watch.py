"""Tracking of patient and cart while the arm moves or an instrument is at its target.

The thread that reads the tracker stops the arm; the moving thread reports its findings when the motion has
ended, and looks once more at rest for what has moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field

from procedures.engine.setting import CaseMemory
from procedures.guards import errors
from procedures.guards.guide_displacement import PUSHED_MM, GuideAtRest
from procedures.guards.head_frames import PATIENT_LIMIT_MM, HeadFrames, PatientFrames
from procedures.guards.room_watch import RoomWatch, read_watched
from procedures.guards.watch_thread import BASE_MOVED, LATE, MOVED, PUSHED, UNSEEN, WatchThread
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.arm_history import MotionKind
from procedures.workcell.tracker_move import TrackerMove
from ronna_hw.config import WatchPatient
from ronna_hw.devices.errors import MotionInterrupted, WrongState
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import RonnaError

# Safety against a head that nobody sees under way (U).
LONGEST_HEAD_UNSEEN_S = 5.0  # theatre time under way; beyond it is a finding


@dataclass
class MotionWatch:
    """Patient watch of a run. `find` and `void` write to the journal; `tell` informs the operator at once."""

    workcell: Workcell
    memory: CaseMemory
    when: WatchPatient
    find: Callable[[str], None]
    tell: Callable[[str], object]
    void: Callable[[RonnaError], None]
    beside: Callable[[], AbstractContextManager[None]] = nullcontext  # held while the moving thread reads
    _room: RoomWatch | None = None
    _tracker: TrackerMove | None = None  # for which `_head` holds
    _head: PatientFrames = field(init=False)
    _unseen_s: float = 0.0

    @contextmanager
    def watching(self, what: str, motion: str | None) -> Iterator[None]:
        """Watch the patient during a motion of this kind, or a wait (None).

        Raises PRO-019, PRO-020, PRO-022, PRO-051, PRO-052 or PRO-054 with the arm at rest. A pushed tracker
        is a finding: the motion that it stopped is planned again, as after any stop.
        """
        room = self.memory.find(RoomWatch)
        if room is None or not self._is_wanted:
            yield
            return
        if (state := self.workcell.tracker.state) is not Lifecycle.CONFIGURED:
            self.find(f"the head was not watched during {what}: the tracker is {state}")
            yield
            return
        if self._room is not room or self._head.spheres.spheres_mm is not room.spheres_mm:
            self._room, self._tracker, self._unseen_s = room, None, 0.0
        if self._tracker is not room.tracker:  # else the readings from before the move would count
            clamp = None if room.clamp_mm is None else HeadFrames(room.clamp_mm)
            self._tracker = room.tracker
            self._head = PatientFrames(HeadFrames(room.spheres_mm), clamp)
        guide = self.memory.find(GuideAtRest)
        thread = WatchThread(self.workcell, motion, room, self._head, what, self.tell, guide=guide)
        room.head_sight.begin_motion(self.workcell.clock.now_s())
        try:
            thread.begin()  # waits for a frame: may be interrupted as well
            yield
        except RonnaError as error:
            seen = thread.end()
            # After an early alarm the arm refuses the motion: the alarm must be reported.
            if isinstance(error, MotionInterrupted | WrongState) or seen.has_moved or seen.disturbed:
                self._conclude(seen, what)
            raise
        except BaseException:  # also an interruption: the arm comes to rest
            try:
                self.workcell.stop()  # first: the last frame may take its time
            finally:
                thread.end()
            raise
        seen = thread.end()
        self._conclude(seen, what)
        if seen.is_overdue and motion == MotionKind.INSERT:
            raise errors.PatientUnseen(f"{UNSEEN}: {what} had ended before the arm could be stopped")

    @property
    def _is_wanted(self) -> bool:
        if self.when is WatchPatient.INSTRUMENT:
            return self.workcell.master.tool is MountedTool.GUIDE
        return self.when is WatchPatient.ALWAYS

    def _conclude(self, seen: WatchThread, what: str) -> None:
        if seen.has_moved:
            moved = self._identify_cause(seen, what)
            if isinstance(moved, errors.RoomMoved):
                self.void(moved)  # first: the watch goes on until this is written
            if moved is not None:
                self.memory.drop(RoomWatch)  # the same move must not stop the way out
                raise moved
            if seen.guide is not None and seen.guide.is_worked_through:
                seen.guide.look(self.workcell, seen.room)
        elif seen.disturbed:
            limit, got = seen.limit or None, seen.got or None
            raise errors.InsertionDisturbed(f"{seen.disturbed} during {what}", limit=limit, got=got)
        elif seen.pushed_mm > PUSHED_MM:
            self.find(f"{PUSHED} by up to {seen.pushed_mm:.2f} mm during {what}")
        if seen.problem:
            self.find(f"the head was not watched during {what}: {seen.problem}")
        if seen.late_s > 0.0:
            self.find(f"{LATE} by up to {seen.late_s:.2f} s during {what}")
        already_noted = self._unseen_s > LONGEST_HEAD_UNSEEN_S
        self._unseen_s = seen.unseen_s + (0.0 if seen.has_seen else self._unseen_s)
        if self._unseen_s > LONGEST_HEAD_UNSEEN_S and not already_noted:
            self.find(f"the tracker has not seen the head for {self._unseen_s:.0f} s, up to {what}")

    def _identify_cause(
        self, seen: WatchThread, what: str
    ) -> errors.RoomMoved | errors.RoomUndecided | errors.InsertionDisturbed | None:
        """Determine what has moved from a further reading at rest that includes the frame on the arm.

        None if only the tracker was moved, and could be followed.
        """
        room = seen.room
        before = room.tracker
        found: RonnaError | None
        try:
            with self.beside():
                look = room.compare(read_watched(room, self.workcell), self.workcell.clock.now_s())
        except RonnaError as problem:
            found = problem
        else:
            found = look.moved
            if found is None and room.tracker is not before:
                for finding in look.findings:
                    self.find(f"during {what}: {finding}")
                return None
        if isinstance(found, errors.RoomMoved | errors.RoomUndecided | errors.InsertionDisturbed):
            found.happened_during(what)
            return found
        if found is not None:
            self.find(f"no further reading after {what}: {found.summary}")
        if seen.moved_mm is None:
            shifted = errors.BaseShifted(
                f"{BASE_MOVED} during {what}",
                limit=f"{room.gross_limit_mm:.1f} mm",
                got=f"{seen.base_mm:.1f} mm",
            )
            shifted.frame_off_mm = seen.base_mm
            return shifted
        what, on_skin = f"{MOVED} during {what}", not len(room.spheres_mm)
        return errors.PatientMoved.from_shift(what, seen.moved_mm, PATIENT_LIMIT_MM, on_skin=on_skin)

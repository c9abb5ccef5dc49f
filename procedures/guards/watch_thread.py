"""Thread that reads the tracker while the arm moves or an instrument is at its target, and stops the arm.

It stops the arm when the spheres on the head have moved, when the frame on the arm is far from where the arm
has it, or when a guide has approached the head unseen for too long. It reads every fourth frame, and every
frame while in doubt.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from procedures.guards.assistant_on_axis import LARGEST_OFF_MM, AssistantOnAxis
from procedures.guards.guide_displacement import PUSHED_MM, GuideAtRest
from procedures.guards.head_frames import PATIENT_LIMIT_MM, Flags, PatientFrames
from procedures.guards.room_reading import find_ghosts
from procedures.guards.room_watch import RoomWatch
from procedures.guards.tracker_guards import late_s
from procedures.workcell import Workcell
from procedures.workcell.arm_history import MotionKind
from procedures.workcell.patient_frame import posed_markers
from procedures.workcell.tracker_look import FRAME_S, add_frame_spheres, flange_from_marker, markers_in_frame
from ronna_hw.arrays import Array
from ronna_hw.devices.lifecycle import RUNNING, Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.errors import LinkTimeout, ProtocolError, RonnaError, summary_of
from ronna_hw.vectors import Vector3, vector3

SKIPPED_FRAMES = 3  # between two readings, unless in doubt
SKIPPED_S = (SKIPPED_FRAMES - 0.5) * FRAME_S  # theatre time
FIRST_FRAME_S = 1.0  # host time to wait for the first frame; the motion then begins without it
REPEATING_S = 1.0  # theatre time without a new frame, after which this is reported
UNSEEN_LOOK_S = 0.05  # host time between two looks at the clock once the tracker has failed
FAR_FRAMES = 3  # in a row that show the frame on the arm elsewhere
READ_LIMIT_S = 3.0  # host time: longer than a simulated controller waits for a reply

MOVED = "the head, or the tracker, has moved"
BASE_MOVED = "the cart of the robot, or the tracker, has moved"
PUSHED = "the guide was pushed or pulled"
ASSISTANT_MOVED = "the assistant has moved against its frame"
LATE = "the head was watched late: the replies of the tracker were delayed"
UNSEEN = "the tracker has not seen the head for too long"


@dataclass
class WatchThread:
    """Thread that reads tracker frames. `unseen_s` is the theatre time since the head was last seen."""

    workcell: Workcell
    motion: str | None  # its kind
    room: RoomWatch
    head: PatientFrames
    what: str  # the motion or the wait
    tell: Callable[[str], object]
    moved_mm: float | None = None
    base_mm: float | None = None  # the frame on the arm, from where the arm has it
    pushed_mm: float = 0.0  # the guide, at most
    late_s: float = 0.0  # longest delay of replies, if too long
    problem: str = ""  # why the thread no longer looks
    has_seen: bool = False
    unseen_s: float = 0.0
    _longest_unseen_s: float = 0.0
    _seen_s: float = 0.0
    is_overdue: bool = False
    _stop_wanted: bool = False
    _stopping: threading.Thread | None = None
    guide: GuideAtRest | None = None  # as it was held, while somebody works through it
    _silence_reported: bool = False
    _pushed: bool = False
    _far_frames: int = 0
    disturbed: str = ""  # what made the assistant stop on its way through the guide
    limit: str = ""
    got: str = ""
    leading: list[AssistantOnAxis] = field(default_factory=list)  # arms that lead an instrument
    _flange_from_frame_mm: Vector3 | None = None

    def __post_init__(self) -> None:
        self.clock = self.workcell.clock
        self._seen_s = self.clock.now_s()
        if self._leads_instrument:
            self.leading = [
                AssistantOnAxis(self.workcell, arm, self.room) for arm in self.workcell.assistants
            ]
        self._ending, self._first = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="patient watch", daemon=True)

    @property
    def arm_moves(self) -> bool:
        return self.motion is not None

    @property
    def _leads_instrument(self) -> bool:
        """Whether the assistant leads an instrument through the guide, which the master holds, or out."""
        if self.motion not in (MotionKind.INSERT, MotionKind.WITHDRAW):
            return False
        led = any(arm.place.is_on_axis for arm in self.workcell.assistants)
        return led or (self.guide is not None and self.guide.is_worked_through)

    @property
    def has_moved(self) -> bool:
        return self.moved_mm is not None or self.base_mm is not None

    def begin(self) -> None:
        """Start the thread. Wait, within a limit, for its first frame and any stop triggered by it."""
        if self.guide is not None:
            self.guide.begin_watch(self.clock.now_s())
        self._thread.start()
        self._first.wait(FIRST_FRAME_S)
        if self._stopping is not None:  # the motion that would begin now is refused
            self._stopping.join()

    def end(self) -> WatchThread:
        """Stop and join the thread, whose fields then contain the findings."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._stopping is not None:
            self._stopping.join()
        if self.guide is not None:
            unseen_s = max(self._longest_unseen_s, self.unseen_s)
            self.guide.end_watch(self.clock.now_s(), unseen_s, head_seen=self.has_seen)
        return self

    def _run(self) -> None:
        tracker = self.workcell.tracker
        try:
            tracker.activate()
            self._read()
        except Exception as problem:  # recorded when the motion ends; what lasts is latched by the tracker
            self.problem = summary_of(problem)
            self._report_silence(self.problem)
        finally:
            self._first.set()
            if tracker.state in RUNNING:
                with contextlib.suppress(RonnaError):
                    tracker.deactivate()
        while not self._ending.wait(UNSEEN_LOOK_S):  # blind now, but the time counts
            self._check_unseen()
            self._stop_again()

    def _read(self) -> None:
        tracker, new_s = self.workcell.tracker, self._seen_s
        while not self._ending.is_set():
            self._stop_again()
            begin_mm = self._frame_by_arm_mm()
            try:
                frame = tracker.read_frame(READ_LIMIT_S)
            except (LinkTimeout, ProtocolError) as problem:  # costs one frame
                self._check_unseen()
                if tracker.state is not Lifecycle.ACTIVE:
                    raise
                if isinstance(problem, LinkTimeout):
                    self._report_silence(problem.summary)
                continue
            if frame.validity is Validity.STALE:
                self._check_unseen()
                if self.clock.now_s() - new_s > REPEATING_S:
                    self._report_silence("the tracker repeats its last frame")
                self._ending.wait(FRAME_S / 2)
                continue
            frame = self.room.as_localized(add_frame_spheres(tracker, frame))
            self.head.add(frame, self._on_clamp_mm(frame), partial(self._find_ghosts, frame))
            self._check_push(frame)
            self._check_assistant(frame)
            self._check_base(frame, begin_mm)
            self._check_late()
            new_s = self.clock.now_s()
            if self.head.seen:
                self.has_seen, self._seen_s, self.room.head_sight.seen_s = True, new_s, new_s
            self._check_unseen()
            if self.moved_mm is None and (self.head.moved_mm or 0.0) >= PATIENT_LIMIT_MM:
                self.moved_mm = self.head.moved_mm
                self._raise_alarm(MOVED, stop=True)
            self._first.set()  # after the alarms: the motion begins with it
            if self.head.doubtful or self._far_frames:
                continue
            if self.arm_moves:
                self.clock.sleep(SKIPPED_S)
            else:  # host time: waiting in theatre time would hurry a simulated arm at rest
                self._ending.wait(SKIPPED_S)

    def _on_clamp_mm(self, frame: TrackerFrame) -> Sequence[Sequence[float]]:
        name, markers_mm = self.workcell.patient_frame, self.room.clamp_markers_mm
        if name is None or markers_mm is None or self.room.clamp_mm is None:
            return ()
        return posed_markers(frame, name, markers_mm)

    def _find_ghosts(self, frame: TrackerFrame, spheres_mm: Array, points_mm: Array) -> Flags:
        """Flag points where lines to the spheres and to the other markers of a frame cross."""
        others_mm = markers_in_frame(self.workcell.tracker, frame)
        return find_ghosts(spheres_mm, others_mm, points_mm, self.room.sensors_mm)

    def _check_unseen(self) -> None:
        now_s = self.clock.now_s()
        self.unseen_s = now_s - self._seen_s
        self._longest_unseen_s = max(self._longest_unseen_s, self.unseen_s)
        if not self.is_overdue and self.room.head_sight.is_overdue(now_s):
            self.is_overdue = True
            self._raise_alarm(UNSEEN, stop=self.arm_moves)

    def _check_late(self) -> None:
        """Report late replies once. The guard at the next checkpoint suspends the case while they persist."""
        late = late_s(self.workcell.tracker) or 0.0
        if late > 0.0 and self.late_s == 0.0:
            self.tell(f"{LATE} by {late:.2f} s")
        self.late_s = max(self.late_s, late)

    def _check_push(self, frame: TrackerFrame) -> None:
        """Report each push once; one on the way into the guide, or a large one on the way out, stops.

        Otherwise the guard at the next checkpoint suspends the case while it lasts.
        """
        if self.guide is None or not (self.guide.is_worked_through or self._leads_instrument):
            return
        self.guide.add_frame(frame, self.workcell.calibrations.tracker_frame.tool, self.clock.now_s())
        self.pushed_mm = max(self.pushed_mm, self.guide.now_mm)
        pushed = self.guide.now_mm > PUSHED_MM
        most_mm = PUSHED_MM if self.motion == MotionKind.INSERT else LARGEST_OFF_MM
        if self._leads_instrument and self.guide.now_mm > most_mm:
            self._disturb(PUSHED, most_mm, self.guide.now_mm)
        elif pushed and not self._pushed:
            self.tell(f"{PUSHED}: {self.guide.now_mm:.2f} mm from where it was held")
        self._pushed = pushed

    def _check_assistant(self, frame: TrackerFrame) -> None:
        """Stop an assistant that has moved against its frame on its way through the guide."""
        for arm in self.leading:
            arm.add_frame(frame)
            if (now := arm.now) is not None and now.has_moved:
                self._disturb(ASSISTANT_MOVED, LARGEST_OFF_MM, now.largest_mm)

    def _disturb(self, what: str, limit_mm: float | None = None, got_mm: float | None = None) -> None:
        if self.disturbed:
            return
        self.disturbed = what
        if limit_mm is None or got_mm is None:
            self._raise_alarm(what, stop=True)
        else:
            self.limit, self.got = f"{limit_mm:g} mm", f"{got_mm:.2f} mm"
            self._raise_alarm(f"{what}: {self.got}", stop=True)

    def _check_base(self, frame: TrackerFrame, begin_mm: Vector3 | None) -> None:
        """Compare the frame on the arm with the arm, which had it at `begin_mm` before this frame."""
        reading, end_mm = frame.tool(self.workcell.calibrations.tracker_frame.tool), self._frame_by_arm_mm()
        seen_mm = reading.position_mm if reading.validity is Validity.OK else None
        if seen_mm is None or begin_mm is None or end_mm is None:
            self._far_frames = 0
            return
        off_mm = self.room.frame_off_arm_mm(seen_mm, begin_mm, end_mm)
        self._far_frames = 0 if off_mm is None else self._far_frames + 1
        if self.base_mm is None and self._far_frames == FAR_FRAMES:
            self.base_mm = off_mm
            self._raise_alarm(BASE_MOVED, stop=True)
            self._far_frames = 0

    def _frame_by_arm_mm(self) -> Vector3 | None:
        """Return the last known position of the frame on the arm, robot frame, or None.

        None also for an arm that a fault is stopping: its last reading was taken while it still moved.
        """
        seen = self.workcell.master.arm.observe()
        known = seen.reading
        if known is None or (self.arm_moves and (seen.stopped or seen.state is Lifecycle.FAULT)):
            return None
        if self._flange_from_frame_mm is None:
            self._flange_from_frame_mm = vector3(flange_from_marker(self.workcell).translation_mm)
        flange = self.workcell.master.calibrated.forward(
            known.joints_rad
        )  # in plain floats: twice in each frame
        return flange.apply(self._flange_from_frame_mm)

    def _raise_alarm(self, why: str, *, stop: bool) -> None:
        self._stop_wanted |= stop
        if self._is_stopping:  # reported when the arm rests
            return
        if stop:
            self._begin_stop()
        self.tell(f"{why} during {self.what}" + (": the arm is stopped" if stop else ""))

    def _stop_again(self) -> None:
        """Retry a failed stop, for example after a timeout, while the arm may still be moving."""
        if not self._stop_wanted or self._is_stopping:
            return
        if any(arm.arm.observe().state is Lifecycle.ACTIVE for arm in self.workcell.arms.values()):
            self._begin_stop()

    @property
    def _is_stopping(self) -> bool:
        return self._stopping is not None and self._stopping.is_alive()

    def _begin_stop(self) -> None:
        # Stopping waits for the arm to rest; in lock-step it cannot rest while no frame is read.
        stopping = threading.Thread(target=self.workcell.stop, name="stop by the patient watch", daemon=True)
        stopping.start()
        self._stopping = stopping

    def _report_silence(self, why: str) -> None:
        """Report a silent tracker once, immediately, since the unwatched motion may still take long.

        An assistant on its way into the guide is stopped: nobody would notice a push.
        """
        if not self._silence_reported:
            self._silence_reported = True
            self.tell(f"the head is not watched: {why}")
            if self._leads_instrument and self.motion == MotionKind.INSERT:
                self._disturb(f"the assistant is not watched: {why}")

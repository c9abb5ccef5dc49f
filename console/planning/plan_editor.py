"""Plan editor shared by all pages: the CT, the current draft, its assessment, and its file."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from console.changes import ChangeNotifier
from console.planning.draft import Draft, DraftHistory, UnsavedFile
from console.planning.fused_series import FusedSeries
from console.planning.judging import Judgement, judge
from console.planning.theatre_choice import TheatreChoice
from console.scene.head_surface import encode_stl, head_surface
from procedures.imaging import Candidate, PatientIdentity, Volume, likeliest_first, localize, localize_picks
from procedures.imaging.ct_surface import CtSurface, find_skin
from procedures.imaging.errors import MarkerCountWrong, PickRefused
from procedures.imaging.localization import DIAMETER_MM
from procedures.imaging.markers import Marker, ScanDeformation
from procedures.planning.errors import PLAN_NOT_SAVED, WRONG_SERIES, PlanInUse, PlanMistakes, UnsavedChanges
from procedures.planning.head_in_ct import sample_hu
from procedures.planning.plan_file import parse_plan, read_plan, seal_plan, write_plan
from procedures.planning.plan_lock import PlannerLock, find_planner, is_plan_in_use, plan_replacement
from procedures.planning.plan_model import FEWEST_MARKERS, MOST_MARKERS, Plan
from procedures.planning.theatre_arm import TheatreArm
from procedures.strategies.trajectory import Point
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, InputRefused, read_bounded
from ronna_hw.devices.errors import PersonNotNamed
from ronna_hw.devices.lifecycle import require_person
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JOURNAL_FILE

REFUSED = "refused"
NAME_NEEDED = "Enter your name next to Save."
KEEPING_S = 0.3  # host time between writes of unsaved changes
AGAIN_S = 0.5  # host time between checks whether the plan has become free


class PlanEditor(ChangeNotifier):
    """Editor of one draft. Announces every change and has the draft checked again in the background."""

    def __init__(
        self,
        volume: Volume,
        plan: Path,
        choice: TheatreChoice | None = None,
        patient: PatientIdentity | None = None,
        fused: FusedSeries | None = None,
    ) -> None:
        super().__init__()
        self.volume = volume
        self.fused = fused
        self.patient = patient  # for the page's head alone
        self.choice = choice
        self.theatre: TheatreArm | None = None
        self.theatre_name = self.head_words = ""  # of its file, and where the head is taken to be
        self.file = plan
        self.candidates: Sequence[Candidate] = ()
        self.searching = True
        self.head = b""
        self.problem: RonnaError | None = None  # why the file is left unchanged
        self.notice: RonnaError | None = None  # of the CT or the plan, to be read first
        self.storage_problem: RonnaError | None = None  # why a crash would lose unsaved changes
        self._markers: tuple[Marker, ...] = ()  # those that were found
        self._deformation: ScanDeformation | None = None  # that they show
        self._skin: CtSurface | None = None  # found once a plan registers on it
        self._change_event, self._keep_event, self._saving = asyncio.Event(), asyncio.Event(), asyncio.Lock()
        self._check_event = asyncio.Event()
        self._unsaved = UnsavedFile(plan, volume.series_instance_uid)
        self._lock = PlannerLock(plan)
        self._has_begun = False
        self._read()
        self.problem = self.problem or _refuse_in_run_folder(plan)
        self.begin_editing()
        self.judged = Judgement(self.draft)

    @property
    def read_only(self) -> RonnaError | None:
        """Reason why the draft is read-only, or None if it is editable."""
        if self._has_begun and not self._saving.locked():  # our own save is not a case
            return self._block_reason()
        return None if self._has_begun else self._blocked_by

    def begin_editing(self) -> bool:
        """Acquire the plan for editing, then adopt changes saved by others and unsaved changes.

        False while a case or another planner has it; call again later.
        """
        if not self._has_begun:
            self._blocked_by = self._block_reason()
            if self._blocked_by is not None:
                return False
            self._has_begun = True
            if not self._is_unchanged():
                self._read()
            if self.problem is None:
                self._restore_unsaved()
        return True

    def close(self) -> Path | None:
        """Release the plan for other planners. Return the file of unsaved changes, if any."""
        kept = self.store_draft()
        self._lock.leave()
        return kept

    def _block_reason(self) -> RonnaError | None:
        if self.problem is not None:
            return self.problem
        name = self.file.name
        if not self._lock.take():
            return PlanInUse(f"{name} is open in another planner ({find_planner(self.file)}): read-only")
        if is_plan_in_use(self.file):
            return PlanInUse(f"a case is running on {name}: read-only")
        return None

    def hu_at(self, place_mm: Point) -> str:
        hu = sample_hu(self.volume, [place_mm])
        return f"{hu[0]:.0f} HU" if len(hu) else "outside the scan"

    # The file

    def _read(self) -> None:
        draft = self._read_draft() or Draft(self.volume.patient_position, FEWEST_MARKERS)
        self.history = DraftHistory(draft)
        self._saved: Draft | None = draft if self._on_disk else None
        self._adopt_markers(self._markers, self._deformation)

    def _is_unchanged(self) -> bool:
        try:
            return _digest(self.file) == self._on_disk
        except OSError:  # reading it reports what is wrong
            return False

    def _read_draft(self) -> Draft | None:
        """Read the draft from the plan file, or return None if there is no usable plan."""
        try:
            self._on_disk = _digest(self.file)
            if not self._on_disk:
                return None
            plan = read_plan(self.file, sealed_only=False)
            if plan.series_instance_uid != self.volume.series_instance_uid:
                raise WRONG_SERIES(
                    f"{self.file.name} belongs to another CT series and is left unchanged",
                    expected=self.volume.series_instance_uid,
                    got=plan.series_instance_uid,
                )
            draft = Draft.of(plan)
            if self.fused is not None:
                self.fused.require_own_targets(draft)
        except (RonnaError, OSError) as problem:
            self.problem = problem if isinstance(problem, RonnaError) else PlanMistakes(str(problem.strerror))
            return None
        try:
            read_plan(self.file)
        except RonnaError as altered:
            self.notice = altered
        return draft

    def _restore_unsaved(self) -> None:
        try:
            drawn = self._unsaved.restore(self._on_disk, self.draft)
            if drawn is not None and self.fused is not None:
                self.fused.require_own_targets(drawn)
        except UnsavedChanges as aside:
            self.notice = self.notice or aside
            return
        except RonnaError as other_fusion:
            self.problem = other_fusion
            return
        if drawn is not None and drawn != self.draft:
            self.history.change(drawn)
            self.notice = UnsavedChanges("unsaved changes from the last session were restored")

    def store_draft(self) -> Path | None:
        """Store unsaved changes next to the plan. Return the file, or None if nothing was stored."""
        self.storage_problem = None
        if not self._has_begun:
            return None
        saved, drawn = self._saved, self.draft.without_ct()
        unsaved = self.history.can_undo if saved is None else drawn != saved.without_ct()
        try:
            if self.problem is None and unsaved:
                self._unsaved.store_draft(self.draft, self._on_disk)
                return self._unsaved.path
            if self.problem is None:
                self._unsaved.forget()
        except OSError as error:
            why = f"unsaved changes cannot be stored next to the plan: {error.strerror}"
            self.storage_problem = PLAN_NOT_SAVED(why)
        return None

    @property
    def is_saved(self) -> bool:
        return self._saved is not None and self._saved.content("") == self.draft.content("")

    async def save(self, author: str) -> None:
        """Seal and write the plan. Raises PLAN-002, PLAN-004, PLAN-005, PLAN-025, PLAN-026."""
        if self.read_only is not None:
            raise self.read_only
        name = " ".join(author.split())
        if not name:
            raise PlanMistakes("the plan needs an author", action=NAME_NEEDED)
        try:
            require_person(name)
        except PersonNotNamed as problem:
            raise PlanMistakes(problem.summary, action=NAME_NEEDED) from problem
        draft = self.draft
        missing = [item.identifier for item in draft.ways if item.ends is None]
        if missing:
            raise PlanMistakes(
                f"entry or target of {' and '.join(missing)} is not set",
                action="Set both, or remove the trajectory.",
            )
        plan = parse_plan(draft.content(self.volume.series_instance_uid), self.file.name)
        async with self._saving:
            await asyncio.to_thread(self._write, plan, name, draft)
        self._saved, self.notice = draft, None
        self.altered()

    def _write(self, plan: Plan, author: str, draft: Draft) -> None:
        plan = seal_plan(plan, author, self.volume)
        spheres = (
            f"sphere {number}: {', '.join(f'{value:.2f}' for value in item.centre_mm)}"
            for number, item in enumerate(draft.markers, start=1)
        )
        with plan_replacement(self.file):  # a case that has begun since wins
            if self._was_changed_by_others():
                raise PLAN_NOT_SAVED(
                    f"{self.file.name} was changed by another program since it was opened",
                    action="Nothing was overwritten. Move that file away, then save again.",
                )
            notes = ("Saved by the planner. Coordinates: LPS of the series, mm.", *spheres)
            write_plan(self.file, plan, notes)
            self._on_disk = _digest(self.file)

    def _was_changed_by_others(self) -> bool:
        try:
            return _digest(self.file) not in ("", self._on_disk)
        except OSError as error:
            raise PLAN_NOT_SAVED(f"cannot read {self.file.name}: {error.strerror}") from error

    # The draft

    @property
    def draft(self) -> Draft:
        return self.history.now

    def change(self, draft: Draft, *, continues: bool = False) -> None:
        """Apply a change to the draft (see `DraftHistory.change`). Refused while the draft is read-only."""
        if self.read_only is None:
            self.history.change(draft, continues=continues)
        self.altered()

    def undo(self) -> None:
        """Undo the last change. Refused while the draft is read-only."""
        if self.read_only is None:
            self.history.undo()
        self.altered()

    def redo(self) -> None:
        """Redo the last undone change. Refused while the draft is read-only."""
        if self.read_only is None:
            self.history.redo()
        self.altered()

    def altered(self) -> None:
        """Trigger checking and storage of the draft, and notify the pages."""
        self._change_event.set()
        self._keep_event.set()
        self.notify()

    async def add_marker(self, place_mm: Point) -> None:
        """Measure the sphere at a position and add it as a marker. Raises CT-019."""
        found = await asyncio.to_thread(localize_picks, self.volume, [place_mm])
        (marker,) = found.markers
        deformation, known_mm = found.deformation, [item.centre_mm for item in self.draft.markers]
        if known_mm:  # together they show more of the scan
            with contextlib.suppress(RonnaError):
                together = await asyncio.to_thread(localize_picks, self.volume, [*known_mm, marker.centre_mm])
                deformation = together.deformation
        for number, item in enumerate(self.draft.markers, start=1):
            if float(np.linalg.norm(np.subtract(item.centre_mm, marker.centre_mm))) < DIAMETER_MM:
                raise PickRefused(f"this is sphere {number}")
        self.change(replace(self.draft, markers=(*self.draft.markers, marker), deformation=deformation))

    def reject_marker(self, number: int) -> None:
        """Remove the sphere with this number (from 1) from the markers."""
        remaining = tuple(item for k, item in enumerate(self.draft.markers, start=1) if k != number)
        self.change(replace(self.draft, markers=remaining))

    async def choose_theatre(self, name: str) -> None:
        """Read the arm of a listed theatre file and check the plan with it from now on.

        Raises the errors of `TheatreChoice.load`; the arm so far is then kept.
        """
        if self.choice is not None:
            loaded = await asyncio.to_thread(self.choice.load, name, self.volume.series_instance_uid)
            self.adopt_theatre(*loaded)

    def adopt_theatre(self, name: str, theatre: TheatreArm, head_words: str) -> None:
        """Check the plan with an arm from now on."""
        self.theatre, self.theatre_name, self.head_words = theatre, name, head_words
        self.judged = Judgement(self.draft, is_arm_known=True)
        self.altered()

    # Background work

    async def work(self) -> None:
        """Run all background work: head surface, sphere detection, assessment and storage. Never returns."""
        await asyncio.gather(
            self._prepare(), self._judge_all(), self._check_all(), self._keep_all(), self._await_the_plan()
        )

    async def _await_the_plan(self) -> None:
        while self.problem is None and not self._has_begun:
            await asyncio.sleep(AGAIN_S)
            if self.begin_editing():
                self.altered()

    async def _prepare(self) -> None:
        try:
            self.head = await asyncio.to_thread(lambda: encode_stl(*head_surface(self.volume)))
            self.notify()
        except ValueError:  # nothing but air: the search for spheres reports it
            pass
        try:
            found = await asyncio.to_thread(localize, self.volume)
            self.candidates = likeliest_first(found.candidates)
            self._adopt_markers(found.markers, found.deformation)
        except MarkerCountWrong as wrong_count:
            self.candidates, self.notice = likeliest_first(wrong_count.candidates), self.notice or wrong_count
        except RonnaError as problem:
            self.notice = self.notice or problem
        self.searching = False
        self.altered()

    def _adopt_markers(self, markers: tuple[Marker, ...], deformation: ScanDeformation | None) -> None:
        """Add the spheres to every draft in the history, so that undo does not lose them."""
        self._markers, self._deformation = markers, deformation
        count = len(markers)
        is_new = not self._on_disk and FEWEST_MARKERS <= count <= MOST_MARKERS

        def with_markers(draft: Draft) -> Draft:
            implanted = count if is_new else draft.implanted
            return replace(draft, markers=markers, deformation=deformation, implanted=implanted)

        self.history.replace_all(with_markers)
        if self._saved is not None:
            self._saved = with_markers(self._saved)

    async def _judge_all(self) -> None:
        while True:
            await self._change_event.wait()
            self._change_event.clear()
            theatre = self.theatre
            judged = await self._judge_draft(self.draft, thorough=False)
            if theatre is self.theatre:  # otherwise it has changed, and the draft is judged again
                self._announce(judged)
            if not self.judged.thorough and not self._change_event.is_set():
                self._check_event.set()

    async def _check_all(self) -> None:
        """Run the thorough check, which is slow, and discard the result if the draft has since changed."""
        while True:
            await self._check_event.wait()
            self._check_event.clear()
            theatre = self.theatre
            judged = await self._judge_draft(self.draft, thorough=True)
            if judged.draft is self.draft and theatre is self.theatre:
                self._announce(judged)

    async def _judge_draft(self, draft: Draft, *, thorough: bool) -> Judgement:
        return await asyncio.to_thread(self._judge_now, draft, thorough=thorough)

    def _judge_now(self, draft: Draft, *, thorough: bool) -> Judgement:
        if draft.fiducials.has_skin and self._skin is None:
            with contextlib.suppress(RonnaError):  # a CT without a head is refused elsewhere
                self._skin = find_skin(self.volume)
        skin = self._skin if draft.fiducials.has_skin else None
        return judge(draft, self.volume, self.theatre, thorough=thorough, skin=skin)

    def _announce(self, judged: Judgement) -> None:
        self.judged = judged
        self.notify()

    async def _keep_all(self) -> None:
        while True:
            await self._keep_event.wait()
            self._keep_event.clear()
            await asyncio.to_thread(self.store_draft)
            await asyncio.sleep(KEEPING_S)


def _digest(path: Path) -> str:
    """Return a file's hash, empty if missing or `REFUSED` if it cannot be a plan. Raises OSError."""
    try:
        return hashlib.sha256(read_bounded(path, LARGEST_TOML_BYTES)).hexdigest()
    except FileNotFoundError:
        return ""
    except InputRefused:  # reading the plan says why
        return REFUSED


def _refuse_in_run_folder(plan: Path) -> PlanInUse | None:
    """Return an error if the plan is inside a run folder, where any write counts as tampering."""
    run = next((item for item in plan.resolve().parents if (item / JOURNAL_FILE).exists()), None)
    if run is None:
        return None
    return PlanInUse(
        f"{plan.name} belongs to run {run.name}, which must not change",
        action="You can view it here; to change it, have a copy opened in the planner.",
    )

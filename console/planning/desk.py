"""One plan for all pages: the CT, the draft as it stands, what is said of it, and the file it is saved in."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from console.bell import Bell
from console.pictures.head import head_surface, stl
from console.planning.draft import Draft, History
from console.planning.judging import Judged, judge
from procedures.imaging import Candidate, Volume, likeliest_first, localize, localize_picks
from procedures.imaging.errors import MarkerCountWrong, PickRefused
from procedures.imaging.localization import DIAMETER_MM
from procedures.imaging.markers import Marker
from procedures.planning.errors import PlanInUse, PlanMistakes, PlanNotSaved, WrongSeries
from procedures.planning.plan import FEWEST_MARKERS, MOST_MARKERS, Plan
from procedures.planning.plan_file import parse_plan, read_plan, write_plan
from procedures.planning.plan_lock import plan_in_use
from procedures.planning.seal import sealed
from procedures.planning.theatre_arm import TheatreArm
from procedures.planning.tissue import sampled_hu
from procedures.strategies.trajectory import Point
from ronna_hw.errors import RonnaError


class PlanDesk(Bell):
    """Holds one draft. Whatever changes it says so; it is judged again in threads beside the pages."""

    def __init__(self, volume: Volume, plan: Path, theatre: TheatreArm | None) -> None:
        super().__init__()
        self.volume = volume
        self.theatre = theatre
        self.file = plan
        self.candidates: Sequence[Candidate] = ()
        self.searching = True
        self.head = b""
        self.problem: RonnaError | None = None  # why the file is left as it is
        self.notice: RonnaError | None = None  # of the CT or the plan, to be read before anything else
        self._on_disk = ""
        draft = self._opened() or Draft(volume.patient_position, FEWEST_MARKERS)
        self.history = History(draft)
        self._saved: Draft | None = draft if self._on_disk else None
        self.judged = Judged(draft)
        self._changed = asyncio.Event()

    @property
    def read_only(self) -> RonnaError | None:
        """Why nothing can be changed."""
        if self.problem is not None:
            return self.problem
        if plan_in_use(self.file):
            return PlanInUse(f"a case runs on {self.file.name}: it can only be looked at")
        return None

    def hu_at(self, place_mm: Point) -> str:
        """What the CT shows there, in words."""
        hu = sampled_hu(self.volume, [place_mm])
        return f"{hu[0]:.0f} HU" if len(hu) else "outside the scan"

    # The file

    def _opened(self) -> Draft | None:
        """The draft of the plan file, if there is one that can be used."""
        if not self.file.exists():
            return None
        try:
            self._on_disk = _digest(self.file)
            plan = read_plan(self.file, sealed_only=False)
            if plan.series_instance_uid != self.volume.series_instance_uid:
                raise WrongSeries(
                    f"{self.file.name} belongs to another CT series and is left as it is",
                    expected=self.volume.series_instance_uid,
                    got=plan.series_instance_uid,
                )
        except (RonnaError, OSError) as problem:
            self.problem = problem if isinstance(problem, RonnaError) else PlanMistakes(str(problem.strerror))
            return None
        try:
            read_plan(self.file)
        except RonnaError as altered:
            self.notice = altered
        return Draft.of(plan)

    @property
    def is_saved(self) -> bool:
        """Whether the file holds the draft as it stands."""
        return self._saved is not None and self._saved.content("") == self.draft.content("")

    async def save(self, author: str) -> None:
        """Write the plan, sealed. Raises PLAN-002, PLAN-004, PLAN-005, PLAN-025."""
        if self.read_only is not None:
            raise self.read_only
        name = " ".join(author.split())
        if not name:
            raise PlanMistakes("a plan is saved by somebody", action="Type your name beside Save.")
        draft = self.draft
        missing = [one.identifier for one in draft.ways if one.ends is None]
        if missing:
            raise PlanMistakes(
                f"entry or target of {' and '.join(missing)} is not chosen",
                action="Choose both, or take the trajectory away.",
            )
        plan = parse_plan(draft.content(self.volume.series_instance_uid), self.file.name)
        if self.file.exists() and _digest(self.file) != self._on_disk:
            raise PlanNotSaved(
                f"{self.file.name} was changed by another program since it was opened",
                action="Nothing was overwritten. Move that file away, then save again.",
            )
        await asyncio.to_thread(self._write, sealed(plan, name, self.volume), draft)
        self._saved, self.notice = draft, None
        self.tell()

    def _write(self, plan: Plan, draft: Draft) -> None:
        spheres = (
            f"sphere {number}: {', '.join(f'{value:.2f}' for value in one.centre_mm)}"
            for number, one in enumerate(draft.markers, start=1)
        )
        write_plan(self.file, plan, ("Saved by the planner. Coordinates are LPS mm of the series.", *spheres))
        self._on_disk = _digest(self.file)

    # The draft

    @property
    def draft(self) -> Draft:
        """As it stands."""
        return self.history.now

    def change(self, draft: Draft, *, goes_on: bool = False) -> None:
        """Take a change of the draft; see `History.change`. Refused while it can only be looked at."""
        if self.read_only is not None:
            return
        self.history.change(draft, goes_on=goes_on)
        self.altered()

    def undo(self) -> None:
        """Take the last change back. Refused while the draft can only be looked at."""
        if self.read_only is None:
            self.history.undo()
            self.altered()

    def redo(self) -> None:
        """Make it again; as `undo`."""
        if self.read_only is None:
            self.history.redo()
            self.altered()

    def altered(self) -> None:
        """Have the draft judged, and pages told."""
        self._changed.set()
        self.tell()

    async def add_marker(self, place_mm: Point) -> None:
        """Measure the sphere at a place, and count it as a marker. Raises CT-019."""
        found = await asyncio.to_thread(localize_picks, self.volume, [place_mm])
        (marker,) = found.markers
        for number, one in enumerate(self.draft.markers, start=1):
            if float(np.linalg.norm(one.centre_mm - marker.centre_mm)) < DIAMETER_MM:
                raise PickRefused(f"this is sphere {number}")
        self.change(replace(self.draft, markers=(*self.draft.markers, marker)))

    def reject_marker(self, number: int) -> None:
        """Count a sphere (from 1) as a marker no longer."""
        left = tuple(one for k, one in enumerate(self.draft.markers, start=1) if k != number)
        self.change(replace(self.draft, markers=left))

    # The work beside the pages

    async def work(self) -> None:
        """Make the head, look for the spheres, and judge the draft whenever it changes; never ends."""
        await asyncio.gather(self._prepare(), self._judge_all())

    async def _prepare(self) -> None:
        try:
            self.head = await asyncio.to_thread(lambda: stl(*head_surface(self.volume)))
            self.tell()
        except ValueError:  # nothing but air: the search for spheres says so
            pass
        try:
            found = await asyncio.to_thread(localize, self.volume)
            self.candidates = likeliest_first(found.candidates)
            self._found(found.markers)
        except MarkerCountWrong as none:
            self.candidates, self.notice = likeliest_first(none.candidates), self.notice or none
        except RonnaError as problem:
            self.notice = self.notice or problem
        self.searching = False
        self.altered()

    def _found(self, markers: tuple[Marker, ...]) -> None:
        """Every draft so far gets the spheres: undoing a step does not lose them."""
        count = len(markers)
        is_new = not self._on_disk and FEWEST_MARKERS <= count <= MOST_MARKERS

        def with_markers(draft: Draft) -> Draft:
            return replace(draft, markers=markers, implanted=count if is_new else draft.implanted)

        self.history.replace_all(with_markers)
        if self._saved is not None:
            self._saved = with_markers(self._saved)

    async def _judge_all(self) -> None:
        while True:
            await self._changed.wait()
            self._changed.clear()
            draft = self.draft
            for thorough in (False, True):
                if self._changed.is_set() or (thorough and self.judged.thorough):
                    break
                judged = await asyncio.to_thread(judge, draft, self.volume, self.theatre, thorough=thorough)
                self.judged = judged
                self.tell()


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()

"""Panel of structures for trajectories to avoid, drawn or imported, with margins and distances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui
from pydantic import ValidationError

from console.panels.elements import group, html, small_button
from console.panels.html import head_row, table_of, tag, text
from console.planning.draft import Draft
from console.planning.fields import NumberField
from console.planning.judging import mark_outdated
from console.planning.plan_editor import PlanEditor
from console.planning.slices import PageView
from procedures.imaging.picks import LARGEST_FILE_BYTES
from procedures.imaging.volume import VoxelGeometry
from procedures.planning.errors import STRUCTURE_UNREADABLE, PlanMistakes, raise_together
from procedures.planning.plan_file import find_structure_unit_mistakes
from procedures.planning.plan_model import MOST_POINTS_TOGETHER, MOST_STRUCTURES, Structure
from procedures.planning.structures import StructureDistance, build_structure, read_structure
from procedures.strategies.trajectory import Point
from ronna_hw.errors import RonnaError
from ronna_hw.mistakes import describe_mistakes

STEP_MM = 1.0  # between two points of a stroke
USUAL_MARGIN_MM = 3.0  # to a vessel
PICK_JS = "() => getElement({number}).$refs.qRef.pickFiles()"  # only a person's click opens the dialog
ShowProblem = Callable[[RonnaError | None], None]


class StructurePanel:
    """Panel of the structures. Strokes and files are added to the structure named in its field."""

    def __init__(
        self,
        editor: PlanEditor,
        page_view: PageView,
        go: Callable[[Point], None],
        show_problem: ShowProblem,
        *,
        may_edit: bool,
    ) -> None:
        self._editor, self._page_view, self._may_edit = editor, page_view, may_edit
        self._go, self._show_problem = go, show_problem
        self._last_mm: Point | None = None
        self._names: tuple[str, ...] | None = None
        self.margins: dict[str, NumberField] = {}
        with ui.element("section").classes("card structures").props('aria-label="Structures"'):
            html("<h2>Structures to avoid</h2>")
            if may_edit:
                self._build_tools()
            self._list = ui.element("div").classes("rows")
            self._distances = html()

    def _build_tools(self) -> None:
        with ui.element("div").classes("numbers"):
            self._name = ui.input("Structure", value="S1").classes("name")
            self._name.props('dense outlined maxlength=32 autocomplete=off data-field="structure"')
            upload = ui.upload(on_upload=self._on_import, auto_upload=True, max_file_size=LARGEST_FILE_BYTES)
            upload.classes("unseen").props('accept=".csv,.json" tabindex=-1 aria-hidden=true')
            upload.on_rejected(self._on_rejected)
            button = ui.button("Import points…", color=None).classes("plain small")
            button.props('no-caps unelevated data-do=import aria-label="import points of a structure"')
            button.on("click", js_handler=PICK_JS.format(number=upload.id))

    def draw(self, place_mm: Point, *, continues: bool) -> None:
        """Start or continue a stroke in an image."""
        start_mm = self._last_mm if continues else None
        self._last_mm = place_mm
        self._change(
            lambda draft: draw_stroke(draft, self._chosen_name, place_mm, start_mm), continues=continues
        )

    def show(self) -> None:
        judged, structures = self._editor.judged, self._editor.draft.structures
        names = tuple(item.name for item in structures)
        if names != self._names:
            self._names = names
            self._list.clear()
            self.margins = {}
            with self._list:
                for name in names:
                    self._build(name)
        for item in structures:
            self.margins[item.name].show(item.margin_mm)
        table = _distance_table(structures, judged.distances)
        self._distances.set_content(mark_outdated(table, judged, self._editor.draft))

    @property
    def _chosen_name(self) -> str:
        return " ".join(str(self._name.value or "").split())

    def _build(self, name: str) -> None:
        with group("sphere", f"structure {name}"):
            small_button(name, partial(self._look_at, name), f"crosshair to {name}")
            self.margins[name] = NumberField("margin mm", f"margin of {name}", partial(self._set, name))
            self.margins[name].enable(self._may_edit)
            if self._may_edit:
                small_button("−", partial(self._remove, name), f"remove {name}")

    def _look_at(self, name: str) -> None:
        """Move the crosshair to the structure, at its closest point to the current trajectory if known."""
        near = {item.trajectory: item for item in self._editor.judged.distances if item.structure == name}
        structure = self._editor.draft.structure(name)
        if self._page_view.way in near:
            self._go(near[self._page_view.way].nearest_mm)
        elif structure is not None:
            self._go(structure.points_mm[0])
        if self._may_edit:
            self._name.set_value(name)

    def _set(self, name: str, margin_mm: float) -> None:
        self._change(lambda draft: set_margin(draft, name, margin_mm))

    def _remove(self, name: str) -> None:
        self._change(lambda draft: draft.without_structure(name))

    async def _on_import(self, event: Any) -> None:
        content = await event.file.read()
        event.sender.reset()
        geometry = self._editor.volume.geometry
        if self._change(
            lambda draft: import_structure(draft, self._chosen_name, content, event.file.name, geometry)
        ):
            self._name.set_value(free_name(self._editor.draft))

    def _on_rejected(self) -> None:
        self._show_problem(STRUCTURE_UNREADABLE("the file is too large", limit=f"{LARGEST_FILE_BYTES} bytes"))

    def _change(self, change: Callable[[Draft], Draft], *, continues: bool = False) -> bool:
        try:
            self._editor.change(change(self._editor.draft), continues=continues)
        except RonnaError as refusal:
            self._show_problem(refusal)
            return False
        self._show_problem(None)
        return True


def _distance_table(structures: Iterable[Structure], distances: Iterable[StructureDistance]) -> str:
    """Tabulate distances, with a row per structure and a column per trajectory."""
    known = {(item.structure, item.trajectory): item for item in distances}
    ways = tuple(dict.fromkeys(trajectory for _, trajectory in known))
    rows = "".join(
        tag(
            "tr",
            tag("th", text(item.name), scope="row")
            + "".join(_distance_cell(known.get((item.name, way))) for way in ways),
        )
        for item in structures
    )
    if not rows or not ways:
        return ""
    return table_of(head_row("distance, mm", *ways), rows)


def _distance_cell(distance: StructureDistance | None) -> str:
    if distance is None:
        return tag("td", "–")
    words = f"{distance.distance_mm:.1f}" + ("" if distance.is_kept else " — too near")
    return tag(
        "td",
        words,
        class_="num" if distance.is_kept else "num bad",
        data_distance=f"{distance.structure}/{distance.trajectory}",
        data_mm=f"{distance.distance_mm:.3f}",
    )


def draw_stroke(draft: Draft, name: str, place_mm: Point, start_mm: Point | None) -> Draft:
    """Add a stroke from `start_mm`, or a first point, to the named structure. Raises PLAN-002."""
    steps = 1 if start_mm is None else max(1, math.ceil(math.dist(start_mm, place_mm) / STEP_MM))
    points = np.linspace(place_mm if start_mm is None else start_mm, place_mm, steps + 1)[1:]
    known, within_mm, margin_mm = draft.structure(name), 0.0, USUAL_MARGIN_MM
    if known is not None:
        points = np.concatenate([np.array(known.points_mm), points])
        within_mm, margin_mm = known.within_mm, known.margin_mm
    with _mistakes_as_refusals():
        return _require_within_limits(
            draft.with_structure(build_structure(name, margin_mm, points, within_mm))
        )


def import_structure(
    draft: Draft, name: str, content: bytes, file_name: str, geometry: VoxelGeometry
) -> Draft:
    """Add a structure from a file of points. Raises PLAN-002, PLAN-006, PLAN-028."""
    if draft.structure(name) is not None:
        raise PlanMistakes(f"a structure named {name} already exists", action="Enter another name first.")
    with _mistakes_as_refusals():
        return _require_within_limits(
            draft.with_structure(read_structure(content, file_name, name, USUAL_MARGIN_MM, geometry))
        )


def set_margin(draft: Draft, name: str, margin_mm: float) -> Draft:
    """Set the margin of a structure. Raises PLAN-002."""
    known = draft.structure(name)
    if known is None:
        return draft
    with _mistakes_as_refusals():
        changed = Structure.model_validate(known.model_copy(update={"margin_mm": margin_mm}).model_dump())
    raise_together(find_structure_unit_mistakes(changed), "the structure")
    return draft.with_structure(changed)


def free_name(draft: Draft) -> str:
    """Return an unused name for a new structure."""
    return next(name for k in range(1, MOST_STRUCTURES + 2) if draft.structure(name := f"S{k}") is None)


def _require_within_limits(draft: Draft) -> Draft:
    if len(draft.structures) > MOST_STRUCTURES:
        raise PlanMistakes("too many structures", limit=f"{MOST_STRUCTURES} structures")
    points = sum(len(item.points_mm) for item in draft.structures)
    if points > MOST_POINTS_TOGETHER:
        raise PlanMistakes(
            "too many structure points", limit=f"{MOST_POINTS_TOGETHER} points", got=f"{points}"
        )
    return draft


@contextmanager
def _mistakes_as_refusals() -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        raise PlanMistakes("; ".join(describe_mistakes(error))) from error

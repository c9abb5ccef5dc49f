"""Structures that the trajectories avoid: drawn in the images or imported, and how close each comes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from nicegui import ui

from console.panels.html import table_of, tag, text
from console.planning.avoided import drawn, free_name, imported, with_margin
from console.planning.desk import PlanDesk
from console.planning.draft import Draft
from console.planning.fields import NumberField
from console.planning.look import Look
from console.planning.verdict import marked
from procedures.imaging.pick_files import LARGEST_FILE_BYTES
from procedures.planning.errors import StructureUnreadable
from procedures.planning.plan_model import Structure
from procedures.planning.structures import StructureDistance
from procedures.strategies.trajectory import Point
from ronna_hw.errors import RonnaError

PICK_JS = "() => getElement({number}).$refs.qRef.pickFiles()"  # only a person's click opens the dialog
Say = Callable[[RonnaError | None], None]


class StructurePanel:
    """Strokes and files are added to the structure named in the field."""

    def __init__(
        self, desk: PlanDesk, look: Look, go: Callable[[Point], None], say: Say, *, may_edit: bool
    ) -> None:
        self._desk, self._look, self._go, self._say, self._may_edit = desk, look, go, say, may_edit
        self._last_mm: Point | None = None
        self._names: tuple[str, ...] | None = None
        self.margins: dict[str, NumberField] = {}
        with ui.element("section").classes("card structures").props('aria-label="Structures"'):
            ui.html("<h2>Structures to avoid</h2>", sanitize=False)
            if may_edit:
                self._build_tools()
            self._list = ui.element("div").classes("rows")
            self._distances = ui.html("", sanitize=False)

    def _build_tools(self) -> None:
        with ui.element("div").classes("numbers"):
            self._name = ui.input("Structure", value="S1").classes("name")
            self._name.props('dense outlined maxlength=32 autocomplete=off data-field="structure"')
            upload = ui.upload(on_upload=self._imported, auto_upload=True, max_file_size=LARGEST_FILE_BYTES)
            upload.classes("unseen").props('accept=".csv,.json" tabindex=-1 aria-hidden=true')
            upload.on_rejected(self._too_large)
            button = ui.button("Import points…", color=None).classes("plain small")
            button.props('no-caps unelevated data-do=import aria-label="import points of a structure"')
            button.on("click", js_handler=PICK_JS.format(number=upload.id))

    def draw(self, place_mm: Point, *, goes_on: bool) -> None:
        """A stroke in an image begins, or continues."""
        start_mm = self._last_mm if goes_on else None
        self._last_mm = place_mm
        self._change(lambda draft: drawn(draft, self._chosen, place_mm, start_mm), goes_on=goes_on)

    def show(self) -> None:
        """Show the current draft and the known distances."""
        judged, structures = self._desk.judged, self._desk.draft.structures
        names = tuple(one.name for one in structures)
        if names != self._names:
            self._names = names
            self._list.clear()
            self.margins = {}
            with self._list:
                for name in names:
                    self._build(name)
        for one in structures:
            self.margins[one.name].show(one.margin_mm)
        table = _table(structures, judged.distances)
        self._distances.set_content(marked(table, judged, self._desk.draft))

    @property
    def _chosen(self) -> str:
        return " ".join(str(self._name.value or "").split())

    def _build(self, name: str) -> None:
        with ui.element("div").classes("sphere").props(f'role=group aria-label="structure {name}"'):
            self._button(name, partial(self._look_at, name), f"crosshair to {name}")
            self.margins[name] = NumberField("margin mm", f"margin of {name}", partial(self._set, name))
            self.margins[name].enable(self._may_edit)
            if self._may_edit:
                self._button("−", partial(self._remove, name), f"remove {name}")

    def _button(self, words: str, act: Callable[[], object], name: str) -> None:
        ui.button(words, on_click=act, color=None).classes("plain small").props(
            f'no-caps unelevated aria-label="{name}"'
        )

    def _look_at(self, name: str) -> None:
        """Go where the current trajectory comes closest to it; without one, to its first point."""
        near = {one.trajectory: one for one in self._desk.judged.distances if one.structure == name}
        structure = self._desk.draft.structure(name)
        if self._look.way in near:
            self._go(near[self._look.way].nearest_mm)
        elif structure is not None:
            self._go(structure.points_mm[0])
        if self._may_edit:
            self._name.set_value(name)

    def _set(self, name: str, margin_mm: float) -> None:
        self._change(lambda draft: with_margin(draft, name, margin_mm))

    def _remove(self, name: str) -> None:
        self._change(lambda draft: draft.without_structure(name))

    async def _imported(self, event: Any) -> None:
        content = await event.file.read()
        event.sender.reset()
        geometry = self._desk.volume.geometry
        if self._change(lambda draft: imported(draft, self._chosen, content, event.file.name, geometry)):
            self._name.set_value(free_name(self._desk.draft))

    def _too_large(self) -> None:
        self._say(StructureUnreadable("the file is too large", limit=f"{LARGEST_FILE_BYTES} bytes"))

    def _change(self, change: Callable[[Draft], Draft], *, goes_on: bool = False) -> bool:
        try:
            self._desk.change(change(self._desk.draft), goes_on=goes_on)
        except RonnaError as refused:
            self._say(refused)
            return False
        self._say(None)
        return True


def _table(structures: Iterable[Structure], distances: Iterable[StructureDistance]) -> str:
    """One row per structure, one column per trajectory."""
    known = {(one.structure, one.trajectory): one for one in distances}
    ways = tuple(dict.fromkeys(trajectory for _, trajectory in known))
    rows = "".join(
        tag(
            "tr",
            tag("th", text(one.name), scope="row")
            + "".join(_cell(known.get((one.name, way))) for way in ways),
        )
        for one in structures
    )
    if not rows or not ways:
        return ""
    head = "".join(tag("th", text(words), scope="col") for words in ("distance, mm", *ways))
    return table_of(tag("tr", head), rows)


def _cell(distance: StructureDistance | None) -> str:
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

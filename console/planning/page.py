"""Planner page: its panels, click handling, and the update loop."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from nicegui import ui

from console.changes import await_change
from console.guard import LOW, SESSION, Session, SessionRole
from console.panels.elements import button, card, group, html
from console.panels.html import tag, text
from console.planning.ac_pc_panel import CLICK_NEXT, AcPcPanel
from console.planning.fused_series import ShownSeries
from console.planning.head_scene import HeadScene
from console.planning.help import help_html
from console.planning.judging import expected, page_advice, verdict
from console.planning.marker_panel import MarkerPanel, ProposalPanel
from console.planning.pictures import add_pictures
from console.planning.plan_editor import PlanEditor
from console.planning.reach_panel import ReachPanel
from console.planning.slice_panel import STROKE, SlicePanel
from console.planning.slices import WINDOWS_HU, PageView, Plane
from console.planning.structure_panel import StructurePanel
from console.planning.trajectory_panel import TrajectoryPanel
from console.planning.views import NAMES, PlanView, Size, arrange
from console.web.library import bind_page, page_head, use_library
from procedures.imaging import PatientIdentity
from procedures.planning.errors import AcPcUnfit, PlanMistakes
from procedures.strategies.trajectory import Point
from ronna_hw.errors import RonnaError

TITLE = "RONNA planner"  # the same for every patient
BEAT_S = 0.4  # host time between two updates when nothing happens
RECONNECT_S = 30.0  # a page delayed by a busy computer keeps its view
LOOK, ENTRY, TARGET, SPHERE, DRAW = "look", "entry", "target", "sphere", "draw"
MEASURE, AC_PC = "measure", "acpc"
CLICK_ACTIONS = {
    LOOK: "look around",
    ENTRY: "set the entry",
    TARGET: "set the target",
    SPHERE: "pick a sphere",
    DRAW: "draw a structure",
    MEASURE: "measure",
    AC_PC: "AC–PC",
}
VIEWERS_ACTIONS = (LOOK, MEASURE)
FOLDER = Path(__file__).parent


def add_planner(app: FastAPI, editor: PlanEditor) -> None:
    """Serve the planner at `/` of an application."""
    add_pictures(app, editor)
    style, script = ((FOLDER / f"planner.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    head = f"{page_head()}<style>{style}</style><script>{script}</script>"

    @ui.page("/")
    async def page(request: Request) -> None:
        ui.add_head_html(head)
        session: Session = request.scope[SESSION]
        bind_page(ui.context.client, session.identifier)
        PlannerPage(editor, session, low=LOW in request.query_params).build()

    use_library(app, TITLE, RECONNECT_S)


class PlannerPage:
    """Planner page of one session. Viewers see the shared draft but cannot change it."""

    def __init__(self, editor: PlanEditor, session: Session, *, low: bool) -> None:
        self._editor, self._low = editor, low
        self._may_edit = session.role is SessionRole.OPERATOR and editor.problem is None
        self._page_view = PageView(editor.volume.geometry)
        self._page_view.open_on(editor.draft.ways)
        self._beat = 0

    def build(self) -> None:
        """Create the panels and start updating them."""
        editor, page_view = self._editor, self._page_view
        with ui.element("header").classes("head"):
            html(tag("div", "PLANNER: NOTHING MOVES", class_="banner opening"))
            self._case = html()
            self._clock = html()
            self._file_buttons()
        html('<div id="lost" role="alert" hidden></div>')
        self._notice = html().classes("words")
        self._words = html().classes("words")
        with ui.element("main").classes("places planner"):
            self._picture_bar()
            with ui.element("div").classes("middle"):
                with ui.element("div").classes("board"):
                    self._slices = [
                        SlicePanel(
                            plane,
                            page_view,
                            act=self._on_click,
                            drag=self._on_drag,
                            is_drawing=lambda: self._mode.value == DRAW,
                            key=self._on_key,
                            enlarge=self._enlarge,
                            on_view_change=self._show_view,
                        )
                        for plane in Plane
                    ]
                    self._scene = HeadScene(editor, page_view, self._enlarge, low=self._low)
                self._sections = {PlanView.HEAD: self._scene.section} | {
                    PlanView(plane.value): item.section
                    for plane, item in zip(Plane, self._slices, strict=True)
                }
            with ui.element("div").classes("left"):
                self._ways = TrajectoryPanel(editor, page_view, self._show_view, may_edit=self._may_edit)
                self._verdict = self._section("Check", "verdictbox")
                self._reach = ReachPanel(editor, self._show_problem, may_edit=self._may_edit)
                self._expected = self._section("Expected error", "accuracy")
            with ui.element("div").classes("right"):
                self._ac_pc = AcPcPanel(editor, page_view, self._go_to, may_edit=self._may_edit)
                self._structures = StructurePanel(
                    editor, page_view, self._go_to, self._show_problem, may_edit=self._may_edit
                )
                self._markers = MarkerPanel(editor, self._go_to, self._pick, may_edit=self._may_edit)
                ProposalPanel(editor, self._go_to)
        self._enlarge(page_view.large)
        self._show()  # at once, with the page itself
        client = ui.context.client
        changed = editor.subscribe()
        task = asyncio.create_task(self._keep_fresh(client, changed))

        def forget_page() -> None:
            editor.unsubscribe(changed)
            task.cancel()

        client.on_delete(forget_page)

    def _file_buttons(self) -> None:
        self._undo = button("Undo", self._editor.undo, "undo")
        self._redo = button("Redo", self._editor.redo, "redo")
        self._author = ui.input("Your name").classes("name")
        self._author.props("dense outlined autocomplete=off")
        self._save = button("Save", self._save_plan, "save").classes("go", remove="plain")
        self._add_help()
        for item in (self._undo, self._redo, self._author, self._save):
            item.set_visibility(self._may_edit)

    def _add_help(self) -> None:
        """Add the help, hidden, and the button that opens and closes it."""

        def toggle() -> None:
            shown.set_visibility(not shown.visible)
            opener.props(f"aria-expanded={'true' if shown.visible else 'false'}")

        opener = button("Help", toggle, "help").props("aria-expanded=false")
        shown = html(help_html()).classes("card help")
        shown.props('role=region aria-label="Help"').set_visibility(False)

    def _picture_bar(self) -> None:
        with ui.element("div").classes("orders bar").props('role=toolbar aria-label="Pictures"'):
            actions = VIEWERS_ACTIONS if not self._may_edit else tuple(CLICK_ACTIONS)
            self._mode = self._choices("Click to", {name: CLICK_ACTIONS[name] for name in actions}, LOOK)
            self._mode.on_value_change(self._on_mode)
            self._add_series_choice()
            windows = {name: name for name in WINDOWS_HU}
            self._window = self._choices("Window", windows, self._page_view.window)
            self._window.on_value_change(lambda event: self._set_window(str(event.value)))
            names = {view.value: NAMES[view] for view in PlanView}
            self._large = self._choices("Large", names, self._page_view.large.value)
            self._large.on_value_change(lambda event: self._enlarge(PlanView(event.value)))
            with ui.element("div").classes("views"):
                button("−", lambda: self._magnify(-1), "smaller").props('aria-label="smaller"')
                button("+", lambda: self._magnify(1), "larger").props('aria-label="larger"')
            self._hint = ui.label("").classes("hint")
            self._crosshair_label = ui.label("").classes("num")
            self._fusion_note = ui.label("").classes("note")

    def _add_series_choice(self) -> None:
        """Add the choice of what the pictures show, if another series is fused with the CT."""
        if (fused := self._editor.fused) is None:
            return
        names = {"ct": "CT", "other": fused.name, "both": "chequerboard of both"}
        series = self._choices("Show", names, self._page_view.series.value)
        series.on_value_change(lambda event: self._show_series(ShownSeries(event.value)))

    def _choices(self, name: str, words: dict[str, str], chosen: str) -> ui.toggle:
        with group("choice", name):
            ui.label(name)
            choices = ui.toggle(words, value=chosen).props(f'no-caps unelevated aria-label="{name}"')
        return choices.props("toggle-color=chosen toggle-text-color=chosen")  # the library's own is too pale

    def _section(self, title: str, name: str) -> ui.html:
        with card(name, title):
            return html().classes("body")

    # User actions

    async def _on_click(self, place_mm: Point) -> None:
        mode = str(self._mode.value)
        self._page_view.go_to(place_mm)
        if mode in (ENTRY, TARGET):
            self._ways.place(mode, place_mm)
            self._mode.set_value(LOOK)
        elif mode == SPHERE:
            self._mode.set_value(LOOK)
            await self._pick(place_mm)
        elif mode == MEASURE:
            self._page_view.measure(place_mm)
        elif mode == AC_PC:
            self._add_landmark(place_mm)
        self._show_view()

    def _add_landmark(self, place_mm: Point) -> None:
        with self._problems_shown(AcPcUnfit):
            self._editor.change(self._editor.draft.with_landmark(place_mm))
            if self._editor.draft.ac_pc is not None:
                self._mode.set_value(LOOK)

    def _on_mode(self) -> None:
        if self._mode.value != MEASURE:
            self._page_view.measured_mm = ()
        self._show_view()

    def _on_drag(self, end: str, place_mm: Point, is_start: bool) -> None:
        if end == STROKE:
            self._structures.draw(place_mm, continues=not is_start)
        else:
            self._ways.place(end, place_mm, continues=not is_start)
        self._show_view()

    def _on_key(self, key: str) -> None:
        if self._may_edit:
            self._ways.place(ENTRY if key == "e" else TARGET, self._page_view.place_mm)

    async def _pick(self, place_mm: Point) -> None:
        with self._problems_shown():
            await self._editor.add_marker(place_mm)

    async def _save_plan(self) -> None:
        fields = (*self._ways.fields.values(), *self._structures.margins.values(), *self._markers.fields)
        with self._problems_shown():
            for item in fields:
                if item.is_wrong:
                    raise PlanMistakes(
                        f"{item.name} is not as it was typed",
                        action="Correct its field or empty it, then save again.",
                    )
            await self._editor.save(str(self._author.value or ""))

    def _go_to(self, place_mm: Point) -> None:
        self._page_view.go_to(place_mm)
        self._show_view()

    def _enlarge(self, view: PlanView) -> None:
        """Make a view the large one. Its picture keeps the keyboard's focus."""
        self._page_view.large = view
        self._large.set_value(view.value)
        for item, size in arrange(view).items():
            self._sections[item].classes(size, remove=" ".join(Size))

    def _set_window(self, name: str) -> None:
        self._page_view.window = name
        self._show_view()

    def _show_series(self, series: ShownSeries) -> None:
        page_view, name = self._page_view, self._editor.fused.name if self._editor.fused else ""
        page_view.series = series
        page_view.series_words = {ShownSeries.OTHER: name, ShownSeries.BOTH: f"CT and {name}"}.get(series, "")
        self._window.set_enabled(series is not ShownSeries.OTHER)  # a window is in HU
        self._show_view()

    def _magnify(self, steps: int) -> None:
        self._page_view.magnify(steps)
        self._show_view()

    def _show_view(self) -> None:
        """Show the view of this page immediately, without affecting other pages.

        The scene follows at the next beat: rendered in software it would delay scrolling.
        """
        draft = self._editor.draft
        for item in self._slices:
            item.show(draft)
        self._ways.show()
        self._ac_pc.show()
        self._crosshair_label.set_text(self._describe_place())
        self._hint.set_text(self._describe_mode())
        self._fusion_note.set_text(self._describe_fusion())

    def _describe_place(self) -> str:
        place_mm = self._page_view.place_mm
        frame = self._editor.draft.ac_pc
        words = f"LPS {_numbers(place_mm)} mm"
        if frame is not None:
            words += f" · AC–PC {_numbers(frame.from_lps_mm(place_mm))} mm"
        return f"{words} · {self._editor.hu_at(place_mm)}"

    def _describe_fusion(self) -> str:
        """State the error of the fusion and, while its series is shown, that a target is marked by it."""
        if (fused := self._editor.fused) is None:
            return ""
        here_mm = fused.fusion.expect_error_mm(self._page_view.place_mm)
        words = (
            f"{fused.name} fused: expected error {fused.fusion.expected_mm:.2f} mm rms in the head, "
            f"{here_mm:.2f} mm at the crosshair."
        )
        if self._page_view.series is ShownSeries.CT or not self._may_edit:
            return words
        return f"{words} A target that you set now is marked as chosen in the {fused.name}."

    def _describe_mode(self) -> str:
        """Tell which click comes next, or what was measured."""
        ends = self._page_view.measured_mm
        if self._mode.value == AC_PC:
            return CLICK_NEXT[len(self._editor.draft.landmarks) % len(CLICK_NEXT)]
        if self._mode.value != MEASURE:
            return ""
        if len(ends) == 2:
            return f"Distance {math.dist(*ends):.1f} mm"
        return "Click the other end." if ends else "Click one end."

    @contextmanager
    def _problems_shown(self, kind: type[RonnaError] = RonnaError) -> Iterator[None]:
        """Show an error of the block, or that there is none any more."""
        try:
            yield
        except kind as problem:
            self._show_problem(problem)
        else:
            self._show_problem(None)

    def _show_problem(self, problem: RonnaError | None) -> None:
        self._words.set_content("" if problem is None else _problem_html(problem))

    # Display

    async def _keep_fresh(self, client: Any, changed: asyncio.Event) -> None:
        is_built = False
        while True:
            if client.has_socket_connection:
                with client:
                    if not is_built:
                        is_built = True
                        self._scene.build_scene()
                    self._show()
            await await_change(changed, BEAT_S)

    def _show(self) -> None:
        editor = self._editor
        self._case.set_content(_case_line(editor))
        notice = editor.read_only or editor.storage_problem or editor.notice
        self._notice.set_content("" if notice is None else _problem_html(notice))
        self._undo.set_enabled(editor.history.can_undo)
        self._redo.set_enabled(editor.history.can_redo)
        self._save.set_enabled(editor.read_only is None)
        self._show_view()
        self._scene.show()
        self._markers.show()
        self._structures.show()
        self._reach.show()
        self._verdict.set_content(verdict(editor.judged, editor.draft))
        self._expected.set_content(expected(editor.judged, editor.draft))
        self._beat += 1
        self._clock.set_content(tag("div", "", id="clock", data_beat=str(self._beat)))


def _numbers(place_mm: Point) -> str:
    return ", ".join(f"{value:.1f}" for value in place_mm)


def _case_line(editor: PlanEditor) -> str:
    state, kind = ("saved", "ok") if editor.is_saved else ("not saved", "warn")
    file = text(editor.file.name) + " " + tag("span", state, class_=kind, data_saved=state)
    shape = " × ".join(map(str, editor.volume.geometry.shape))
    position = editor.volume.patient_position or "patient position unknown"
    scan = tag("div", file + text(f", CT of {shape} voxels, {position}"), class_="dim")
    return tag("div", _patient_html(editor.patient) + scan, class_="case")


def _patient_html(patient: PatientIdentity | None) -> str:
    """Name the patient, whose name stands nowhere else: not in titles, addresses or messages."""
    if patient is None:
        return ""
    name = patient.name.replace("^", " ").strip() or "no name in the CT"
    born = f", born {patient.birth_date}" if patient.birth_date else ""
    details = f"identifier {patient.identifier or 'missing'}{born}"
    return tag("div", tag("b", text(name)) + " " + tag("span", text(details)), class_="patient")


def _problem_html(problem: RonnaError) -> str:
    advice = tag("span", text(page_advice(problem)), class_="advice")
    words = text(f"{problem.code}: {problem.summary}.") + " " + advice
    return tag("div", words, class_="said", role="alert", data_code=problem.code)

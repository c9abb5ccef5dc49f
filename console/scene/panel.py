"""The scene with its controls: views, magnification, clearance in words, colour legend."""

from __future__ import annotations

from nicegui import ui

from console.feed.view import CaseView
from console.panels.html import tag, text
from console.scene.sights import HIDDEN, VOLUME
from console.scene.theatre_scene import (
    ARM,
    CAPTION,
    CT,
    INSTRUMENT,
    OLD_S,
    PATH,
    STEREO,
    TRACKER,
    TheatreScene,
)
from procedures.reporting.case_figures import CaseFigures

MAGNIFICATIONS = {1: "as measured", 10: "differences × 10", 30: "differences × 30"}
KEY = (
    ("arm (as checked)", ARM),
    ("spheres from the CT", CT),
    ("tracker", TRACKER),
    ("stereo head", STEREO),
    ("plan", PATH),
    (CAPTION, INSTRUMENT),
    ("hidden from the tracker", HIDDEN),
    ("measuring volume", VOLUME),
)


class ScenePanel:
    """The arm, and its surroundings."""

    def __init__(self, *, low: bool) -> None:
        self._figures: CaseFigures | None = None
        with ui.element("section").classes("card scenebox").props('aria-label="The theatre"'):
            with ui.element("div").classes("sceneline"):
                self._views = ui.element("div").classes("views").props('role=group aria-label="Views"')
                self._size = ui.select(MAGNIFICATIONS, value=1, on_change=self._magnify)
                self._size.props('dense outlined options-dense aria-label="Differences between instruments"')
            self._age = ui.html("", sanitize=False)
            self._scene = TheatreScene(low=low)
            key = "".join(tag("span", f'<i style="background:{colour}"></i>{words}') for words, colour in KEY)
            ui.html(tag("div", key, class_="key"), sanitize=False)
        self._names: list[str] | None = None
        self._scene.look_at("robot", None)

    def show(self, view: CaseView, figures: CaseFigures | None, heads: int) -> None:
        """Show a moment."""
        self._figures = figures
        names = [path.name for path in figures.trajectories] if figures else []
        if names != self._names:
            self._names = names
            self._build_views(names)
        self._scene.show(view, figures, heads)
        self._age.set_content(_age(view) + self._clearance() + self._sight())

    def _build_views(self, names: list[str]) -> None:
        self._views.clear()
        with self._views:
            for where, words in (
                ("robot", "robot"),
                ("head", "head"),
                ("tracker", "tracker"),
                *((name, f"along {name}") for name in names),
            ):
                ui.button(
                    words, on_click=lambda where=where: self._scene.look_at(where, self._figures), color=None
                ).classes("plain small").props("no-caps unelevated")

    def _clearance(self) -> str:
        closest = self._scene.closest
        if closest is None:
            return ""
        words = f"closest: {closest.first} and {closest.second}, {closest.distance_mm:.0f} mm"
        return tag("div", text(words), class_="num")

    def _sight(self) -> str:
        hidden = self._scene.hidden
        if not hidden:
            return ""
        words = f"the arm blocks the tracker's view of {hidden} of the spheres (red lines)"
        return tag("div", words, class_="warn")

    def _magnify(self) -> None:
        self._scene.magnified = int(self._size.value or 1)


def _age(view: CaseView) -> str:
    stood = view.pose
    if stood is None:
        return tag("div", "No arm position yet.", class_="dim")
    age_s = view.theatre_time_s - stood.said_s + stood.pose.age_s
    if age_s > OLD_S:
        return tag("div", f"POSE IS {age_s:.1f} s OLD, shown grey", class_="warn num")
    return tag("div", f"pose is {age_s:.2f} s old", class_="num")

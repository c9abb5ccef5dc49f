"""Panel that checks the arm's reach with a theatre file chosen by name, and tells it per trajectory."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from console.panels.elements import button, html
from console.panels.html import tag, text
from console.planning.draft import Draft, DraftTrajectory
from console.planning.judging import Judgement, mark_outdated
from console.planning.plan_editor import PlanEditor
from procedures.planning.pose_name import MARKER, PoseKind
from procedures.planning.visits import Unmet
from procedures.registration.points import FEWEST_PAIRS
from ronna_hw.errors import RonnaError

ADVICE = (
    "Turn the guide by its free angle, choose another entry, or have head or cart moved; then check again."
)
NO_FILES = (
    "There is no theatre file where this planner was started. Ask whoever set up the theatre to put it there."
)


class ReachPanel:
    """Panel of the reach check. The theatre file is chosen once; then every change is checked."""

    def __init__(
        self, editor: PlanEditor, show_problem: Callable[[RonnaError | None], None], *, may_edit: bool
    ) -> None:
        self._editor, self._show_problem, self._may_edit = editor, show_problem, may_edit
        with ui.element("section").classes("card reach").props('aria-label="Reach"'):
            html("<h2>Reach of the arm</h2>")
            names = list(editor.choice.list_files()) if editor.choice is not None else []
            if may_edit and names:
                with ui.element("div").classes("numbers"):
                    self._file = ui.select(names, value=editor.theatre_name or names[0], label="Theatre")
                    self._file.props("dense outlined options-dense data-field=theatre").classes("theatre")
                    self._button = button("Check reach", self._check, "reach")
            elif may_edit:
                html(tag("p", NO_FILES, class_="dim"))
            self._result = html()

    def show(self) -> None:
        self._result.set_content(tell_reach(self._editor))

    async def _check(self) -> None:
        self._button.set_enabled(False)
        try:
            await self._editor.choose_theatre(str(self._file.value))
        except RonnaError as refused:
            self._show_problem(refused)
        else:
            self._show_problem(None)
        finally:
            self._button.set_enabled(True)


def tell_reach(editor: PlanEditor) -> str:
    judged, draft = editor.judged, editor.draft
    if editor.theatre is None:
        return tag("p", "Not checked yet.", class_="dim", data_reach="unchecked")
    basis = tag("p", text(f"{editor.theatre_name}: {editor.head_words}"), class_="dim")
    if not judged.is_arm_known or (judged.draft is draft and not judged.thorough):
        return tag("p", "Checking every pose and motion…", class_="dim", data_reach="checking") + basis
    return mark_outdated(tag("div", tell_trajectories(judged), data_reach="told") + basis, judged, draft)


def tell_trajectories(judged: Judgement) -> str:
    """Tell for each complete trajectory whether the arm reaches it, in words of the theatre."""
    if not judged.complete:
        return tag("p", "Set entry and target of a trajectory.", class_="dim")
    if not judged.is_reach_known:
        return tag("p", "Not checked: first correct what stands under Check.", class_="warn")
    unmet_by_name = {way.identifier: _find_unmet(judged, way.identifier) for way in _complete(judged.draft)}
    elsewhere = [item for item in judged.unmet if all(item not in found for found in unmet_by_name.values())]
    lines = [_trajectory_html(name, found, whole=not judged.unmet) for name, found in unmet_by_name.items()]
    lines += [
        tag("li", text(f"At {item.pose.in_sentence(MARKER)}: {item.words}"), class_="bad")
        for item in elsewhere
    ]
    lines += [tag("li", text(item)) for item in judged.reached]
    if len(judged.draft.markers) < FEWEST_PAIRS:
        lines.append(tag("li", "Only targets were tried: fewer than three markers are known.", class_="warn"))
    advice = tag("p", ADVICE, class_="advice") if judged.unmet else ""
    return tag("ul", "".join(lines), class_="findings") + advice


def _complete(draft: Draft) -> list[DraftTrajectory]:
    return [way for way in draft.ways if way.ends is not None]


def _find_unmet(judged: Judgement, name: str) -> list[Unmet]:
    return [item for item in judged.unmet if item.pose.trajectory == name]


def _trajectory_html(name: str, unmet: list[Unmet], *, whole: bool) -> str:
    if not unmet:
        words = "within reach" if whole else "no obstacle found to its own poses"
        return tag("li", text(f"{name}: {words}"), class_="ok", data_reached=name)
    first = unmet[0]
    what = "guide" if first.pose.kind is PoseKind.TARGET else "stereo head"
    where = first.pose.in_sentence(MARKER)
    words = f"{name}: not within reach. The {what} does not get to {where}: {first.words}"
    more = f"; nor to {len(unmet) - 1} more of its poses" if unmet[1:] else ""
    return tag("li", text(words + more), class_="bad", data_unreached=name)

"""What had been measured at a moment of a recorded case, and whether its files have been changed."""

from __future__ import annotations

import asyncio
import hashlib
from dataclasses import replace
from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell
from skin_case import registered_by_surface, scanned_surface, skin_in_ct
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.routing import Route

from console.figures import LatestFigures, figures_at
from console.hub import Hub
from console.recorded_case import RecordedCase
from procedures.engine.case_view import CaseView, StepRow
from procedures.operator.question import Evidence, PredictedError
from procedures.reporting.case_figures import CaseFigures, SphereFigure, TrajectoryFigure
from procedures.reporting.sections.surface import SurfaceSection
from procedures.runs.finishing import seal_run

PLACE = (1.0, 2.0, 3.0)
FIGURES = CaseFigures(
    spheres=(SphereFigure(1, PLACE, PLACE, PLACE),),
    trajectories=(TrajectoryFigure("T1", PLACE, PLACE),),
    predictions=tuple(
        PredictedError(target=name, rms_mm=0.2, limit_mm=0.4, confidence=0.95, margin_mm=2.0)
        for name in ("T1", "T2")
    ),
    tables=(Evidence(title="budget", head=("source",), rows=()),),
    pictures=("stereo-T1-1.png",),
    margins_mm={"T1": 1.5, "T2": 2.0},
)


def after(*done: str) -> CaseFigures:
    view = CaseView(steps=tuple(StepRow(one, one, "", False, "done") for one in done))
    found = figures_at(FIGURES, view, view)
    assert found is not None
    return found


def test_figures_appear_in_the_order_in_which_they_were_measured() -> None:
    assert figures_at(None, CaseView(), CaseView()) is None
    nothing = after("ct_import")
    tracked = after("global_localization")
    matched = after("global_localization", "correspondence")
    localized = after("global_localization", "correspondence", "relocalization:T1")
    assert nothing.spheres == (SphereFigure(1, None, None, None),)
    assert tracked.spheres == (SphereFigure(1, None, PLACE, None),)
    assert (matched.spheres[0].ct_mm, matched.trajectories, matched.pictures) == (
        PLACE,
        FIGURES.trajectories,
        (),
    )
    assert (localized.spheres, localized.pictures) == (FIGURES.spheres, FIGURES.pictures)


def test_a_prediction_appears_with_the_registration_of_its_target() -> None:
    first, every = after("registration:T1"), after("registration")
    assert [one.target for one in first.predictions] == ["T1"]
    assert every.predictions == FIGURES.predictions


def test_margins_appear_with_the_plan() -> None:
    assert after("ct_import").margins_mm == {}
    assert after("ct_import", "plan_check").margins_mm == FIGURES.margins_mm


def test_results_on_the_skin_appear_as_those_of_spheres_do() -> None:
    surface = SurfaceSection(skin_in_ct(), None, scanned_surface(), registered_by_surface())
    figures = replace(FIGURES, surface=surface)

    def shown(*done: str) -> CaseFigures:
        view = CaseView(steps=tuple(StepRow(one, one, "", False, "done") for one in done))
        found = figures_at(figures, view, view)
        assert found is not None
        assert found.surface is not None
        return found

    scanned = shown("surface_start", "surface_scan")
    registered = shown("surface_start", "surface_scan", "surface_registration")
    assert (scanned.surface and scanned.surface.scan) == surface.scan
    assert scanned.surface is not None
    assert scanned.surface.registration is None
    assert (scanned.predictions, registered.predictions) == ((), FIGURES.predictions)
    assert registered.surface == surface


def test_figures_of_a_repeated_result_are_hidden_before_the_repetition() -> None:
    then, now = (
        CaseView(steps=(StepRow("registration", "", "", False, "done", record=record),))
        for record in ("registration-1", "registration-2")
    )
    shown = [figures_at(FIGURES, view, now) for view in (then, now)]
    assert [bool(one and one.predictions) for one in shown] == [False, True]


@pytest.mark.hazard(39)
def test_a_review_checks_every_file_once_the_program_of_the_case_has_ended(tmp_path: Path) -> None:
    cell = RecordingCell(tmp_path / "run")
    (cell.folder / "theatre").mkdir()
    for name in ("changed", "gone"):
        (cell.folder / "theatre" / name).write_text("as it was")
    engine = cell.engine(plain_order("T1"))
    engine.run_to()
    engine.close("done")
    seal_run(cell.folder)
    hub = Hub(cell.folder)
    hub.review = RecordedCase()
    figures = LatestFigures(hub)

    async def named() -> set[str]:
        figures.key()
        await figures._task
        assert figures.latest is not None
        return {problem.partition(":")[0] for problem in figures.latest.problems}

    (cell.folder / "records" / "01-image.json").write_text("{}")
    assert asyncio.run(named()) == {"records/01-image.json"}
    (cell.folder / "theatre" / "changed").write_text("another")
    (cell.folder / "theatre" / "gone").unlink()
    (cell.folder / "added").touch()
    hub.review.is_over = True
    everything = {"added", "records/01-image.json", "theatre/changed", "theatre/gone"}
    assert asyncio.run(named()) == everything


def test_a_link_in_place_of_a_picture_is_not_followed_nor_one_served_that_changed_since_the_question(
    tmp_path: Path,
) -> None:
    app, figures = Starlette(), LatestFigures(Hub(tmp_path))
    figures.latest = FIGURES
    figures.add_routes(app)
    (route,) = (one for one in app.routes if isinstance(one, Route) and one.path == "/picture/{name}")
    (picture := tmp_path / "pictures" / FIGURES.pictures[0]).parent.mkdir()
    address = {"type": "http", "path_params": {"name": picture.name}, "query_string": b""}
    request = Request(address)
    (tmp_path / "another").write_bytes(b"of this computer")
    picture.symlink_to(tmp_path / "another")
    assert asyncio.run(route.endpoint(request)).status_code == 404
    picture.unlink()
    picture.write_bytes(b"a picture")
    assert asyncio.run(route.endpoint(request)).body == b"a picture"
    for content, status in ((b"a picture", 200), (b"another", 404)):  # as in the question, and changed since
        shown = b"shown=" + hashlib.sha256(content).hexdigest().encode()
        request = Request({**address, "query_string": shown})
        assert asyncio.run(route.endpoint(request)).status_code == status

"""Measurements and images of a run, re-read whenever a result is added or superseded.

The journal and the records are compared each time; of a run that no program writes, every file is.
"""

from __future__ import annotations

import asyncio
import hashlib
from dataclasses import replace
from typing import Any

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from console.hub import Hub
from console.scene.head_surface import build_head, find_series_folder
from procedures.engine.case_view import CaseView
from procedures.imaging.drawn_skin import DrawnSkin
from procedures.reporting.case_figures import (
    LOCALIZED,
    MATCHED,
    REGISTERED,
    CaseFigures,
    read_case_figures,
)
from procedures.reporting.files import LARGEST_PICTURE_BYTES
from ronna_hw.bounded_input import InputRefused, read_bounded
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.manifest import PICTURES_FOLDER


def figures_at(figures: CaseFigures | None, view: CaseView, latest: CaseView) -> CaseFigures | None:
    """Drop the figures that were not yet measured at the moment of a view, or have been remeasured since.

    `latest` is the view that the figures belong to.
    """
    if figures is None:
        return None
    valid_rows = {(row.step, row.record) for row in latest.steps if row.state == "done"}
    finished_steps = {
        row.step for row in view.steps if row.state == "done" and (row.step, row.record) in valid_rows
    }
    names = {step.partition(":")[0] for step in finished_steps}

    def is_registered(target: str) -> bool:
        return not finished_steps.isdisjoint({*REGISTERED, *(f"{name}:{target}" for name in REGISTERED)})

    is_matched, is_tracked = bool(names & MATCHED), "global_localization" in names
    is_localized = bool(names & LOCALIZED)
    return replace(
        figures,
        robot_from_ct=figures.robot_from_ct if is_matched else None,
        robot_from_tracker=figures.robot_from_tracker if is_tracked else None,
        spheres=tuple(
            replace(
                item,
                ct_mm=item.ct_mm if is_matched else None,
                tracker_mm=item.tracker_mm if is_tracked else None,
                stereo_mm=item.stereo_mm if is_localized else None,
            )
            for item in figures.spheres
        ),
        trajectories=figures.trajectories if is_matched else (),
        predictions=tuple(item for item in figures.predictions if is_registered(item.target)),
        tables=figures.tables if names & REGISTERED else (),
        surface=figures.surface
        and figures.surface.known_by(
            start=is_matched, scan=is_localized, registration=bool(names & REGISTERED)
        ),
        pictures=figures.pictures if is_localized else (),
        margins_mm=figures.margins_mm if "plan_check" in names else {},
        cuts=figures.cuts if "plan_check" in names else (),
        course=figures.course if view.number == latest.number else "",
    )


class LatestFigures:
    """The latest figures, read by a background thread."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._read_for: tuple[int, bool] | None = None
        self._reading = False
        self.latest: CaseFigures | None = None
        self.count = 0  # how often they were read
        self.heads = 0  # how often the surface of the head was built
        self._head = self._skin_picture = b""
        self.skin: DrawnSkin | None = None  # on which a scan is shown
        self._has_tried_head = False

    def key(self) -> object:
        """Return a key that changes with the figures. Re-read them after a new result or the run's end."""
        state = self._hub.view.results, self._hub.is_over
        if state != self._read_for and not self._reading:
            self._reading = True
            self._task = asyncio.get_running_loop().create_task(self._read(state))
        return self.count

    async def _read(self, state: tuple[int, bool]) -> None:
        _, is_over = state
        try:
            self.latest = await asyncio.to_thread(read_case_figures, self._hub.folder, every_file=is_over)
        finally:
            self._read_for, self._reading = state, False
            self.count += 1
            self._hub.notify()
        if self.latest is not None and self.latest.robot_from_ct is not None and not self._has_tried_head:
            self._has_tried_head = True
            await self._make_head()

    async def _make_head(self) -> None:
        series = find_series_folder(self._hub.folder)
        if series is None:
            return
        try:
            self._head, skin = await asyncio.to_thread(build_head, series)
            self._skin_picture = await asyncio.to_thread(skin.draw)
        except (OSError, ValueError, RonnaError):  # the step that imports the CT reports the reason
            return
        self.skin = skin
        self.heads += 1
        self._hub.notify()

    def add_routes(self, app: Any) -> None:
        """Serve the images, accepting known names only."""

        async def head(_request: Request) -> Response:
            return Response(self._head, media_type="model/stl") if self._head else PlainTextResponse("", 404)

        async def skin(_request: Request) -> Response:
            content = self._skin_picture
            return Response(content, media_type="image/png") if content else PlainTextResponse("", 404)

        async def picture(request: Request) -> Response:
            name = request.path_params["name"]
            question = self._hub.view.question
            asked = () if question is None else (one.name for one in question.pictures)
            known = () if self.latest is None else (*self.latest.pictures, *self.latest.cuts)
            if name not in (*known, *asked):
                return PlainTextResponse("No such picture.", 404)
            path = self._hub.folder / PICTURES_FOLDER / name
            try:  # not through a link: whoever made the run would choose what viewers see of this computer
                content = await asyncio.to_thread(
                    read_bounded, path, LARGEST_PICTURE_BYTES, follow_links=False
                )
            except (OSError, InputRefused):
                return PlainTextResponse("No such picture.", 404)
            shown = request.query_params.get("shown")  # in a question: the answer signs this very content
            if shown is not None and hashlib.sha256(content).hexdigest() != shown:
                return PlainTextResponse("This picture has changed since the question was asked.", 404)
            return Response(content, media_type="image/png")

        async def pair(_request: Request) -> Response:
            content = self._hub.pair
            return Response(content, media_type="image/png") if content else PlainTextResponse("", 404)

        app.add_route("/picture/pair", pair, methods=["GET"])
        app.add_route("/picture/skin.png", skin, methods=["GET"])
        app.add_route("/picture/head.stl", head, methods=["GET"])
        app.add_route("/picture/{name}", picture, methods=["GET"])

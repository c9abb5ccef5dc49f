"""`python -m console.planning.serving REQUEST`: server process of `ronna-plan open`, until Ctrl-C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pydantic import BaseModel, ConfigDict

from procedures.strategies.names import DEFAULT_STRATEGY
from ronna_hw.command_line import terminal
from ronna_hw.command_line.messages import tell_address

FORM_BYTES = 10_000  # in addition to an imported file
app = typer.Typer(add_completion=False, rich_markup_mode=None)
SixNumbers = tuple[float, float, float, float, float, float]


class PlannerRequest(BaseModel):
    """A CT, its plan, where theatre files are listed, and the one to check the plan with, if known."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    series: Path
    plan: Path
    folder: Path
    port: int = 0
    config: Path | None = None
    strategy: str = DEFAULT_STRATEGY
    robot_from_ct: SixNumbers | None = None
    home_deg: SixNumbers | None = None
    fusion: Path | None = None
    other: Path | None = None


@app.command()
def open_planner(request: Annotated[str, typer.Argument(help="What to open, as JSON.")]) -> None:
    """Read the CT and serve the planner."""
    from console.app import serve_pages
    from console.planning.fused_series import read_fused_series
    from console.planning.page import add_planner
    from console.planning.plan_editor import PlanEditor
    from console.planning.theatre_choice import TheatreChoice
    from procedures.imaging import read_identity, read_series
    from procedures.imaging.picks import LARGEST_FILE_BYTES

    asked = PlannerRequest.model_validate_json(request)
    choice = TheatreChoice(
        asked.folder, asked.plan, asked.config, asked.strategy, asked.robot_from_ct, asked.home_deg
    )
    with terminal.progress_bar("reading the CT series") as advance:
        volume = read_series(asked.series, progress=advance)
    fused = None
    if asked.fusion is not None and asked.other is not None:
        with terminal.progress_bar("reading the fused series") as advance:
            fused = read_fused_series(asked.fusion, asked.other, volume.series_instance_uid, advance)
    loaded = choice.load_known(volume.series_instance_uid)
    editor = PlanEditor(volume, asked.plan, choice, read_identity(asked.series), fused)
    if loaded is not None:
        editor.adopt_theatre(*loaded)
    if editor.problem is not None:
        terminal.tell(str(editor.problem))
    try:
        serve_pages(
            lambda application: add_planner(application, editor),
            asked.port,
            editor.work,
            tell_address,
            largest_body_bytes=LARGEST_FILE_BYTES + FORM_BYTES,
        )
    finally:
        if (kept := editor.close()) is not None:
            terminal.tell(f"unsaved changes kept in {kept}: open the plan again to continue")


if __name__ == "__main__":
    terminal.run(app)

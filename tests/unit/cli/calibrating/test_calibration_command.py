"""A calibration's closing messages, and the options that are refused where nothing is measured."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import typer
from arm_looks import ENDPOINTS, SPHERES_MM, LookingArm
from coded_errors import raises
from user_commands import in_this_process, one_error

from procedures.calibration.errors import TOO_FEW_POSES, OfAnotherTheatre
from procedures.cli.arm.command import app as arm
from procedures.cli.calibrating.calibration import NOT_COMPARED, calibrate, show
from procedures.cli.calibrating.mount import app as mount
from procedures.cli.stereo.command import app as stereo
from procedures.engine.case import Case
from procedures.reporting.calibration_figures import Figure, RecordFigures
from procedures.runs.calibrations import ARM, compute_calibration, conclude
from procedures.runs.request import CalibrationProcedure, RunRequest
from procedures.steps.calibration.recipe import Calibrated, Recipe
from procedures.steps.calibration.sphere_looks import ObservedSpheres
from ronna_hw.config import parse_theatre
from sim.theatre.theatre_file import theatre_content, write_theatre_file
from sim.world.scene.named_scenes import draw_scene


class NoFigures(RecordFigures):
    def quality(self) -> Iterator[Figure]:
        yield from ()


@pytest.mark.parametrize(
    ("updated", "shown"), [(Path("lab.toml"), "now in force in lab.toml"), (None, "not yet in force")]
)
def test_the_message_names_the_updated_file_or_how_to_update_one(
    updated: Path | None, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = NoFigures(calibration="tool-tip", created="", expires="")
    show(figures, Path("out"), updated=updated, as_json=False)
    said = capsys.readouterr().err
    assert shown in said
    assert ("--update" in said) is (updated is None)


def test_remarks_on_the_measurements_are_reported_also_if_these_yield_no_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    looks = LookingArm.of(3).looks(1, 0, SPHERES_MM)
    result = ObservedSpheres(observed=looks, remarks=("30 x no sphere in view",))
    case = cast(Case, SimpleNamespace(get=lambda _kind: SimpleNamespace(result=result)))
    request = RunRequest(procedure=CalibrationProcedure(recipe={}, days=30))
    with raises(TOO_FEW_POSES):
        conclude(ARM, request, case, tmp_path)
    assert capsys.readouterr().err == "30 x no sphere in view\n"


class Computed(Exception):
    """The computation was begun."""


def begun(*_: object, **_more: object) -> None:
    raise Computed


@pytest.mark.hazard(3)
@pytest.mark.parametrize(("seed", "expected"), [(3, Computed), (4, OfAnotherTheatre)])
def test_measurements_of_another_theatre_are_refused_before_anything_is_computed(
    tmp_path: Path, seed: int, expected: type[Exception]
) -> None:
    theatre = tmp_path / "theatre.toml"
    write_theatre_file(theatre_content(draw_scene("mini", seed=seed), ENDPOINTS, "host:", {}, 1.0), theatre)
    content = parse_theatre(tomllib.loads(theatre.read_text())).calibration
    assert content is not None
    looks = LookingArm.of(3).looks(1, 0, SPHERES_MM).model_copy(update={"tool_tip": content.tool_tip})
    run = RunRequest(procedure=CalibrationProcedure(recipe={}, days=30), config=theatre)
    with raises(expected):
        compute_calibration(replace(ARM, compute=begun), run, looks)


@pytest.mark.hazard(3)
@pytest.mark.parametrize("config", [True, False])
def test_records_computed_without_a_theatre_file_are_said_to_be_compared_with_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], config: bool
) -> None:
    for name in ("compute_calibration", "write_calibration_files", "show", "read_finished_figures"):
        monkeypatch.setattr(f"procedures.cli.calibrating.calibration.{name}", lambda *_, **__: None)
    looks = LookingArm.of(3).looks(1, 0, SPHERES_MM)
    ARM.write_looks(looks, tmp_path)
    theatre = tmp_path / "theatre.toml" if config else None
    recipe = Recipe(of=Calibrated.ARM, looks=60, more=12).model_dump(mode="json")
    request = RunRequest(procedure=CalibrationProcedure(recipe=recipe, days=30), config=theatre)
    calibrate(request, tmp_path, tmp_path / "out", as_json=True)
    assert (NOT_COMPARED in capsys.readouterr().err) is not config


OF_HEAD, OF_ARM = (stereo, "calibrate"), (arm, "calibrate")
OF_FRAME, OF_TIP = (mount, "tracker-frame"), (mount, "tool-tip")


@pytest.mark.parametrize(
    ("command", "option"),
    [
        *((OF_HEAD, one) for one in ("--ball 1 2 3", "--poses 61", "--visits 3")),
        *((OF_ARM, one) for one in ("--looks 91", "--validation 25", "--calibrated", "--answers a.toml")),
        *((OF_FRAME, one) for one in ("--scene mini", "--seed 1", "--calibration x", "--first-day")),
        *((OF_TIP, one) for one in ("--readings 11", "--ball 1 2 3")),
    ],
)
def test_an_option_without_effect_on_recorded_measurements_is_named_and_refused(
    command: tuple[typer.Typer, str], option: str
) -> None:
    app, name = command
    done = in_this_process(app, name, "--from", "nowhere", "--days", "7", *option.split())
    assert done.returncode == 2
    (error, *_) = one_error(done.stderr)
    assert error.startswith(f"CLI-001: {option.split()[0]} and --from cannot be combined")

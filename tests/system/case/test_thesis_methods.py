"""Whole cases by methods of the thesis: recorded, reported, replayed, and marked."""

from __future__ import annotations

import json

import numpy as np
import pytest
from run_folders import records_of
from simulated_case import SimulatedCase
from undisturbed import finished_mini
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.engine.methods import NOT_CLINICAL

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
CASE = ("--scene", "mini", "--seed", "101", "--markers", "5")
METHODS = ("--localizer", "thesis-sphere", "--matcher", "thesis", "--matcher-e-mm", "3")
MARK = f"ocalizer thesis-sphere, matcher thesis (e 3 mm, refused share 0.001): {NOT_CLINICAL}"
LARGEST_MM = 1.0  # at the target; its CT is coarse
SMALLER_MM = 0.0005  # of a sphere's radius: equalization moves its edges by more


def test_a_case_by_the_methods_of_the_thesis_is_recorded_reported_and_replayed_as_such(
    case: SimulatedCase,
) -> None:
    ran = case.run(*CASE, *METHODS)
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert (outcome["localizer"], outcome["matcher"]) == ("thesis-sphere", "thesis")
    assert (outcome["ct"]["found"], outcome["registration"]["n"]) == (5, 5)
    assert 0.0 < outcome["max_application_error_mm"] <= LARGEST_MM
    run = case.run_folder
    records = {one.kind: one.payload for one in records_of(run)}
    assert records["fiducial_localization"]["localizer"] == "thesis-sphere"
    assert (records["correspondence"]["matcher"], records["correspondence"]["e_mm"]) == ("thesis", 3.0)
    assert MARK in (run / "report.html").read_text()
    replayed = in_this_process(app, "replay", run)
    assert replayed.returncode == 0, replayed.stderr
    assert replayed.stdout.startswith(f"l{MARK}\n")
    assert MARK in in_this_process(app, "show", run).stdout


def test_a_case_with_enhanced_contrast_measures_smaller_outlines_and_is_marked(
    case: SimulatedCase, tmp_path_factory: pytest.TempPathFactory
) -> None:
    ran = case.run("--scene", "mini", "--seed", "7", "--enhance-contrast")
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout)["max_application_error_mm"] <= LARGEST_MM
    plain, printed = finished_mini(tmp_path_factory)
    runs = (case.run_folder, plain / str(json.loads(printed)["run"]))
    with_contrast, as_taken = (
        np.array(one.payload["radii_mm"])
        for run in runs
        for one in records_of(run)
        if one.kind == "relocalization"
    )
    assert np.all(with_contrast < as_taken - SMALLER_MM)
    replayed = in_this_process(app, "replay", case.run_folder)
    assert replayed.returncode == 0, replayed.stderr
    assert f"contrast enhanced: {NOT_CLINICAL}" in (case.run_folder / "report.html").read_text()

"""A whole case by the localizer and the matcher of the thesis: recorded, reported, replayed, and marked."""

from __future__ import annotations

import json

import pytest
from run_folders import records_of
from simulated_case import SimulatedCase
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.engine.methods import NOT_CLINICAL

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
CASE = ("--scene", "mini", "--seed", "101", "--markers", "5")
METHODS = ("--localizer", "thesis-sphere", "--matcher", "thesis", "--matcher-e-mm", "3")
MARK = f"ocalizer thesis-sphere, matcher thesis (e 3 mm, refused share 0.001): {NOT_CLINICAL}"
LARGEST_MM = 1.0  # at the target; its CT is coarse


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

"""A whole case registers on the skin, by a scan over the wire, and its error is within what it predicted."""

from __future__ import annotations

import json

import pytest
from run_folders import records_of
from simulated_case import SimulatedCase

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
SEED = 7


@pytest.mark.parametrize(
    ("options", "spheres"), [(("surface",), 0), (("mixed", "--markers", "1", "--strategy", "jdms"), 1)]
)
def test_a_case_on_the_skin_reaches_its_target_within_its_predicted_error(
    case: SimulatedCase, options: tuple[str, ...], spheres: int
) -> None:
    ran = case.run("--scene", "mini", "--seed", str(SEED), "--fiducials", *options)
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    records = {record.kind: record.payload for record in records_of(case.run_folder)}
    (predicted,) = records["surface_registration"]["predictions"]
    assert outcome["max_application_error_mm"] < predicted["limit_mm"]
    assert len(records["skin_in_ct"]["markers"]) == records["surface_registration"]["pairs"] == spheres
    assert "Registration on the skin" in (case.run_folder / "report.html").read_text()

"""The closing line of a run records the input files outside its folder."""

from __future__ import annotations

import json
from pathlib import Path

from procedures.engine.run_folder import close_run
from procedures.engine.setting import ClinicalInput
from procedures.journal.journal import JOURNAL_FILE, Journal
from procedures.strategies.catalogue import find_strategy


def test_ct_plan_and_proposed_place_outside_the_run_are_recorded_by_hash(tmp_path: Path) -> None:
    case, run = tmp_path / "case", tmp_path / "run"
    (case / "ct").mkdir(parents=True)
    run.mkdir()
    files = [case / "ct" / "1.dcm", case / "plan.toml", case / "place.json"]
    for one in files:
        one.write_text(one.name)
    clinical = ClinicalInput(case / "ct", case / "plan.toml", find_strategy("ocs"))
    close_run(run, Journal(run), 0.0, "done", clinical)
    last = json.loads((run / JOURNAL_FILE).read_text().splitlines()[-1])
    assert set(last["inputs"]) == {str(one) for one in files}

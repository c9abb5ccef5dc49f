"""Where the units of a study are computed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from procedures.studies.errors import ExtraMissing
from procedures.studies.ledger import Ledger
from procedures.studies.registration import RegistrationStudy
from procedures.studies.workers import run_study


def test_without_dask_a_scheduler_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    study = RegistrationStudy(1, seed=5, fiducials=(3,))
    with pytest.raises(ExtraMissing, match="STU-004"):
        run_study(study, Ledger(tmp_path, study), scheduler="tcp://127.0.0.1:1")

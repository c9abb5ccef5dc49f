"""Where `ronna-plan new` writes, and where a case looks for it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from user_commands import in_this_process

from procedures.cli import planning_inputs
from procedures.cli.plan import app

SERIES = SimpleNamespace(series_instance_uid="1.2.3", patient_position="HFS")


@pytest.fixture(autouse=True)
def series(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Any folder is the CT of a head with three spheres."""
    spheres_mm = [(0.0, 0.0, 0.0), (80.0, 0.0, 0.0), (20.0, 110.0, 0.0)]
    monkeypatch.setattr(planning_inputs, "read_ct", lambda *_, **__: (SERIES, spheres_mm, ()))
    monkeypatch.chdir(tmp_path)


def test_a_plan_written_elsewhere_than_beside_its_ct_says_where_a_case_expects_it(tmp_path: Path) -> None:
    done = in_this_process(app, "new", "patient/ct")
    assert (tmp_path / "plan.toml").exists()
    said = f"run --case {tmp_path / 'patient'} expects it beside the series, as {tmp_path}/patient/plan.toml"
    assert said in done.stdout
    assert f"written to {tmp_path / 'plan.toml'}" in done.stdout


@pytest.mark.parametrize(("series_dir", "out"), [("ct", "plan.toml"), ("scan", "other.toml")])
def test_a_plan_beside_its_ct_or_of_a_series_by_another_name_says_nothing_of_a_case(
    series_dir: str, out: str
) -> None:
    assert "--case" not in in_this_process(app, "new", series_dir, "--out", out).stdout

"""The doctor shows a device of a kind it does not know like any other."""

from pathlib import Path

import pytest
from force_sensor import DECLARED, ScaledForceSensor, install

from procedures.cli.doctor.report import examine


@pytest.mark.parametrize("plugged_in", [True, False])
def test_the_doctor_shows_a_device_of_an_unknown_kind(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, plugged_in: bool
) -> None:
    install(monkeypatch)
    monkeypatch.setattr(ScaledForceSensor, "plugged_in", plugged_in)
    path = tmp_path / "theatre.toml"
    path.write_text(f'theatre = "lab"\n{DECLARED}')
    (diagnostic,) = examine(path).devices
    assert (diagnostic.subject, diagnostic.well) == ("device device.force", plugged_in)
    assert ("F1 7 1.0" in diagnostic.seen) is plugged_in


def test_a_driver_that_is_not_of_the_kind_of_its_table_is_a_problem_that_names_what_it_lacks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    install(monkeypatch)
    path = tmp_path / "theatre.toml"
    path.write_text(f'theatre = "lab"\n{DECLARED.replace("device.force", "tracker")}')
    report = examine(path)
    (verdict,) = (one for one in report.verdicts if one.of == "tracker")
    (cause,) = verdict.because
    assert "DEV-008 tracker: driver force does not provide OpticalTracker: it lacks markers_mm" in cause

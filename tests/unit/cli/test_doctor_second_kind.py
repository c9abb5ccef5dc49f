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

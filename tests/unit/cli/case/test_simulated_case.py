"""A simulated theatre does not outlive the case that could not be started."""

import errno
import os
from pathlib import Path

import pytest

from procedures.cli.case import simulated_case
from procedures.cli.case.request import CaseRequest
from procedures.cli.case.simulated_case import SimulatedCase


def test_the_theatre_ends_when_its_patient_cannot_be_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[str] = []

    class Theatre:
        def __init__(self, *_arguments: str, **_more: object) -> None: ...

        def end(self) -> None:
            ended.append("theatre")

    def no_process_left(*_: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(simulated_case, "TheatreProcess", Theatre)
    monkeypatch.setattr(simulated_case, "_start_phantom", no_process_left)
    with pytest.raises(OSError, match="Resource temporarily unavailable"):
        SimulatedCase(CaseRequest(out=tmp_path), tmp_path, tmp_path / "phantom")
    assert ended == ["theatre"]

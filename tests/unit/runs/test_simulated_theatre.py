"""A simulated theatre does not outlive the case that could not be started."""

import errno
import os
from pathlib import Path

import pytest

from procedures.runs import simulated_theatre
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.simulated_theatre import SimulatedTheatre


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

    monkeypatch.setattr(simulated_theatre, "TheatreProcess", Theatre)
    monkeypatch.setattr(simulated_theatre, "_start_phantom", no_process_left)
    with pytest.raises(OSError, match="Resource temporarily unavailable"):
        SimulatedTheatre(RunRequest(procedure=CaseProcedure()), tmp_path, tmp_path / "phantom")
    assert ended == ["theatre"]

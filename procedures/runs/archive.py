"""Rehearsal with an archive: the CT goes there and comes back over the network, results join its study.

The simulated patient's scanner stores the series, we fetch it as `ronna-dicom fetch` does, and the case runs
on what has arrived. At its end its DICOM objects are stored with the patient and study of that CT.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from procedures.exchange.dicom_network.peers import Peer, require_network
from ronna_hw.command_line.messages import tell
from ronna_hw.host.files import remove_folder
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from collections.abc import Sequence

    from procedures.exchange.dicom_network.requests import Requester

TITLE, PORT, LISTEN = "RONNA", 11112, "127.0.0.1"  # as which the archive knows this computer


@dataclass(frozen=True)
class Archive:
    """An archive and the port at which it reaches this computer."""

    peer: Peer
    port: int = PORT

    @classmethod
    def parse(cls, text: str, port: int = PORT) -> Archive:
        """Read AETITLE@HOST:PORT. Raises DCM-001, DCM-002."""
        require_network()
        return cls(Peer.parse(text), port)

    def check(self) -> None:
        """Ask whether it is there, before any part of the case is opened. Raises DCM-005 to DCM-007."""
        self._requester().echo()

    def pass_through(self, patient: Path) -> None:
        """Store a patient's CT in the archive, and replace it by what the archive sends back.

        Raises DCM-005 to DCM-008, and the errors of `read_series`.
        """
        from procedures.exchange.dicom_network.fetching import fetch_series
        from procedures.imaging.dicom.slice_headers import CT_FOLDER
        from procedures.imaging.series import read_series

        ct = patient / CT_FOLDER
        study, series = self._store([ct])
        with TemporaryDirectory(prefix="ronna-archive-") as inbox:
            found = fetch_series(self._requester(), study, series, Path(inbox), LISTEN, self.port, tell)
            arrived = patient / f".{CT_FOLDER}"
            found.slices.rename(arrived)
        read_series(arrived)
        remove_folder(ct)
        arrived.rename(ct)

    def store_results(self, run: Path) -> None:
        """Store a run's DICOM objects in its CT's study. Raises EXC-002 to EXC-008, DCM-005 to DCM-007."""
        from procedures.exchange.run_export import export_run
        from procedures.imaging.dicom.slice_headers import CT_FOLDER
        from procedures.runs.case import SIMULATED_CASE
        from procedures.runs.simulated_theatre import find_truth

        with TemporaryDirectory(prefix="ronna-archive-") as folder:
            exported = export_run(run, Path(folder), find_truth, run / SIMULATED_CASE / CT_FOLDER)
            self._store([path for path in exported.files if path.suffix == ".dcm"])

    def _store(self, paths: Sequence[Path]) -> tuple[str, str]:
        """Store files; return study and series of the first. Raises DCM-005 to DCM-007, DCM-014."""
        from procedures.exchange.dicom_network.errors import REQUEST_FAILED
        from procedures.exchange.dicom_network.sending import read_objects

        _, objects = read_objects(paths)
        outcome = self._requester().store(objects)
        if failed := next(filter(None, outcome), ""):
            stored = sum(not reason for reason in outcome)
            raise REQUEST_FAILED(
                f"{self.peer} has not stored all of a rehearsal: {failed}",
                expected=f"{len(objects)} objects",
                got=f"{stored}",
            )
        tell(f"{format_count(len(objects), 'object')} stored at {self.peer}")
        return str(objects[0].StudyInstanceUID), str(objects[0].SeriesInstanceUID)

    def _requester(self) -> Requester:
        from procedures.exchange.dicom_network.requests import Requester

        return Requester(TITLE, self.peer)

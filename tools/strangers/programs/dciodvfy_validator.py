"""dciodvfy of dicom3tools, which judges DICOM objects against the standard."""

from __future__ import annotations

import subprocess
from pathlib import Path
from tempfile import mkdtemp

from whole_run import whole_run

from procedures.exchange.run_export import export_run


def errors_of(name: str) -> list[str]:
    """Export a run; return the errors in one of its objects."""
    folder = Path(mkdtemp())
    export_run(whole_run(folder / "run"), folder / "out")
    line = ["dciodvfy", "-new", str(folder / "out" / name)]
    said = subprocess.run(line, capture_output=True, text=True, check=False).stderr.splitlines()
    assert said, "it says nothing of the object"
    return [one for one in said if one.startswith("Error")]


def finds_no_error_in_the_spheres() -> None:
    assert errors_of("spheres.dcm") == []


def finds_no_error_in_the_registration() -> None:
    assert errors_of("registration-all.dcm") == []


def finds_no_error_in_the_structure_set() -> None:
    assert errors_of("structures.dcm") == []


def finds_no_error_in_the_report_page() -> None:
    assert errors_of("report-page.dcm") == []


def finds_no_error_in_the_postoperative_report() -> None:
    assert errors_of("postoperative-report.dcm") == []

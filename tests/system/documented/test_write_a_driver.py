"""The how-to for drivers is correct: its files can be built, and its driver passes the suite."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ronna_hw.host.child_process import ChildProcess

DOCUMENT = Path(__file__).parents[3] / "docs" / "how-to" / "extending" / "write-a-driver.md"
BLOCK = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TABLE = re.compile(r"^```toml\n(.*?)^```$", re.MULTILINE | re.DOTALL)  # of the theatre file
# What an installed package has, without the time that installing it takes.
METADATA = "Metadata-Version: 2.1\nName: lumen-tracker\nVersion: 0.1\n"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the page, as if installed."""
    folder = tmp_path_factory.mktemp("lumen-tracker")
    files = dict(BLOCK.findall(DOCUMENT.read_text(encoding="utf-8")))
    assert set(files) == {
        "pyproject.toml",
        "lumen/__init__.py",
        "lumen/errors.py",
        "lumen/line.py",
        "lumen/tracker.py",
        "lumen/probe.py",
        "lumen/conformance.py",
        "lumen/device.py",
    }
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(content, encoding="utf-8")
    information = folder / "lumen_tracker-0.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(METADATA)
    groups = tomllib.loads(files["pyproject.toml"])["project"]["entry-points"]
    (information / "entry_points.txt").write_text(
        "\n".join(
            line
            for group, points in groups.items()
            for line in (f"[{group}]", *(f"{name} = {target}" for name, target in points.items()))
        )
    )
    return folder


@pytest.fixture
def device(package: Path) -> Iterator[str]:
    """Endpoint of the device of the page."""
    script = package / "lumen" / "device.py"
    with ChildProcess("the device of the page", [sys.executable, "-P", str(script), "0"]) as child:
        yield child.ready["endpoint"]


def conformance(package: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).parent / "ronna-conformance"
    return subprocess.run(
        [program, "tracker", "--driver", "lumen", *arguments],
        env={**os.environ, "PYTHONPATH": str(package)},
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
    )


def test_the_driver_of_the_page_passes_the_suite(package: Path, device: str, tmp_path: Path) -> None:
    report_file = tmp_path / "report.json"
    run = conformance(package, "--endpoint", device, "--report", str(report_file))
    assert run.returncode == 0, run.stdout + run.stderr
    report = json.loads(report_file.read_text())
    outcomes = {case["number"]: case["outcome"] for case in report["cases"]}
    assert list(outcomes) == [*(f"T{number:02d}" for number in range(1, 28)), "L01", "L02"]
    assert {number for number, outcome in outcomes.items() if outcome != "PASS"} == {"T22"}
    assert "checksums" in next(case["reason"] for case in report["cases"] if case["number"] == "T22")
    assert report["identity"]["model"] == "Lumen-2000"


@pytest.mark.slow
def test_a_mistake_in_the_driver_of_the_page_is_detected(
    package: Path, device: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The page tells its reader to spoil the driver and look: that must show."""
    spoilt = tmp_path_factory.mktemp("spoilt")
    for path in package.rglob("*"):
        if path.is_file():
            copy = spoilt / path.relative_to(package)
            copy.parent.mkdir(exist_ok=True)
            copy.write_bytes(path.read_bytes())
    for name, right, wrong in (
        ("tracker.py", "Validity.MISSING, None, None, None", "Validity.MISSING, (0, 0, 0, 0), (0, 0, 0), 0"),
        ("line.py", "if found == tag:", "if found:"),
    ):
        file = spoilt / "lumen" / name
        text = file.read_text()
        assert right in text
        file.write_text(text.replace(right, wrong))
    run = conformance(spoilt, "--endpoint", device, "--json")
    assert run.returncode == 1
    failed = {case["number"] for case in json.loads(run.stdout)["cases"] if case["outcome"] == "FAIL"}
    assert {"T09", "T20"} <= failed


def test_the_driver_of_the_page_reports_a_missing_device(package: Path) -> None:
    run = conformance(package, "--endpoint", "tcp://127.0.0.1:1")
    assert run.returncode == 4
    assert run.stderr.startswith("LUM-001")
    assert "Traceback" not in run.stderr


def doctor(package: Path, endpoint: str) -> tuple[int, list[dict[str, Any]]]:
    """Exit code and the findings about the device at an endpoint."""
    theatre = package / "theatre.toml"
    (table,) = TABLE.findall(DOCUMENT.read_text(encoding="utf-8"))
    there, count = re.subn(r'(?<=endpoint = )".*"', f'"{endpoint}"', table)
    assert count == 1
    theatre.write_text(f'schema = 1\ntheatre = "lab"\n{there}')
    done = subprocess.run(
        [Path(sys.executable).parent / "ronna-procedure", "doctor", "--config", theatre, "--json"],
        env={**os.environ, "PYTHONPATH": str(package)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    findings = json.loads(done.stdout)["findings"]
    return done.returncode, [one for one in findings if one["subject"].split()[0] in ("line", "device")]


@pytest.mark.slow
def test_the_doctor_shows_the_findings_of_the_probe_on_the_page(package: Path, device: str) -> None:
    code, (line, tracker) = doctor(package, device)
    assert (code, line["well"], tracker["well"]) == (3, True, True)  # for a case, arm and cameras are missing
    assert line["seen"] == "answered Lumen-2000 L-0042 1.3"
    code, (line, tracker) = doctor(package, "tcp://127.0.0.1:1")
    assert (code, line["well"], tracker["well"]) == (4, False, False)
    assert "LUM-001" in tracker["seen"]
    assert tracker["advice"] == line["advice"]

"""The example notebooks are executed as a reader executes them, and what cannot be executed says why."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from documented import NOTEBOOKS, execute_notebook, final_sentence
from undisturbed import finished_mini
from user_commands import in_this_process

from studies.cli import app


def test_the_committed_notebooks_have_no_output_and_begin_with_what_a_reader_needs() -> None:
    names = {path.name for path in NOTEBOOKS.glob("*.ipynb")}
    assert names == {
        *("tracker-noise.ipynb", "one-case.ipynb", "strategies.ipynb"),
        "two-rehearsals.ipynb",
    }
    for name in names:
        first, *others = json.loads((NOTEBOOKS / name).read_text())["cells"]
        assert "**You need**" in "".join(first["source"])
        assert not any(cell.get("outputs") for cell in others)


def test_one_case_is_read_from_the_ct_to_the_error(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (tmp_path / "runs").symlink_to(finished_mini(tmp_path_factory)[0])
    cells = execute_notebook("one-case.ipynb", tmp_path)
    assert "1 of 1 stayed within the predicted radius" in final_sentence(cells)


@pytest.mark.slow
def test_two_rehearsals_differ_by_their_strategy_alone(tmp_path: Path) -> None:
    cells = execute_notebook("two-rehearsals.ipynb", tmp_path)
    assert "The two registrations put T1" in final_sentence(cells)
    (compared,) = cells[3]["outputs"]
    assert "Options: 1 of " in "".join(compared["data"]["text/plain"])
    assert "<td>strategy</td><td>ocs</td><td>nos</td>" in "".join(compared["data"]["text/html"])
    assert (tmp_path / "comparison.html").is_file()


@pytest.mark.slow
def test_tracker_noise_is_that_of_a_sphere_and_not_of_a_place_in_the_list(tmp_path: Path) -> None:
    cells = execute_notebook("tracker-noise.ipynb", tmp_path)
    assert "Along its line of sight" in final_sentence(cells)
    (said,) = cells[3]["outputs"]
    text = "".join(said["text"])
    assert text.count("300 readings") == 3  # each sphere of the mini scene in every frame
    assert "by place in the list: sd [[1" in text  # tens of millimetres


@pytest.mark.slow
def test_strategies_are_compared_arm_by_arm(tmp_path: Path) -> None:
    cells = execute_notebook("strategies.ipynb", tmp_path)
    assert "reduces the mean error by" in final_sentence(cells)


def test_without_the_extra_a_notebook_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "nbclient", None)
    done = in_this_process(app, "notebook", NOTEBOOKS / "one-case.ipynb", "--out", tmp_path)
    assert done.returncode != 0
    assert "STU-016" in done.stderr
    assert "make setup" in done.stderr


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("missing.ipynb", None, "CLI-005"),
        ("plan.toml", "schema = 1\n", "STU-018"),
        ("list.ipynb", "[]", "STU-018"),
    ],
)
def test_what_is_no_notebook_is_refused(name: str, content: str | None, code: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    done = in_this_process(app, "notebook", tmp_path / name, "--out", tmp_path)
    assert done.returncode != 0
    assert code in done.stderr


def write_notebook(path: Path, source: str) -> Path:
    """A notebook with this one cell."""
    cell: dict[str, object] = {
        "cell_type": "code",
        "id": "a",
        "source": source,
        "metadata": {},
        "outputs": [],
        "execution_count": None,
    }
    path.write_text(json.dumps({"cells": [cell], "metadata": {}, "nbformat": 4, "nbformat_minor": 5}))
    return path


def test_a_notebook_is_not_overwritten_by_its_executed_copy(tmp_path: Path) -> None:
    path = write_notebook(tmp_path / "own.ipynb", "1")
    before = path.read_bytes()
    done = in_this_process(app, "notebook", path, "--out", tmp_path)
    assert "CLI-005" in done.stderr
    assert path.read_bytes() == before


def test_a_cell_that_ends_its_kernel_leaves_no_process_and_names_no_time_limit(tmp_path: Path) -> None:
    started = tmp_path / "started"
    detach = f"sleep 600 </dev/null >/dev/null 2>&1 & echo $! > {started}"
    source = f"import os, subprocess\nsubprocess.run(['setsid', 'sh', '-c', {detach!r}])\nos._exit(3)"
    path = write_notebook(tmp_path / "own.ipynb", source)
    done = in_this_process(app, "notebook", path, "--out", tmp_path / "out")
    assert "STU-017" in done.stderr
    assert "limit" not in done.stderr
    assert not Path("/proc", started.read_text().strip()).exists()


def test_a_cell_that_fails_is_named_with_its_error(tmp_path: Path) -> None:
    write_notebook(tmp_path / "own.ipynb", "1 / 0\n2")
    done = in_this_process(app, "notebook", tmp_path / "own.ipynb", "--out", tmp_path / "out")
    assert "STU-017" in done.stderr
    assert "cell 1 of own.ipynb (1 / 0)" in done.stderr
    assert "ZeroDivisionError" in done.stderr
    assert not (tmp_path / "out" / "own.ipynb").exists()

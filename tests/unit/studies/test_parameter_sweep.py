"""A sweep calls a function for every combination once, keeps what is finished, and returns one table."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from coded_errors import raises

from procedures import run_case
from procedures.exchange import run_tables
from ronna_hw.arguments import WrongArgument
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.errors import LinkTimeout, RonnaError
from ronna_hw.evidence.manifest import REQUEST_FILE, SEAL_FILE
from ronna_hw.loaded_run import RunColumn, RunTable
from studies import parameter_sweep, sweep
from studies.errors import OTHER_STUDY, SWEEP_IN_USE
from studies.sweep_ledger import FILE

CALLS: list[tuple[float, str]] = []


def jitter(distance_mm: float, unit: str) -> dict[str, object]:
    CALLS.append((distance_mm, unit))
    if distance_mm > 5000.0:
        raise WrongArgument("nothing is seen from there")
    return {"jitter_mm": distance_mm / 1000.0, "note": unit.upper()}


def whose_process(number: int) -> int:
    return os.getpid() + 0 * number


def adds(offset: int) -> Callable[[], int]:
    def offset_alone() -> int:
        return offset

    return offset_alone


class Counter:
    def __init__(self, start: int) -> None:
        self.start = start

    def count(self, number: int) -> int:
        return self.start + number


def calls(what: Callable[[], int]) -> int:
    return what()


def test_functions_of_one_text_are_points_of_their_own_and_none_is_kept_for_the_next_process(
    tmp_path: Path,
) -> None:
    assert sweep(calls, what=[adds(1), adds(2), lambda: 3, lambda: 4]).value.tolist() == [1, 2, 3, 4]
    with raises(WrongArgument, match="what is a function without a name of its own"):
        sweep(calls, folder=tmp_path / "closures", what=[adds(1), adds(2)])
    with raises(WrongArgument, match="needs a function that has a name of its own"):
        sweep(Counter(1).count, folder=tmp_path / "methods", number=[1])
    with raises(WrongArgument, match="needs a function that has a name of its own"):
        sweep(adds(1), folder=tmp_path / "functions")


def a_case_like_a_real_one(scene: str, seed: int, strategy: str) -> Any:
    row = ["T1" if one.kind is str else np.full(one.size, seed) for one in run_tables.TARGETS]
    return SimpleNamespace(name="a", outcome="done", targets=RunTable.of(run_tables.TARGETS, [row]))


def test_the_columns_of_a_real_run_are_beside_the_arguments() -> None:
    found = sweep(a_case_like_a_real_one, workers=1, scene="mini", seed=[1, 2], strategy=["ocs", "improved"])
    assert found.strategy.tolist() == ["ocs", "improved"] * 2
    assert set(found.target_strategy) == {"T1"}  # which the operator may have changed


SCRIPT = """
import glob
from studies import parameter_sweep, sweep

print("begins")
print(sweep(glob.escape, workers=2, pathname=["a", "b"]).value.tolist())
"""


def test_a_script_needs_no_guard(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    line = [sys.executable, str(tmp_path / "script.py")]
    done = subprocess.run(line, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.stdout == "begins\n['a', 'b']\n", done.stderr


def a_case(seed: int, out: Path, progress: bool) -> Any:
    columns = (
        RunColumn("name", str, ""),
        RunColumn("error_mm", float, ""),
        RunColumn("at_mm", float, "", (3,)),
    )
    targets = RunTable.of(columns, [("T1", 0.1 * seed, (0.0, 0.0, 0.0)), ("T2", np.nan, (0.0, 0.0, 0.0))])
    out.mkdir(parents=True, exist_ok=True)
    return SimpleNamespace(name=f"{seed}", outcome=f"bar {progress}", targets=targets)


@pytest.fixture(autouse=True)
def no_calls_yet() -> None:
    CALLS.clear()


def test_every_combination_is_a_row_with_its_arguments_and_results(tmp_path: Path) -> None:
    found = sweep(jitter, folder=tmp_path, workers=1, distance_mm=np.array([950.0, 2000.0]), unit=["a", "b"])
    assert found.distance_mm.tolist() == [950.0, 950.0, 2000.0, 2000.0]
    assert found.unit.tolist() == ["a", "b", "a", "b"]
    assert found.jitter_mm.tolist() == [0.95, 0.95, 2.0, 2.0]
    assert found.note.tolist() == ["A", "B", "A", "B"]


def test_the_same_sweep_with_more_points_runs_only_those_that_are_new(tmp_path: Path) -> None:
    sweep(jitter, folder=tmp_path, workers=1, distance_mm=[950.0], unit="a")
    with (tmp_path / FILE).open("a") as file:
        file.write('{"point": "cut by a')  # as a kill leaves it
    CALLS.clear()
    found = sweep(jitter, folder=tmp_path, workers=1, distance_mm=[950.0, 2000.0], unit="a")
    assert CALLS == [(2000.0, "a")]
    assert found.distance_mm.tolist() == [950.0, 2000.0]
    sweep(jitter, folder=tmp_path, workers=1, distance_mm=[950.0, 2000.0], unit="a")
    assert len(CALLS) == 1


def sweep_into(other: Path) -> bool:
    with raises(SWEEP_IN_USE, match=str(os.getpid())):
        sweep(jitter, folder=other, workers=1, distance_mm=[950.0], unit="a")
    return True


def test_a_second_sweep_waits_for_nothing_and_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    sweep(sweep_into, folder=tmp_path, workers=1, other=tmp_path)
    with raises(OTHER_STUDY):  # it has the folder for itself, and looks into it
        sweep(jitter, folder=tmp_path, workers=1, distance_mm=[950.0], unit="a")


def test_what_a_point_refuses_is_a_row_and_the_sweep_goes_on(tmp_path: Path) -> None:
    found = sweep(jitter, folder=tmp_path, workers=1, distance_mm=[6000.0, 950.0], unit="a")
    assert [text[:7] for text in found.error] == ["ARG-001", ""]
    assert np.isnan(found.jitter_mm).tolist() == [True, False]


def unreachable(number: int) -> int:
    CALLS.append((number, ""))
    raise LinkTimeout("nothing answers")


def test_a_link_that_failed_is_told_and_tried_again_by_the_next_call(tmp_path: Path) -> None:
    for _ in range(2):
        found = sweep(unreachable, folder=tmp_path, workers=1, number=1)
        assert "nothing answers" in found.error[0]
    assert len(CALLS) == 2


def takes_all(what: object) -> str:
    return type(what).__name__


def test_a_function_and_a_path_are_arguments_and_what_has_no_name_is_refused_at_once(tmp_path: Path) -> None:
    found = sweep(takes_all, folder=tmp_path, workers=1, what=[jitter, tmp_path])
    assert found.value.tolist() == ["function", "PosixPath"]
    with raises(WrongArgument):
        sweep(takes_all, folder=tmp_path, workers=1, what=object())


def test_without_a_folder_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        sweep(jitter, workers=1, distance_mm=950.0, unit="a")
    assert len(CALLS) == 2
    assert not list(tmp_path.iterdir())


def overwrites(unit: str) -> dict[str, object]:
    return {"unit": unit.upper()}


def repeats(unit: str, wide: bool) -> dict[str, object]:
    return {"unit": unit, "narrow": not wide}


def fills(distance_mm: float) -> dict[str, object]:
    return {"profile_mm": np.full(3, distance_mm)}


def test_a_column_of_an_arguments_name_is_refused_if_it_has_another_value() -> None:
    with raises(WrongArgument, match=r"'unit'.* expected 'a', got 'A'"):
        sweep(overwrites, workers=1, unit="a")
    found = sweep(repeats, workers=1, unit="a", wide=[True, False])
    assert (found.unit.tolist(), found.wide.tolist(), found.narrow.tolist()) == (
        ["a", "a"],
        [True, False],
        [False, True],
    )
    assert found.wide.dtype == found.narrow.dtype == bool


def test_what_is_no_cell_of_a_table_names_its_column_and_point() -> None:
    with raises(WrongArgument, match=r"'profile_mm' .* at the point {'distance_mm': 1.0}"):
        sweep(fills, workers=1, distance_mm=[1.0, 2.0])


def test_an_argument_that_cannot_be_named_is_told_by_its_name() -> None:
    with raises(WrongArgument, match=r"cannot name number; .* number=list"):
        sweep(whose_process, number=(seed for seed in (1, 2)))


def test_a_table_without_an_error_has_the_column_of_errors() -> None:
    assert sweep(jitter, workers=1, distance_mm=1.0, unit="a").error.tolist() == [""]


def test_points_are_worked_on_in_other_processes(tmp_path: Path) -> None:
    found = sweep(whose_process, folder=tmp_path, workers=2, number=[1, 2])
    assert os.getpid() not in found.value.tolist()


def test_the_targets_of_a_loaded_run_are_rows_and_what_it_writes_stays_in_the_folder(tmp_path: Path) -> None:
    found = sweep(a_case, folder=tmp_path, workers=1, seed=[1, 2])
    assert found.name.tolist() == ["T1", "T2", "T1", "T2"]
    assert found.error_mm[::2].tolist() == pytest.approx([0.1, 0.2])
    assert np.isnan(found.error_mm[1])
    assert set(found.outcome) == {"bar False"}
    assert (tmp_path / "runs").is_dir()


def test_a_folder_with_points_of_another_function_is_refused(tmp_path: Path) -> None:
    sweep(jitter, folder=tmp_path, workers=1, distance_mm=950.0, unit="a")
    with raises(OTHER_STUDY):
        sweep(whose_process, folder=tmp_path, workers=1, number=1)


def test_runs_that_an_earlier_sweep_left_unfinished_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("finished", "cut-off"):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / REQUEST_FILE).touch()
    (tmp_path / "runs" / "finished" / SEAL_FILE).touch()
    sweep(jitter, folder=tmp_path, workers=1, distance_mm=950.0, unit="a")
    told = capsys.readouterr().err
    assert "during 1 run in" in told
    assert "may be removed: cut-off" in told


def test_an_argument_without_a_value_is_refused(tmp_path: Path) -> None:
    with raises(WrongArgument):
        sweep(whose_process, folder=tmp_path, number=[])


def test_the_point_of_a_damaged_line_is_run_again(tmp_path: Path) -> None:
    sweep(jitter, folder=tmp_path, workers=1, distance_mm=[950.0, 2000.0], unit="a")
    lines = (tmp_path / FILE).read_text(encoding="utf-8").splitlines(keepends=True)
    (tmp_path / FILE).write_text(lines[0] + lines[1].replace('"rows"', '"rose"') + lines[2], encoding="utf-8")
    CALLS.clear()
    sweep(jitter, folder=tmp_path, workers=1, distance_mm=[950.0, 2000.0], unit="a")
    assert CALLS == [(950.0, "a")]


def test_a_function_without_a_name_is_not_kept_in_a_folder(tmp_path: Path) -> None:
    with raises(WrongArgument, "ARG-001"):
        sweep(partial(jitter, unit="a"), folder=tmp_path, workers=1, distance_mm=[950.0])


def killed(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_killed_worker_process_names_the_point_and_what_to_do() -> None:
    with raises(RonnaError, "STU-005", match=r"'number': 1"):
        sweep(killed, workers=2, number=[1])


def test_what_cannot_be_called_is_refused_before_the_first_point() -> None:
    with raises(WrongArgument, match="no function; expected a function, without quotes"):
        sweep("jitter", distance_mm=1.0)  # type: ignore[arg-type]
    with raises(
        WrongArgument, match="'distance_mm'; expected the arguments distance_mm, unit, got distance, unit"
    ):
        sweep(jitter, distance=1.0, unit="a")
    with raises(
        WrongArgument, match="workers of sweep is no number of processes; expected at least 1.* got 0"
    ):
        sweep(jitter, workers=0, distance_mm=1.0, unit="a")
    assert not CALLS


def test_a_result_that_is_missing_or_named_as_the_column_of_refusals_is_told_at_once() -> None:
    with raises(WrongArgument, match=r"returned None at the point {'number': [12]}.*Is its return missing"):
        sweep(returns_nothing, number=[1, 2], progress=False)
    with raises(WrongArgument, match=r"a column 'error', .*: 1.*Rename"):
        sweep(returns_an_error_column, number=[1, 2], progress=False)


def test_refused_points_are_counted_at_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    sweep(jitter, distance_mm=[1000.0, 6000.0], unit="a", progress=False)
    assert "1 of 2 points were refused" in capsys.readouterr().err


def test_the_arguments_of_all_cases_are_checked_before_the_first_runs(tmp_path: Path) -> None:
    with raises(RonnaError, match="STR-002.*noss"):
        sweep(run_case, scene="mini", seed=range(20), strategy=["ocs", "noss"], folder=tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_a_sweep_does_not_write_into_a_run(tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").touch()
    with raises(PATH_PROBLEM, match="inside the run"):
        sweep(jitter, distance_mm=[1.0], unit="a", folder=tmp_path / "mine", progress=False)


def test_a_refused_case_has_its_run_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_sweep, "load_run", lambda _folder: SimpleNamespace(outcome="refused"))
    table = sweep(refused_case, seed=[1], workers=1, progress=False)
    assert (table.run[0], table.outcome[0]) == ("20260101T000000-s1-abcd", "refused")


def refused_case(seed: int) -> None:
    error = LinkTimeout(f"no answer for seed {seed}")
    error.run = Path("runs/20260101T000000-s1-abcd")
    raise error


def returns_nothing(number: int) -> None:
    assert number


def returns_an_error_column(number: int) -> dict[str, object]:
    return {"error": number}

"""Cases of many seeds: all of them complete, and the tip is where it should be."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from user_commands import Commands

SEEDS = range(20)
SUPERFICIAL_MM = 50.0  # depth: as the first clinical study divided its targets
SUPERFICIAL_MEAN_MM = 0.25  # RONNA G3 measured 0.43 mm
DEEP_MEAN_MM = 0.45  # and 0.88
LARGEST_MM = 1.5
# 60 targets: of an honest 95 % limit some three are exceeded; seven or more come once in fifty campaigns.
MOST_BEYOND_LIMIT = 0.12
FAULTS = {
    "none": "",
    "sphere hidden at first": "at 0 s: tracker occlude marker 2 for 0.3 s\n",
    "replies lost": "when step == relocalization: robot drop 5 % for 2 s\n",
    "packets lost": "when step == relocalization: camera drop 1 % for 5 s\n",
}


def _run(commands: Commands, out: Path, seed: int, *words: str) -> dict[str, Any]:
    line = ("run", "--sim", "--seed", str(seed), *words, "--out", str(out), "--json")
    done = commands.run("ronna-procedure", *line, timeout_s=120)
    assert done.returncode == 0, f"seed {seed}: {done.stderr}"
    outcome: dict[str, Any] = json.loads(done.stdout)
    return outcome


@pytest.fixture(scope="module")
def outcomes(shared_commands: Commands, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    out = tmp_path_factory.mktemp("runs")
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda seed: _run(shared_commands, out, seed), SEEDS))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_seed_completes_and_finds_every_sphere(outcomes: list[dict[str, Any]]) -> None:
    assert [outcome["outcome"] for outcome in outcomes] == ["done"] * len(SEEDS)
    for outcome in outcomes:
        assert (outcome["ct"]["found"], outcome["ct"]["missed"], outcome["ct"]["false"]) == (5, 0, 0)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_application_error_stays_within_its_limits(outcomes: list[dict[str, Any]]) -> None:
    rows = [row for outcome in outcomes for row in outcome["targets"]]
    assert len(rows) == 3 * len(SEEDS)
    errors_mm = np.array([row["application_error_mm"] for row in rows])
    deep = np.array([row["depth_mm"] > SUPERFICIAL_MM for row in rows])
    assert np.mean(errors_mm[~deep]) <= SUPERFICIAL_MEAN_MM
    assert np.mean(errors_mm[deep]) <= DEEP_MEAN_MM
    assert np.max(errors_mm) <= LARGEST_MM


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_predicted_error_matches_the_size_of_the_error(outcomes: list[dict[str, Any]]) -> None:
    rows = [row for outcome in outcomes for row in outcome["targets"]]
    errors = np.array([row["application_error_mm"] for row in rows])
    predicted = np.array([row["predicted_tre_mm"] for row in rows])
    assert 0.6 < np.sqrt(np.mean(errors**2) / np.mean(predicted**2)) < 1.4
    assert np.mean(errors > 1.61 * predicted) <= MOST_BEYOND_LIMIT


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_same_seed_gives_the_same_results_on_the_default_scene(
    outcomes: list[dict[str, Any]], commands: Commands, tmp_path: Path
) -> None:
    again = _run(commands, tmp_path, 3)
    for key in ("ct", "registration", "targets"):
        assert again[key] == outcomes[3][key]


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("markers", [3, 4, 6, 8])
def test_every_seed_of_the_matrix_reaches_its_target(
    commands: Commands, tmp_path: Path, markers: int, fault: str
) -> None:
    (script := tmp_path / "faults.txt").write_text(FAULTS[fault])
    for seed in range(8):
        words = ("--scene", "mini", "--markers", str(markers), "--faults", str(script))
        outcome = _run(commands, tmp_path / "runs", seed, *words)
        assert outcome["max_application_error_mm"] <= LARGEST_MM

"""Long runs on the mini scene: a matrix of seeds, sizes and faults, and kills at random moments."""

import json
from pathlib import Path

import pytest
from user_commands import Commands

pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]

LARGEST_ERROR_MM = 1.5
FAULTS = {
    "none": "",
    "sphere hidden at first": "at 0 s: tracker occlude marker 2 for 0.3 s\n",
    "replies lost": "when step == relocalization: robot drop 5 % for 2 s\n",
    "packets lost": "when step == relocalization: camera drop 1 % for 5 s\n",
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("markers", [3, 4, 6, 8])
def test_every_seed_of_the_matrix_reaches_its_target(
    commands: Commands, tmp_path: Path, markers: int, fault: str
) -> None:
    script = tmp_path / "faults.txt"
    script.write_text(FAULTS[fault])
    for seed in range(8):
        options = {"--scene": "mini", "--seed": seed, "--markers": markers, "--faults": script}
        words = [str(word) for pair in options.items() for word in pair]
        done = commands.run(
            "ronna-procedure",
            "run",
            "--sim",
            *words,
            "--out",
            str(tmp_path / "runs"),
            "--json",
            timeout_s=120,
        )
        assert done.returncode == 0, f"seed {seed}: {done.stderr}"
        assert json.loads(done.stdout)["max_application_error_mm"] <= LARGEST_ERROR_MM

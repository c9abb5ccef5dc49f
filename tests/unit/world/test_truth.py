from pathlib import Path

import pytest

from sim.errors import BadTruth
from sim.world.scene.named_scenes import named_scene
from sim.world.truth import TRUTH_FILE, TipSample, TrueGuide, append_sample, read_samples, sample_instrument
from sim.world.world import World

STOP_MM = 165.0


def sampled() -> TipSample:
    world = World.create(named_scene("mini"), paced=False)
    return sample_instrument(world, TrueGuide(world), "T1", STOP_MM, 0)


def test_samples_are_read_back_unchanged(tmp_path: Path) -> None:
    sample = sampled()
    append_sample(sample, tmp_path)
    assert read_samples(tmp_path) == [sample]


def test_every_bad_line_of_the_truth_is_reported(tmp_path: Path) -> None:
    append_sample(sampled(), tmp_path)
    with (tmp_path / TRUTH_FILE).open("a") as file:
        file.write('{"target": "T1"\nnonsense\n')
    with pytest.raises(BadTruth, match=r"SIM-007: .* invalid lines: line 2: .*line 3: "):
        read_samples(tmp_path)


def test_truth_that_is_not_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / TRUTH_FILE).write_bytes(b"\xff\xfe")
    with pytest.raises(BadTruth, match="not UTF-8 text"):
        read_samples(tmp_path)

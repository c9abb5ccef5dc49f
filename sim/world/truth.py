"""Ground truth of the instrument's tip, for the verifier only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from ronna_hw.bounded_input import read_json_lines
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.mistakes import describe_mistakes
from sim.errors import BadTruth
from sim.world.rigid import Matrix
from sim.world.room_shift import STILL, ShiftedRoom, rigid_move
from sim.world.true_guide import TrueGuide
from sim.world.world import World

TRUTH_FILE = "truth.jsonl"
SCENE_FILE = "scene.json"
THEATRE_FOLDER = "theatre"
LARGEST_TRUTH_BYTES = 1_000_000  # for four thousand samples
MOST_MISTAKES = 5  # listed in an error


class TipSample(Strict):
    """True position of the instrument's tip at one moment, robot frame."""

    target: str
    theatre_time_s: float
    mounted_tool: int
    arm_at_rest: bool
    tip_mm: Numbers3
    axis: Numbers3  # direction of the guide's bore, unit vector
    # Displacement of the head from its place in the scene, robot frame: turned about the origin, shifted.
    head_shift_mm: Numbers3 = STILL
    head_turn_rad: Numbers3 = STILL

    @property
    def head_moved(self) -> Matrix:
        """The displacement of the head (4, 4)."""
        return rigid_move(self.head_turn_rad, self.head_shift_mm)


def sample_instrument(world: World, guide: TrueGuide, target: str, stop_mm: float, draw: int) -> TipSample:
    """Sample the true tip of an instrument inserted up to its stop, at a target of the plan by any name.

    `draw` distinguishes insertions there: each has a different position within the bore's play.
    """
    room = ShiftedRoom(world).now()
    return TipSample(
        target=target,
        theatre_time_s=world.clock.now_s(),
        mounted_tool=world.mounted_tool(),
        arm_at_rest=world.arm().at_rest,
        tip_mm=_three(guide.instrument_tip_mm(stop_mm, target, draw)),
        axis=_three(guide.tip_frame()[:3, 2]),
        head_shift_mm=room.head_mm,
        head_turn_rad=room.head_rad,
    )


def append_sample(sample: TipSample, folder: Path) -> None:
    """Add a sample to the theatre's truth file."""
    with (folder / TRUTH_FILE).open("a", encoding="utf-8") as file:
        file.write(sample.model_dump_json() + "\n")


def read_samples(folder: Path) -> list[TipSample]:
    """All samples of a theatre, in order; an empty list when none was taken. Raises SIM-007."""
    path = folder / TRUTH_FILE
    return parse_samples(truth_bytes(path)) if path.exists() else []


def truth_bytes(path: Path) -> bytes:
    """The content of a truth file. Raises INP-001, SIM-007."""
    try:
        return read_json_lines(path, LARGEST_TRUTH_BYTES)
    except OSError as error:
        raise BadTruth(f"cannot read {path.name}: {error.strerror}") from error


def parse_samples(content: bytes) -> list[TipSample]:
    """The samples in the content of a truth file. Raises SIM-007."""
    try:
        lines = content.decode().splitlines()
    except UnicodeDecodeError as error:
        raise BadTruth(f"{TRUTH_FILE} is not UTF-8 text: {error.reason}") from error
    samples: list[TipSample] = []
    mistakes: list[str] = []
    for number, line in enumerate(lines, 1):
        try:
            samples.append(TipSample.model_validate_json(line))
        except ValidationError as error:
            mistakes.append(f"line {number}: {', '.join(describe_mistakes(error))}")
            if len(mistakes) >= MOST_MISTAKES:
                break
    if mistakes:
        raise BadTruth(f"{TRUTH_FILE} has invalid lines: {'; '.join(mistakes)}")
    return samples


def _three(vector: np.ndarray) -> Numbers3:
    x, y, z = (float(value) for value in vector)
    return (x, y, z)

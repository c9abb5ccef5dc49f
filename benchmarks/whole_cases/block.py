"""The block of seeds that a commit draws, by the rule of decision 31, and what was never drawn for it."""

from __future__ import annotations

import hashlib
import re
import subprocess
from collections.abc import Callable, Iterator
from itertools import count, islice
from pathlib import Path

from ronna_hw.arm.catalogue import ArmChoice
from sim.world.scene.arm_design import CHOSEN
from sim.world.scene.head import draw_head
from sim.world.scene.named_scenes import scene_generator

ROOT = Path(__file__).resolve().parents[2]
CASES_A_BLOCK = 20
SMALLEST_SEED = 1000  # the development used smaller ones
LARGEST_SEED = 65535  # of the command
HEX_DIGITS_USED = 8
SPHERES, FRAME_SPHERES, TARGETS = 5, 4, 3  # of the default scene, and of the x-shaped frame
COMMIT = re.compile(r"[0-9a-f]{40}")


def draw_block(commit: str, is_named: Callable[[int], bool] | None = None) -> tuple[int, ...]:
    """Return the block of a commit, given by its 40 digits. `is_named` replaces the search in its files."""
    if not COMMIT.fullmatch(commit):
        raise ValueError(f"{commit!r} is no commit of 40 lower-case hexadecimal digits")
    passed_over = is_named or (lambda seed: _is_in_files(commit, seed))
    fresh = (seed for seed in dict.fromkeys(islice(_sequence(commit), 10 * CASES_A_BLOCK)))
    return tuple(islice((seed for seed in fresh if not passed_over(seed)), CASES_A_BLOCK))


def count_passed_over(seed: int, arm: ArmChoice, *, x_frame: bool) -> int:
    """Return how many trajectories the default scene passed over because the arm could not take them."""
    spheres = FRAME_SPHERES if x_frame else SPHERES
    design = CHOSEN[arm]
    return draw_head(scene_generator(seed), spheres, TARGETS, x_frame=x_frame, arm=design).passed_over


def _sequence(commit: str) -> Iterator[int]:
    for number in count():
        digits = hashlib.sha256(f"{commit}:{number}".encode()).hexdigest()[:HEX_DIGITS_USED]
        yield SMALLEST_SEED + int(digits, 16) % (LARGEST_SEED + 1 - SMALLEST_SEED)


def _is_in_files(commit: str, seed: int) -> bool:
    """Return whether a Python file of the commit has the number as a word."""
    searched = subprocess.run(
        ["git", "grep", "-q", "-w", "-e", str(seed), commit, "--", "*.py"], cwd=ROOT, check=False
    )
    if searched.returncode > 1:
        raise ValueError(f"git cannot search commit {commit}")
    return searched.returncode == 0

"""Study of the registration on the skin: errors at targets, what was predicted of them, and refusals.

Each head is scanned under every condition; misfit, offset and noise are drawn for each registration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from procedures.registration.surface.surface_registration import SurfaceRegistration, register_surface
from ronna_hw.errors import RefusedError
from studies.campaign.study import Study, Sums, Unit, generator
from studies.surface.conditions import (
    SHIFT_COVERAGE,
    SHIFT_SIZE_MM,
    SHIFT_SKIN,
    SHIFTED,
    SHIFTS,
    SHIFTS_EACH,
    Coverage,
    Draw,
    Skin,
    conditions,
)
from studies.surface.heads import HeadInCt, draw_head
from studies.surface.kinds import Kinds
from studies.surface.scanning import Trial, draw_trial

REFUSED, CHANGED = "refused", "changed"
ERROR, RMS, LIMIT = "error mm", "predicted rms mm", "predicted limit mm"
DRAWN = "error drawn from the prediction, mm"
DIGITS = 5
SHIFT_NOISE_MM = 0.1
TARGETS_SEED = 1  # added to the study's: targets do not depend on how a scan draws


@dataclass(frozen=True)
class SurfaceStudy(Study):
    """`heads` heads under each condition, one registration each, and `shifts` with shifted skin.

    `kinds` leaves out the judged skins, so that a developer does not see them, or those of development.
    """

    heads: int = 334
    seed: int = 0
    shifts: int = SHIFTS
    kinds: Kinds = Kinds.ALL
    name: str = "surface"

    def settings(self) -> dict[str, object]:
        """Return all settings but the numbers of heads: a study with more of them continues this one."""
        return {name: value for name, value in asdict(self).items() if name not in ("heads", "shifts")}

    def units(self) -> Sequence[Unit]:
        """Return one unit for each registration, head by head, so that a stopped study is balanced."""
        names = [f"{coverage}|{skin}" for coverage, skin in conditions(self.kinds)]
        return [
            *(Unit(name, head, 1) for head in range(self.heads) for name in names),
            *(Unit(SHIFTED, head, 1) for head in range(self.shifts)),
        ]

    def run(self, unit: Unit) -> Sums:
        """Return values of one registration, keyed by the head and `refused|code` or `depth|number|what`."""
        in_ct, trial, draw = draw_unit(self.seed, unit)
        random = generator(self.seed + TARGETS_SEED, unit)
        targets = in_ct.targets_mm(random)
        found: dict[str, float] = {name: round(value, DIGITS) for name, value in asdict(draw).items()}
        found["points"] = float(len(trial.scan))
        try:
            result = register_surface(
                trial.scan,
                in_ct.shown_by(draw.offset_mm, trial.slices),
                trial.start,
                targets_ct_mm=np.concatenate(list(targets.values())),
            )
        except RefusedError as error:
            found[f"{REFUSED}|{error.code}"] = 1.0
        else:
            found[CHANGED] = float(result.changed is not None)
            for depth, places in targets.items():
                for number, target in enumerate(places):
                    values = _judge(result, trial, target, random)
                    found |= {
                        f"{depth}|{number}|{what}": round(value, DIGITS) for what, value in values.items()
                    }
        return {f"{unit.block}|{name}": value for name, value in found.items()}


def head_of(unit: Unit) -> int:
    """Return the number of a unit's head. Several shifts share one: drawing it takes longer than a scan."""
    return unit.block // SHIFTS_EACH if unit.condition == SHIFTED else unit.block


def draw_unit(seed: int, unit: Unit) -> tuple[HeadInCt, Trial, Draw]:
    """Draw the head of a unit, its scan and the values behind it."""
    in_ct = draw_head(seed, head_of(unit))
    random = generator(seed, unit)
    draw = Draw.of(random)
    if unit.condition == SHIFTED:
        draw = Draw(SHIFT_SIZE_MM, draw.length_mm, 0.0, 0.0, SHIFT_NOISE_MM)
        return in_ct, draw_trial(in_ct, SHIFT_COVERAGE, SHIFT_SKIN, draw, random, shifted=True), draw
    coverage, skin = unit.condition.split("|")
    return in_ct, draw_trial(in_ct, Coverage(coverage), Skin(skin), draw, random, shifted=False), draw


def _judge(
    result: SurfaceRegistration, trial: Trial, target: np.ndarray, random: np.random.Generator
) -> dict[str, float]:
    place = target[None]
    apart = result.robot_from_ct.apply(place) - trial.truth.apply(place)
    predicted = result.predict(target)
    return {
        ERROR: float(np.linalg.norm(apart)),
        RMS: predicted.rms_mm,
        LIMIT: predicted.limit_mm(),
        DRAWN: float(np.linalg.norm(predicted.draw_mm(random))),
    }

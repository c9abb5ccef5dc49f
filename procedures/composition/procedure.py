"""What an engine is to run, and the run that it resumes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from procedures.engine.context import ClinicalInput
    from procedures.engine.left_run import LeftRun
    from procedures.engine.order import CaseOrder
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.config import Calibrations


@dataclass(frozen=True)
class Resumption:
    """A run that is resumed; `accepted` if a script accepts what is found.

    With `only_leaving` no step is run: the arm goes home, or devices are acknowledged, which `asks` nothing.
    """

    left: LeftRun
    accepted: bool
    only_leaving: bool = False
    asks: bool = True


@dataclass(frozen=True)
class Procedure:
    """`calibrations` take the place of those of the theatre file; a replay makes a calibration's steps from
    its `recipe`.
    """

    order: CaseOrder
    title: str | None = None  # of what is no clinical case
    clinical: ClinicalInput | None = None
    calibrations: Calibrations | None = None
    recipe: Recipe | None = None

    def as_plain(self, in_use: Calibrations) -> dict[str, object] | None:
        """The recipe and the records in use, for a replay."""
        if self.recipe is None:
            return None
        records = in_use.model_dump(mode="json", exclude_none=True)
        return {"recipe": self.recipe.model_dump(mode="json"), "records": records}

"""Result of a calibration, check or measurement."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.reporting.pictures import looks_figure
from ronna_hw.evidence.manifest import RESULT_FILE

if TYPE_CHECKING:
    from procedures.reporting.calibration_figures import Figure, LookResidual


@dataclass(frozen=True)
class Calibration:
    """Figures of a calibration, check or measurement; none for a case."""

    figures: tuple[Figure, ...]
    looks: tuple[LookResidual, ...]
    looks_picture: str  # SVG; empty without looks

    @property
    def has_verdicts(self) -> bool:
        """Whether any figure has a verdict."""
        return any(one.verdict for one in self.figures)


def read_calibration(run: Path) -> Calibration:
    """Read the section from a run folder."""
    if not (run / RESULT_FILE).exists():
        return Calibration((), (), "")
    from procedures.reporting.calibration_figures import HeadFigures, load_figures  # a case needs none of it

    found = load_figures(run)
    looks = found.looks_px if isinstance(found, HeadFigures) else ()
    figures = () if found is None else tuple(found.table())
    return Calibration(figures, looks, looks_figure(looks) if looks else "")

"""Table of the localizers of marker spheres in a CT, for cases, commands, records and studies.

A localizer in it is offered by `--localizer` and by `ronna-ct localize --method`, named in the records, and
compared in the studies. Free of numerics, since every command imports this at start-up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Protocol

from procedures import imaging

if TYPE_CHECKING:
    from procedures.imaging.markers import Localization
    from procedures.imaging.volume import Volume


class Localizer(StrEnum):
    """Localizer of the spheres in the CT."""

    OURS = "ours"
    THESIS_LINE = "thesis-line"
    THESIS_SPHERE = "thesis-sphere"


class ThesisFit(StrEnum):
    """Centre fit of the thesis."""

    LINE = "thesis-line"
    SPHERE = "thesis-sphere"


REPORTED_FLE_MM = {ThesisFit.LINE: 0.1685, ThesisFit.SPHERE: 0.1617}  # thesis, table 2


class Localize(Protocol):
    """Call of a localizer: arguments and errors as for `procedures.imaging.localize`."""

    def __call__(
        self,
        volume: Volume,
        *,
        diameter_mm: float = ...,
        expected: int | None = ...,
        progress: Callable[[float], None] = ...,
    ) -> Localization: ...


@dataclass(frozen=True, kw_only=True)
class LocalizerDescription:
    """Names of a localizer, whether a patient may depend on it, the error that it has, and how to load it."""

    method: str  # its name outside a case: in `ronna-ct localize` and in the studies
    is_clinical: bool = False
    published_mm: float | None = None  # 3-D rms, if it states no error of its own
    load: Callable[[], Localize]  # imports its numerics


LOCALIZERS: Mapping[Localizer, LocalizerDescription] = {
    # Two estimators of each centre, combined, with a covariance of their own.
    Localizer.OURS: LocalizerDescription(method="combined", is_clinical=True, load=lambda: imaging.localize),
    # The point nearest to the lines through the centres of circles in two stacks of planes.
    Localizer.THESIS_LINE: LocalizerDescription(
        method="thesis-line",
        published_mm=REPORTED_FLE_MM[ThesisFit.LINE],
        load=lambda: partial(imaging.localize_as_thesis, fit=ThesisFit.LINE),
    ),
    # The centre of a sphere through points of the same circles.
    Localizer.THESIS_SPHERE: LocalizerDescription(
        method="thesis-sphere",
        published_mm=REPORTED_FLE_MM[ThesisFit.SPHERE],
        load=lambda: partial(imaging.localize_as_thesis, fit=ThesisFit.SPHERE),
    ),
}

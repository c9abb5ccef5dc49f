"""The four kinds of user methods, with their call signatures and required results.

A function (for a strategy a class) is named as `module:function`, or by an entry point in the group of its
kind, as in `[project.entry-points."ronna_hw.pairings"]`. Arrays are read-only float64.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from ronna_hw.arrays import Array

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume
    from procedures.strategies.strategy import Strategy


class MethodKind(StrEnum):
    """Task of a user method. Each kind has its own entry point group and studies."""

    LOCALIZER = "localizer"
    PAIRING = "pairing"
    REGISTRATION = "registration"
    STRATEGY = "strategy"

    @property
    def group(self) -> str:
        plural = "strategies" if self is MethodKind.STRATEGY else f"{self}s"
        return f"ronna_hw.{plural}"


class Localizer(Protocol):
    """Locates spheres in a CT."""

    def __call__(self, volume: Volume) -> ArrayLike:
        """Return centres (n, 3) in patient coordinates (LPS, mm), in any order; n may be 0."""
        ...


class Pairing(Protocol):
    """Pairs the points of two unordered sets, both with outliers."""

    def __call__(
        self, image_mm: Array, physical_mm: Array, *, sigma_image_mm: float, sigma_physical_mm: float
    ) -> ArrayLike | None:
        """Return index pairs (k, 2) (image, physical), or None without a unique answer.

        `image_mm` is (n, 3), `physical_mm` (m, 3); a sigma is one standard deviation per axis.
        """
        ...


class PairedRegistration(Protocol):
    """Fits a rigid transform to paired points."""

    def __call__(
        self, image_mm: Array, physical_mm: Array, *, covariance_mm2: Array
    ) -> RigidTransform | ArrayLike:
        """Return the transform physical <- image, as a SciPy RigidTransform or a matrix (4, 4).

        Points are (n, 3), with the same marker in the same row; `covariance_mm2` (n, 3, 3) is the error of
        each pair in the physical frame.
        """
        ...


class StrategyFactory(Protocol):
    """Creates a localization strategy. Called without arguments; usually the strategy class itself."""

    def __call__(self) -> Strategy:
        """Return an object with the members of `procedures.strategies.strategy.Strategy`."""
        ...


CONTRACTS: dict[MethodKind, type] = {
    MethodKind.LOCALIZER: Localizer,
    MethodKind.PAIRING: Pairing,
    MethodKind.REGISTRATION: PairedRegistration,
    MethodKind.STRATEGY: StrategyFactory,
}

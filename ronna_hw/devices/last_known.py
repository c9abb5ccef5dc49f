"""What is known about a device without querying it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from ronna_hw.devices.lifecycle import Lifecycle
    from ronna_hw.devices.readiness import Fact
    from ronna_hw.errors import RonnaError

R_co = TypeVar("R_co", covariant=True)


@dataclass(frozen=True)
class LastKnown(Generic[R_co]):
    """State, latched fault and latest reading as last seen; the reading's stamp gives its age."""

    state: Lifecycle
    fault: RonnaError | None
    reading: R_co | None
    says: tuple[Fact, ...] = ()  # what the device reported unsolicited

"""The RSI signal flow: from the ETHERNET object's inputs, through the wiring, to a joint command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from ronna_hw.wire.kuka_context import INTERNAL, RsiContext
from sim.kuka.controller.messages import Message
from sim.kuka.rsi.axis_correction import AxisCorrector
from sim.kuka.rsi.position_correction import PositionCorrector

AXIS_INPUTS = ("A1", "A2", "A3", "A4", "A5", "A6")
FRAME_INPUTS = ("X", "Y", "Z", "A", "B", "C")
TRUE_LIMIT = 0.5  # a BOOL may arrive as a decimal number


class EthernetOutputs:
    """Outputs of the ETHERNET object: the last values, kept or reset to zero according to HOLDON."""

    def __init__(self, context: RsiContext, lacking: Literal["holdon", "kept", "zero"] = "holdon") -> None:
        """`lacking` determines what happens to an element missing from a reply."""
        self._hold = [bool(element.holdon) for element in context.receive]
        self._keep = self._hold if lacking == "holdon" else [lacking == "kept"] * len(self._hold)
        self.values: list[float] = [0.0] * len(self._hold)
        self._all_missing: tuple[None, ...] = (None,) * len(self._hold)

    def take(self, values: Sequence[float | None] | None) -> list[float]:
        """Apply a reply's values, or None for a cycle without a reply."""
        if values is not None and None not in values:
            self.values = list(values)  # type: ignore[arg-type]
            return self.values
        taken, holds = (self._all_missing, self._hold) if values is None else (values, self._keep)
        self.values = [
            new if new is not None else (old if hold else 0.0)
            for new, old, hold in zip(taken, self.values, holds, strict=True)
        ]
        return self.values


@dataclass(frozen=True)
class Inputs:
    """Positions in the list of received elements that feed an object; None if nothing does."""

    axes: tuple[int | None, ...] | None
    frame: tuple[int | None, ...] | None
    stop: int | None


def inputs_of(context: RsiContext) -> Inputs:
    """Resolve a context's wiring to positions."""
    position = {element.indx: n for n, element in enumerate(context.receive) if element.indx != INTERNAL}
    fed: dict[tuple[str, str], int] = {
        (wire.object, wire.input): position[wire.indx] for wire in context.wiring
    }

    def six(name: str, inputs: Sequence[str]) -> tuple[int | None, ...] | None:
        places = tuple(fed.get((name, item)) for item in inputs)
        return places if any(place is not None for place in places) else None

    return Inputs(six("AXISCORR", AXIS_INPUTS), six("POSCORR", FRAME_INPUTS), fed.get(("STOP", "In1")))


class SignalFlow:
    """One run's flow from outputs to the commanded joint angles (deg)."""

    def __init__(
        self,
        inputs: Inputs,
        base_deg: list[float],
        axis: Callable[[], AxisCorrector],
        position: Callable[[], PositionCorrector],
        *,
        relative: bool,
        share: float = 1.0,
    ) -> None:
        """`share` is the part of a correction that takes effect: less than all if the override scales it."""
        self._inputs = inputs
        self._relative = relative
        self._share = share
        self._axis = axis() if inputs.axes else None
        self._position = position() if inputs.frame else None
        self._last: list[float] | None = None
        self._stop_before = False
        self.command_deg: list[float] = base_deg  # the drives' own list: an arm at rest stays at rest
        self._base_deg = self.command_deg

    def stop_rises(self, values: list[float]) -> bool:
        """True in the cycle in which STOP's input becomes true."""
        place = self._inputs.stop
        if place is None:
            return False
        now = values[place] > TRUE_LIMIT
        rises = now and not self._stop_before
        self._stop_before = now
        return rises

    def correct(self, values: list[float]) -> Message | None:
        """One cycle in RSI_MOVECORR; `command_deg` stays the same object if nothing changes."""
        if values == self._last and not self._relative:
            return None
        self._last = values
        joints_deg, changed = self._base_deg, False
        if self._position is not None and self._inputs.frame is not None:
            given = self._pick(values, self._inputs.frame)
            if any(given) or not self._relative:
                changed = True
                message = self._position.take(given)
                if message is not None:
                    return message
            joints_deg = self._position.joints_deg
        if self._axis is not None and self._inputs.axes is not None:
            given = self._pick(values, self._inputs.axes)
            if any(given) or not self._relative:
                changed = True
                message = self._axis.take(given)
                if message is not None:
                    return message
            joints_deg = [a + b for a, b in zip(joints_deg, self._axis.totals_deg, strict=True)]
        if changed and joints_deg != self.command_deg:
            self.command_deg = joints_deg
        return None

    def narrow(self, within_deg: float | None) -> None:
        """As for `AxisCorrector`, if there is one; the present values are judged again."""
        if self._axis is not None and self._axis.narrow(within_deg):
            self._last = None

    @property
    def stats(self) -> tuple[int, int]:
        """Stat of AXISCORR and of POSCORR."""
        return (
            self._axis.stat if self._axis is not None else 0,
            self._position.stat if self._position is not None else 0,
        )

    def _pick(self, values: list[float], places: tuple[int | None, ...]) -> list[float]:
        given = [0.0 if place is None else values[place] for place in places]
        return given if self._share == 1.0 else [self._share * value for value in given]

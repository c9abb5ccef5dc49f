"""Application of a fault script to a controller, once per cycle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from sim.world.faults.board import FaultBoard
from sim.world.faults.fault import Fault, FaultKind
from sim.world.faults.log import FaultLog


class ScriptedFaults(ABC):
    """Applies the faults of a script as they become due, and logs them."""

    def __init__(self, board: FaultBoard, log: FaultLog, kinds: Sequence[FaultKind]) -> None:
        self._board, self._log = board, log
        self._momentary = tuple(kind.name for kind in kinds if kind.momentary)
        self._quiet = True

    def poll(self) -> None:
        """Apply the faults that have become due."""
        if self._board.empty and self._quiet:
            return
        acting = self._board.acting()
        self._log.update(acting)
        self._apply(acting)
        for kind in self._momentary:
            for fault in self._board.happened(kind):
                self._log.happened(fault)
                self._inject(fault)
        self._quiet = self._settle() and not acting

    @abstractmethod
    def _apply(self, acting: tuple[Fault, ...]) -> None:
        """Put the controller under exactly these lasting faults."""

    @abstractmethod
    def _inject(self, fault: Fault) -> None:
        """Let a momentary fault happen."""

    def _settle(self) -> bool:
        """Continue what a momentary fault has begun; return whether all of it is done."""
        return True

"""A camera's features through the vendor's library, in the form that `known_state` uses."""

from __future__ import annotations

from typing import Any

from drivers.basler_stereo.errors import MissingFeature, OutOfRange
from drivers.basler_stereo.features.feature_map import Limits
from drivers.basler_stereo.features.formula import Number


class PylonFeatures:
    """Wraps the node map of an open camera. Unknown names and values raise GEV-010."""

    def __init__(self, nodes: Any, genicam: Any) -> None:
        self._nodes = nodes
        self._genicam = genicam

    def has(self, name: str) -> bool:
        """Whether the camera has this feature and it is available now."""
        node = self._nodes.GetNode(name)
        return node is not None and bool(self._genicam.IsAvailable(node))

    def number(self, name: str) -> Number:
        """Value of a feature."""
        value: Number = self._node(name).GetValue()
        return value

    def whole(self, name: str) -> int:
        """Value of an integer feature."""
        return int(self._node(name).GetValue())

    def entries(self, name: str) -> tuple[str, ...]:
        """Names of an enumeration's currently available entries."""
        return tuple(self._node(name).Symbolics)

    def limits(self, name: str) -> Limits:
        """The values that a feature may have now."""
        node = self._node(name)
        step = node.GetInc() if node.GetIncMode() == self._genicam.fixedIncrement else None
        return Limits(node.GetMin(), node.GetMax(), step)

    def set_number(self, name: str, value: Number) -> None:
        """Set a number; raises GEV-011."""
        node = self._node(name)
        try:
            node.SetValue(value)
        except self._genicam.OutOfRangeException as error:
            raise OutOfRange(f"{name} {value}", got=str(error).splitlines()[0]) from error
        except self._genicam.GenericException as error:
            raise MissingFeature(f"{name} cannot be set now", got=str(error).splitlines()[0]) from error

    def choose(self, name: str, entry: str) -> None:
        """Set an enumeration to one of its entries."""
        try:
            self._node(name).SetValue(entry)
        except self._genicam.GenericException as error:
            raise MissingFeature(f"{name} cannot be {entry}", got=str(error).splitlines()[0]) from error

    def execute(self, name: str) -> None:
        """Execute a command."""
        self._node(name).Execute()

    def _node(self, name: str) -> Any:
        if not self.has(name):
            raise MissingFeature(f"the camera has no feature {name}")
        return self._nodes.GetNode(name)

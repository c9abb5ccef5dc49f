"""Names the units of user methods that do not respond: an endless loop looks like long work."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

SILENT_S = 10.0

Tell = Callable[[str], None]


class Silence:
    """Reports once each unit that has been running for `limit_s`."""

    def __init__(self, names: Sequence[str], tell: Tell, limit_s: float = SILENT_S) -> None:
        """`names` are those of the user methods; without any, nothing is reported."""
        self._names, self._tell, self.limit_s = " or ".join(names), tell, limit_s
        self._since: dict[str, float] = {}
        self._announced: set[str] = set()

    def under_way(self, keys: Iterable[str]) -> None:
        """Call at least every `limit_s` with the units that are running."""
        now_s = time.monotonic()
        since = {key: self._since.get(key, now_s) for key in keys}
        self._since = since
        for key in since.keys() - self._announced:
            if self._names and now_s - since[key] >= self.limit_s:
                self._announced.add(key)
                self._tell(
                    f"{self._names} has not answered for {self.limit_s:g} s, in {key}; Ctrl-C stops it"
                )

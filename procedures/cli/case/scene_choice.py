"""What a simulated theatre and its phantom are drawn from."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SceneChoice:
    """What the theatre and the phantom are drawn from; both get the same."""

    scene: str = "default"
    seed: int = 0
    markers: int | None = None
    targets: int | None = None

    def arguments(self) -> list[str]:
        """As options of `ronna-sim theatre` and `ronna-sim phantom`."""
        options = ["--scene", self.scene, "--seed", str(self.seed)]
        for name, value in (("--markers", self.markers), ("--targets", self.targets)):
            if value is not None:
                options += [name, str(value)]
        return options

    @property
    def own_seed(self) -> int:
        """Seed of what is drawn: a scene file holds its own. Whether the file is good, its reader says."""
        path = Path(self.scene)
        if not path.suffix:
            return self.seed
        try:
            text = path.read_text(encoding="utf-8")
            content = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
            return int(content.get("seed", 0))
        except (OSError, ValueError, AttributeError, TypeError):
            return self.seed

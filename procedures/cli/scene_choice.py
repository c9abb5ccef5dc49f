"""What a simulated theatre and its phantom are drawn from."""

from __future__ import annotations

from dataclasses import dataclass


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

"""Conditions of whole cases: the rounds of decision 31, in their order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from benchmarks.whole_cases.block import TARGETS
from procedures.strategies.catalogue import STRATEGIES
from ronna_hw.arm.catalogue import ArmChoice
from sim.world.options import Carrier
from sim.world.scene.model import SEATING_ERROR_MM

COMPARED_WITH = "ocs"  # the default strategy
FIRST = (COMPARED_WITH, "learning", "improved", "jdms", "best", "thesis-ocs", "nos")
SET_S_SEATING_MM = 0.22  # per axis: parameter set S has its spheres 0.38 mm off their places, 3-D rms
CALIBRATED = ("--calibrated",)
THESIS_LOCALIZERS = ("thesis-sphere", "thesis-line")


@dataclass(frozen=True)
class Condition:
    """Cases that differ in nothing but their seed. `group` and strategy name the row of the table.

    `options` are those of `ronna-procedure run` in addition to scene, strategy and arm.
    """

    group: str
    strategy: str = COMPARED_WITH
    options: tuple[str, ...] = ()
    arm: ArmChoice = ArmChoice.KR6
    seating_mm: float = SEATING_ERROR_MM
    carrier: Carrier = Carrier.FREE
    targets: int = TARGETS
    is_rigid: bool = False  # a phantom, whose skin has not moved
    bare_bone_mm: float = 0.0  # radius over which the forehead's bone is bare; 0: nowhere

    @property
    def name(self) -> str:
        return f"{self.group} {self.strategy}"


def list_conditions() -> tuple[Condition, ...]:
    """Return all conditions in the order in which they are run."""
    usual = tuple(_every_strategy("uncalibrated", ())) + tuple(_every_strategy("calibrated", CALIBRATED))
    coarse = tuple(replace(one, group=f"seating_{one.group}", seating_mm=SET_S_SEATING_MM) for one in usual)
    return (
        *usual,
        *_on_skin(),
        *_with_and_without("x_frame", ("--fiducials", "xframe")),
        *_thesis(),
        *_others(),
        *coarse,
    )


def _every_strategy(group: str, options: tuple[str, ...]) -> Iterator[Condition]:
    known = [one.name for one in STRATEGIES]
    for strategy in [
        *(name for name in FIRST if name in known),
        *(name for name in known if name not in FIRST),
    ]:
        yield Condition(group, strategy, options)


def _with_and_without(group: str, options: tuple[str, ...]) -> Iterator[Condition]:
    """Yield two conditions, of an uncalibrated arm and of a calibrated one."""
    yield Condition(f"{group}_uncalibrated", options=options)
    yield Condition(f"{group}_calibrated", options=(*options, *CALIBRATED))


def _thesis() -> Iterator[Condition]:
    for localizer in THESIS_LOCALIZERS:
        options = ("--localizer", localizer, "--matcher", "thesis")
        yield from _with_and_without(localizer.replace("-", "_"), options)


def _on_skin() -> Iterator[Condition]:
    """Yield a rigid phantom that is registered on its skin, one with bare bone besides, and heads of people.

    Their skin has moved since the CT; the last have a few screws as well.
    """
    phantom = Condition("skin_phantom", carrier=Carrier.SURFACE, targets=5, is_rigid=True)
    yield phantom
    yield replace(phantom, group="bone_phantom", bare_bone_mm=45.0)
    yield Condition("skin", carrier=Carrier.SURFACE, targets=5)
    yield Condition("mixed", carrier=Carrier.MIXED, targets=5)


def _others() -> Iterator[Condition]:
    for one in _with_and_without("ur5e", ()):
        yield replace(one, arm=ArmChoice.UR5E)
    yield Condition("two_arms", options=("--dual",))

"""A small case to drive an engine with: steps that leave a number, made from what they read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from procedures.engine.context import StepContext
from procedures.engine.order import CaseOrder, Outcome, Phase, Scope, Steps, StepSpec, order_of
from procedures.journal.results import StepResult


class Image(StepResult, kind="image"):
    number: int = 0


class Localization(StepResult, kind="localization"):
    number: int = 0


class Fit(StepResult, kind="fit"):
    number: int = 0
    not_for: tuple[str, ...] = ()

    def leaves_out(self) -> dict[str, str]:
        return dict.fromkeys(self.not_for, "the error is too large")


class ToolOn(StepResult, kind="tool_on"):
    number: int = 0


class Approach(StepResult, kind="approach"):
    number: int = 0


class Held(StepResult, kind="held"):
    number: int = 0


class Back(StepResult, kind="back"):
    number: int = 0


Work = Callable[[StepContext], Outcome[StepResult]]


def leaves(model: type[StepResult], *reads: type[StepResult]) -> Work:
    """Work that reads what it declares and leaves its model."""

    def run(context: StepContext) -> Outcome[StepResult]:
        for one in reads:
            context.result(one)
        return Outcome(model(), summary="done")

    return run


def ends_away(context: StepContext) -> Outcome[StepResult]:
    """Work that leads the arm away from home."""
    A1, *others = context.workcell.master.set_home()
    context.workcell.master.go((A1 + 0.1, *others))
    return Outcome(Held(), summary="done")


def only_home_remains() -> CaseOrder:
    """One step, after which every target is finished and the arm is still away."""
    return order_of([replace(step(Held, work=ends_away), finishes=True)], ())


def step(
    model: type[StepResult],
    *reads: type[StepResult],
    scope: Scope = Scope.CASE,
    continues: bool = False,
    work: Work | None = None,
) -> StepSpec[StepResult]:
    return StepSpec(
        model,
        model.kind.capitalize(),
        Phase.OPERATION,
        work or leaves(model, *reads),
        scope=scope,
        reads=reads,
        moves=continues,
        continues=continues,
    )


def plain_steps(**works: Work) -> Steps:
    """Seven steps in the shape of a clinical case; `works` replaces the work of a step by its name."""
    return (
        step(Image, work=works.get("image")),
        step(Localization, Image, scope=Scope.LOCALIZATION, work=works.get("localization")),
        step(Fit, Localization, scope=Scope.LOCALIZATION, work=works.get("fit")),
        step(ToolOn, work=works.get("tool_on")),
        step(Approach, Fit, ToolOn, scope=Scope.TRAJECTORY, work=works.get("approach")),
        step(Held, Approach, scope=Scope.TRAJECTORY, continues=True, work=works.get("held")),
        step(Back, Approach, Held, scope=Scope.TRAJECTORY, continues=True, work=works.get("back")),
    )


def plain_order(*trajectories: str, localizes_per_trajectory: bool = True, **works: Work) -> CaseOrder:
    return order_of(
        plain_steps(**works), trajectories or ("T1", "T2"), localizes_per_trajectory=localizes_per_trajectory
    )

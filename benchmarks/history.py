"""History of all benchmark figures, with the change of each since its previous result.

    make bench-history
    make bench-history ONLY="robot-link"

`make bench` appends a line to `benchmarks/results/history.jsonl`, to be committed. Where a figure has a
baseline, ratios to it are compared, so that machines do not matter; else only results of one machine are.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from benchmarks.measurements import require_measurements
from ronna_hw.command_line.terminal import run

HISTORY = Path(__file__).parent / "results" / "history.jsonl"
LOSS = 0.10  # a share that is marked
DIGITS = 4
MORE_IS_BETTER = {"1/s": True} | dict.fromkeys(
    ("s", "ms", "us", "µs", "mm", "µm", "px", "GB", "rad", "°"), False
)

app = typer.Typer(add_completion=False, rich_markup_mode=None)


class Key(NamedTuple):
    """Identity of a figure: measurement, quantity, contestant and baseline."""

    group: str
    what: str
    who: str
    baseline: str


@dataclass(frozen=True)
class Point:
    """A figure from one benchmark result. `more_is_better` is None if changes are neutral."""

    date: str
    commit: str
    machine: str
    value: float
    unit: str
    ratio: float | None
    more_is_better: bool | None

    def change_since(self, earlier: Point) -> float | None:
        """Return the relative change, preferring ratios; None across machines or from a value of zero."""
        if self.ratio is not None and earlier.ratio is not None:
            return self.ratio / earlier.ratio - 1.0 if earlier.ratio else None
        if self.machine != earlier.machine or not earlier.value:
            return None
        return self.value / earlier.value - 1.0

    def is_loss(self, change: float | None) -> bool:
        if change is None or self.more_is_better is None:
            return False
        return round(-change if self.more_is_better else change, DIGITS) >= LOSS


def append_result(content: Mapping[str, Any], path: Path) -> None:
    """Append the results of a benchmark run to the history file."""
    machine = content["machine"]
    record = {
        "date": content["date"],
        "commit": content["commit"],
        "machine": f"{machine['processor']}, {machine['cpus']} processors",
        "figures": {name: [_shorten(one) for one in ones] for name, ones in content["figures"].items()},
    }
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record, ensure_ascii=False) + "\n")


def _shorten(figure: Mapping[str, Any]) -> dict[str, Any]:
    """Return only the non-empty fields needed for comparison, with numbers rounded to four digits."""
    short = {name: figure[name] for name in ("what", "who", "value", "unit", "ratio", "baseline", "met")}
    better = figure["more_is_better"]
    short["more_is_better"] = MORE_IS_BETTER.get(figure["unit"]) if better is None else better
    return {
        name: float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
        for name, value in short.items()
        if value not in (None, "")
    }


def read_history(path: Path) -> dict[Key, list[Point]]:
    """Return the data points of each figure in date order, or an empty mapping before the first result."""
    points: dict[Key, list[Point]] = defaultdict(list)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    records = []
    for number, line in enumerate(lines, start=1):
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError as problem:
            raise typer.BadParameter(
                f"{path}, line {number} is not a result: {problem.msg}. Remove this line."
            ) from problem
    for record in sorted(records, key=lambda one: str(one["date"])):
        for group, figures in record["figures"].items():
            for one in figures:
                points[Key(group, one["what"], one["who"], one.get("baseline", ""))].append(
                    Point(
                        record["date"],
                        record["commit"],
                        record["machine"],
                        one["value"],
                        one.get("unit", ""),
                        one.get("ratio"),
                        one.get("more_is_better"),
                    )
                )
    return points


@app.command()
def show(
    only: Annotated[list[str] | None, typer.Option(help="Measurement, as in make bench.")] = None,
    file: Annotated[Path, typer.Option(help="File of the results.")] = HISTORY,
) -> None:
    """Print every figure's values by date, and mark losses of 10 % and more."""
    require_measurements(only or [])
    history = {key: points for key, points in read_history(file).items() if not only or key.group in only}
    if not history:
        sys.stdout.write(f"no results in {file} yet: make bench adds one\n")
        return
    baselines = {(key.group, key.what, key.baseline) for key in history}
    lost = []
    for key, points in history.items():
        judged = key[:3] not in baselines  # a baseline's changes are the machine's
        sys.stdout.write(f"\n{key.group}: {key.what}, {key.who}\n")
        for number, point in enumerate(points):
            change = point.change_since(points[number - 1]) if number else None
            is_loss = judged and point.is_loss(change)
            elsewhere = bool(number) and change is None and point.machine != points[number - 1].machine
            line = _format_point(point, key.baseline, change, elsewhere=elsewhere)
            sys.stdout.write(f"  {line}{'  LOSS' if is_loss else ''}\n")
            if is_loss and number == len(points) - 1:
                lost.append(f"{key.what}, {key.who}: {change:+.0%}")
    sys.stdout.write(f"\nlost {LOSS:.0%} or more since the result before: {len(lost) or 'none'}\n")
    sys.stdout.writelines(f"  {line}\n" for line in lost)


def _format_point(point: Point, baseline: str, change: float | None, *, elsewhere: bool) -> str:
    day, value = point.date[:10], f"{point.value:,.4g} {point.unit}"
    ratio = "" if point.ratio is None else f"{point.ratio:.3g} x {baseline}"
    changed = "" if change is None else f"{change:+.0%}"
    if elsewhere:
        changed = f"not compared: another machine ({point.machine})"
    return f"{day}  {point.commit:10} {value:>14}  {ratio:30} {changed}".rstrip()


if __name__ == "__main__":
    run(app)

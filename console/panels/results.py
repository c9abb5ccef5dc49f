"""Panels of the results: accuracy, images, notices, and the latest journal and log lines."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePath

from console.errors import UNRELIABLE_RUN
from console.hub import Hub
from console.panels.ct_planes import ct_planes
from console.panels.html import evidence_table, head_row, table, tag, text
from procedures.engine.case_view import FAULT, FINDING, REFUSED, CaseView, Notice
from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.operator.question import PredictedError
from procedures.reporting.case_figures import CaseFigures
from procedures.reporting.sections.surface import SURFACE_PICTURES, SurfaceSection, caption_of_skin
from ronna_hw.bounded_input import parse_json
from ronna_hw.host.files import open_regular
from ronna_hw.log_output import LOG_FILE

NOTE = "The residual of the fit (FRE) is not the accuracy; it only shows whether the fit is consistent."
MOST_PICTURES = 4
LIVE_OLD_S = 2.0  # host time after which a live image no longer shows the head's view
SIGNS = {FAULT: ("✗ fault", "bad"), REFUSED: ("⊘ refused", "warn"), FINDING: ("! note", "warn")}
JOURNAL_LINES = LOG_LINES = 60
TAIL_BYTES = 16_384  # about eighty lines
HEADS = ("timestamp", "level", "event")  # shown before a line's other fields
JOURNAL_SHOWN = (  # fields of a journal line, in this order
    *("step", "what", "topic", "subject", "trajectory", "task", "device", "state", "text", "answer", "by"),
    *("outcome", "reason"),
)


def accuracy(view: CaseView, figures: CaseFigures | None) -> str:
    """Show the tables of the valid registrations, and the one that the open question is about."""
    asked = () if view.question is None else view.question.predicted
    decided = {item.target for item in asked}
    valid = () if figures is None else figures.predictions
    predictions = [*asked, *(item for item in valid if item.target not in decided)]
    on_skin = "" if figures is None or figures.surface is None else skin(figures.surface)
    if not predictions:
        return tag("p", "No registration yet.", class_="dim") + on_skin
    rows = "".join(
        tag(
            "tr",
            tag("th", text(item.target), scope="row")
            + tag("td", f"{item.rms_mm:.2f}", class_="num big")
            + tag("td", text(_describe_limit(item)), class_="num")
            + tag("td", f"{item.margin_mm:g}", class_="num"),
        )
        for item in predictions
    )
    head = head_row("target", "mm rms", "limit mm", "margin mm")
    total = tag(
        "table",
        f"<caption>Predicted error at the targets</caption><thead>{head}</thead><tbody>{rows}</tbody>",
    )
    open_words = f"Not accepted yet: {', '.join(item.target for item in asked)}."
    is_open = tag("p", text(open_words), class_="warn") if asked else ""
    tables = "" if figures is None or asked else "".join(map(evidence_table, figures.tables))
    return is_open + total + on_skin + tables + tag("p", NOTE, class_="dim")


def skin(surface: SurfaceSection) -> str:
    """Show what is known of the skin: landmarks, scan, and how it differs from the CT."""
    start, scan, fit = surface.start, surface.scan, surface.registration
    parts = []
    if start is not None:
        rows = [(one.landmark, f"{one.off_mm:.1f}") for one in start.landmarks]
        parts.append(table(("landmark", "mm from its place by the fit"), rows, "Landmarks touched"))
    if scan is not None:
        words = (
            f"Scan: {len(scan.lines)} lines, {surface.points} points, {scan.covered:.0%} of the skin above "
            "the jaw within 10 mm of a point."
        )
        parts.append(tag("p", text(words)))
        parts += [
            tag("p", text(f"Look {number} shows no line: {reason}."), class_="warn")
            for number, reason in scan.dark.items()
        ]
    if fit is not None:
        if fit.carried:
            parts.append(tag("p", text(surface.carrying)))
        words = f"The skin differs from the CT by {fit.misfit_mm:.2f} mm over {fit.misfit_length_mm:.0f} mm."
        parts.append(tag("p", text(words)))
        parts += [
            tag(
                "p",
                text(f"Has probably moved: {', '.join(one.parts)}, by {one.shift_mm:+.2f} mm."),
                class_="warn",
            )
            for one in fit.changed
        ]
        if surface.told_sides:
            parts.append(tag("p", text(surface.told_sides)))
    return "".join(parts)


def _describe_limit(predicted: PredictedError) -> str:
    widened = ", widened" if predicted.caution else ""
    return f"{predicted.limit_mm:.2f} at {predicted.confidence:.0%}{widened}"


def accuracy_key(view: CaseView) -> object:
    """Return a key that changes with the registration that the open question is about."""
    return view.question.predicted if view.question is not None else ()


def live_pair(hub: Hub) -> str:
    if not hub.pair:
        return ""
    age_s = hub.pair_age_s
    is_old = age_s > LIVE_OLD_S
    words = f"taken {age_s:.0f} s ago" if is_old else "now"
    image = f'<img src="/picture/pair?n={hub.pairs}" alt="Both cameras of the stereo head, {words}">'
    when = tag("span", f", {words}", class_="age")
    caption = tag("figcaption", f"stereo head{when}", class_="warn" if is_old else "ok")
    return tag("figure", image + caption, class_="live old" if is_old else "live")


def live_key(hub: Hub) -> object:
    age_s = hub.pair_age_s
    return hub.pairs, int(age_s) if age_s > LIVE_OLD_S else 0


def pictures(figures: CaseFigures | None) -> str:
    """Show the measured image pairs with the detected outlines, newest first."""
    names = figures.pictures[-MOST_PICTURES:][::-1] if figures else ()
    if not names:
        return tag("p", "No stereo picture yet.", class_="dim")
    return tag("div", "".join(map(_render_picture, names)), class_="pictures")


def _render_picture(name: str) -> str:
    what = PurePath(name).stem.removeprefix("stereo-").replace("-", ", sphere ")
    alt_text = f"{what}: both cameras, detected outline overlaid"
    is_skin = name.startswith(SURFACE_PICTURES)
    if is_skin:
        what = alt_text = caption_of_skin(name)
    image = f'<img src="/picture/{text(name)}" alt="{text(alt_text)}" loading="lazy">'
    return tag("figure", image + tag("figcaption", text(what)), class_="skin" if is_skin else "")


def cuts(view: CaseView, figures: CaseFigures | None) -> str:
    """Show three planes through each target, expanding the figure for the current step."""
    if figures is None or not figures.cuts:
        return tag("p", "The plan has not been checked yet.", class_="dim")
    current_name = (view.running or view.upcoming).partition(":")[2]
    names = {PurePath(name).stem.removeprefix(PLAN_PICTURE): name for name in figures.cuts}
    shown = current_name if current_name in names else next(iter(names))
    return "".join(_render_cut(way, name, is_open=way == shown) for way, name in names.items())


def cuts_key(view: CaseView) -> object:
    """Return a key that changes with the target to expand."""
    return (view.running or view.upcoming).partition(":")[2]


def _render_cut(way: str, name: str, *, is_open: bool) -> str:
    planes = ct_planes(f"/picture/{text(name)}", f"Trajectory {text(way)} in the CT", is_lazy=True)
    return f"<details{' open' if is_open else ''}>{tag('summary', text(way))}{planes}</details>"


def course(figures: CaseFigures | None) -> str:
    if figures is None or not figures.course:
        return tag("p", "Shown for the latest state only.", class_="dim")
    return tag("div", figures.course, class_="paper")


def notices(view: CaseView) -> str:
    """List the notices, newest first."""
    if not view.notices:
        return tag("p", "No faults or refusals.", class_="dim")
    return tag("ul", "".join(_render_notice(item) for item in reversed(view.notices)), class_="notices")


def _render_notice(notice: Notice) -> str:
    words, kind = ("✓ settled", "dim") if notice.settled else SIGNS[notice.kind]
    head = tag("strong", f"{words} {text(notice.code)}".rstrip(), class_=kind)
    when = tag("span", f"{notice.theatre_time_s:.1f} s", class_="when")
    advice = (
        tag("div", f"Do: {text(notice.advice)}", class_="advice")
        if notice.advice and not notice.settled
        else ""
    )
    what = f"{notice.step} cannot start: {notice.what}" if notice.kind == REFUSED else notice.what
    return tag("li", f"{head} {when}<div>{text(what)}</div>{advice}")


def problems(figures: CaseFigures | None) -> str:
    """Warn of truncated, altered or incompatible parts of a run folder."""
    if figures is None or not figures.problems:
        return ""
    first, *more = figures.problems
    others = f" and {len(more)} more" if more else ""
    error = UNRELIABLE_RUN(f"parts of this run cannot be relied on: {first}{others}")
    return tag("div", text(error), class_="said", role="alert")


def log(lines: tuple[str, ...]) -> str:
    """List the latest log lines, newest first. Warnings and errors are marked by level."""
    shown = "".join(tag("li", text(line), class_=_level_class(line)) for line in reversed(lines[-LOG_LINES:]))
    return tag("ol", shown, class_="journal") if shown else tag("p", "No log entries yet.", class_="dim")


def _level_class(line: str) -> str:
    level = line.split(" ", 2)[1:2]
    return {"warning": "warn", "error": "bad", "critical": "bad"}.get(level[0] if level else "", "")


def journal(view: CaseView) -> str:
    """List the latest journal lines, newest first."""
    latest = reversed(view.journal[-JOURNAL_LINES:])
    lines = "".join(tag("li", text(_format_journal_line(line))) for line in latest)
    return tag("ol", lines, class_="journal") if lines else tag("p", "No journal entries yet.", class_="dim")


def _format_journal_line(line: Mapping[str, object]) -> str:
    """Format a journal line like `121 10:21:05 stage: T1, skin`."""
    about = ", ".join(str(line[name]) for name in JOURNAL_SHOWN if line.get(name))
    time = str(line.get("host_time") or "")[11:19]
    head = " ".join(part for part in (str(line.get("sequence", "")), time, str(line.get("entry"))) if part)
    return f"{head}: {about}" if about else head


class LogTail:
    """Tail of a run's log, shared by all pages and re-read when the log has grown."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOG_FILE
        self._size = -1
        self._lines: tuple[str, ...] = ()

    def lines(self) -> tuple[str, ...]:
        """Return the latest lines as text, oldest first, or an empty tuple if there is no log."""
        try:
            size = self._path.stat().st_size
            if size != self._size:
                self._size, self._lines = size, self._read(size)
        except OSError:
            self._size, self._lines = -1, ()
        return self._lines

    def _read(self, size: int) -> tuple[str, ...]:
        with open_regular(self._path) as file:
            file.seek(max(0, size - TAIL_BYTES))
            content = file.read(TAIL_BYTES)
        first, *rest = content.split(b"\n")
        whole = rest[:-1] if size > TAIL_BYTES else [first, *rest[:-1]]  # the first may be incomplete
        return tuple(text for line in whole if (text := _as_text(line)))


def _as_text(line: bytes) -> str:
    """Format a log line like `10:21:05 info step begins: part engine`, or return '' if it is invalid."""
    try:
        content = parse_json(line)
        time, level, event = (str(content.pop(name, "")) for name in HEADS)
        more = ", ".join(f"{name} {value}" for name, value in content.items() if name != "versions")
    except (ValueError, AttributeError, TypeError):
        return ""
    return f"{time[11:19]} {level} {event}{f': {more}' if more else ''}"

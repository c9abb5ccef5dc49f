"""Report figures as SVG, and proposed marker positions as PNG.

A canvas is as wide as a phone's screen, so that its text is readable there in portrait; elsewhere it scales
with the page.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Literal, NamedTuple

from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.marker_sites import ProposedMarkers
from procedures.planning.pose_name import SPHERE
from procedures.reporting.numbers import millimetres, seconds, tenths
from procedures.reporting.run_statistics import Span
from procedures.reporting.tables import MotionRow, TargetRow
from procedures.steps.clinical.results import LinkHealth
from procedures.strategies.skin_looks import SKIN
from procedures.strategies.trajectory import Trajectory

if TYPE_CHECKING:
    from procedures.reporting.calibration_figures import LookResidual

WIDTH = 420.0  # user units, equal to CSS pixels on a phone
TEXT_SIZE = 11.0
# Mean application error on a phantom, mm: published, and of the nearest of our campaigns. Those have
# uncalibrated arms and spheres 0.38 mm rms off their places in the CT, reseating included: parameter set S,
# fitted to table 4 of the thesis. Sources and commands in docs/reference/published-figures.md.
PUBLISHED_MM = (
    ("RONNA, OCS, 5 fiducials", 0.260, 0.275),
    ("RONNA, JDMS, 5 fiducials", 0.369, 0.305),
    ("RONNA, NOS, 5 fiducials", 1.327, 1.698),
    ("RONNA G3, targets < 50 mm deep", 0.43, 0.532),
    ("RONNA G3, targets 50-120 mm deep", 0.88, 0.753),
)
ROSA_ON_SKIN_MM = 1.22  # mean on patients, registered on the skin: Lefranc 2014, on the same page
# One palette for all drawings: each hue stands apart from white and from the page's dark ground by 3 : 1 or
# more; text and grid take the ink of the page around them.
BLUE, GREY, GREEN, AMBER, RED = "#2b7fa3", "#7d8a91", "#4d9070", "#c27a0c", "#d0453b"
GRID = 'stroke="currentColor" stroke-opacity="0.2"'
VALUE_ROOM = 70.0  # for the number after a bar
LEFT, TOP = 44.0, 20.0  # of the plots with axes
# Errors at the targets: colours, heights of a row and of its bar
OURS, PREDICTED, PUBLISHED, CAMPAIGN = BLUE, GREY, GREY, GREEN
TARGET_ROW, TARGET_BAR, HEADING_ROW = 31.0, 12.0, 24.0
# Clearance of the motions
HEAD, OTHER = BLUE, GREEN
LOOK = "look"  # at the skin, where a trajectory has a sphere
MOTION_ROW, MOTION_BAR = 40.0, 10.0
LONGEST_MM = 200.0  # a longer bar carries no information
# Timeline
STEP, MOTION, REST, BROKEN = GREY, BLUE, AMBER, RED
SPAN_ROW, SPAN_BAR, AXIS, MARGIN = 30.0, 11.0, 20.0, 12.0
LEAST_WIDTH = 1.5  # so that what took no theatre time is still visible
MOST_TICKS = 6
# Histograms of the robot link
TURNAROUND, JITTER = BLUE, AMBER
LEAST_SHOWN_US = 1.0  # the first bin begins at zero, which a logarithmic axis does not have
HISTOGRAM_HEIGHT = 150.0
# Residuals of a calibration's views
USED, LEFT_OUT = BLUE, RED
LOOKS_HEIGHT = 120.0
GAP = 0.2  # of a bar's width
# Proposed markers
DOTS_PER_INCH, SIZE_IN = 110, (10.0, 3.8)
VIEWS = (  # title, axis across, axis upwards, and which of the two are reversed
    ("from the right", 1, 2, (True, False)),
    ("from the front", 0, 2, (False, False)),
    ("from above", 0, 1, (True, True)),
)


class Drawing(NamedTuple):
    """SVG drawing about a trajectory."""

    trajectory: str
    svg: str


class LinkBin(NamedTuple):
    """Cycles of the robot link whose turnaround, or jitter, was between two times of the host."""

    from_us: float
    to_us: float
    turnaround_cycles: int
    jitter_cycles: int


class Canvas:
    """SVG canvas with y growing downwards."""

    def __init__(self, height: float, title: str) -> None:
        self._height = height
        self._title = title
        self._shapes: list[str] = []

    def rectangle(
        self, x: float, y: float, width: float, height: float, fill: str, *, title: str = ""
    ) -> None:
        """Add a filled rectangle, with `title` shown on hover."""
        inside = f"<title>{escape(title)}</title>" if title else ""
        self._shapes.append(
            f'<rect x="{x:.2f}" y="{y:.2f}" width="{max(width, 0.0):.2f}" height="{height:.2f}" '
            f'fill="{fill}">{inside}</rect>'
        )

    def line(self, x1: float, y1: float, x2: float, y2: float, stroke: str) -> None:
        """Add a line with `stroke`, its attributes of colour."""
        self._shapes.append(f'<line x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}" {stroke}/>')

    def text(
        self, x: float, y: float, words: str, *, anchor: Literal["start", "middle", "end"] = "start"
    ) -> None:
        """Add text with its baseline at y."""
        self._shapes.append(f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}">{escape(words)}</text>')

    @property
    def svg(self) -> str:
        """Finished drawing, to be stored as a file or embedded in a page."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {self._height:g}" role="img" '
            f'font-family="system-ui, sans-serif" font-size="{TEXT_SIZE:g}" fill="currentColor">'
            f"<title>{escape(self._title)}</title>{''.join(self._shapes)}</svg>"
        )


def target_figure(rows: Sequence[TargetRow], *, simulated: bool, on_skin: bool = False) -> str:
    """Draw the target errors in mm as bars, and apart from them published means beside our campaigns'.

    Beside a case `on_skin`, without fiducials, stands the published mean of such cases alone.
    """
    case: list[tuple[str, float, str]] = []
    for row in rows:
        if row.error_mm is not None:
            measured = "against the simulated truth" if simulated else "measured"
            case.append((f"{row.target}: {measured}", row.error_mm, OURS))
        case.append((f"{row.target}: predicted, rms", row.predicted.rms_mm, PREDICTED))
    published: list[tuple[str, float, str]] = []
    if on_skin:
        published.append(("ROSA, registered on the skin: published", ROSA_ON_SKIN_MM, PUBLISHED))
    else:
        for name, published_mm, campaign_mm in PUBLISHED_MM:
            published.append((f"{name}: published", published_mm, PUBLISHED))
            published.append((f"{name}: simulated with its CT error", campaign_mm, CAMPAIGN))
    studies = "Clinical study, mean" if on_skin else "Phantom studies, means"
    groups = {"This case, with its own CT, seating and arm": case, studies: published}
    bars = [bar for group in groups.values() for bar in group]
    canvas = Canvas(
        HEADING_ROW * len(groups) + TARGET_ROW * len(bars) + 4, "Error of the needle tip at the targets, mm"
    )
    scale = (WIDTH - VALUE_ROOM) / max(value for _, value, _ in bars)
    top = 0.0
    for heading, group in groups.items():
        canvas.text(0, top + 15, heading)
        canvas.line(0, top + 20, WIDTH, top + 20, GRID)
        top += HEADING_ROW
        for label, value, colour in group:
            canvas.text(0, top + 12, label)
            canvas.rectangle(0, top + 16, value * scale, TARGET_BAR, colour)
            canvas.text(value * scale + 4, top + 26, f"{millimetres(value)} mm")
            top += TARGET_ROW
    return canvas.svg


def clearance_figure(trajectory: str, motions: Sequence[MotionRow]) -> str:
    """Draw two bars for each motion, in mm: to the head, and between the closest bodies if it is not one."""
    canvas = Canvas(MOTION_ROW * len(motions) + 4, f"Clearance of the motions of {trajectory}, mm")
    scale = (WIDTH - VALUE_ROOM) / LONGEST_MM
    for number, one in enumerate(motions):
        top = MOTION_ROW * number
        pair = "" if one.closest is None else f"  ({one.closest.first} – {one.closest.second})"
        canvas.text(0, top + 11, _motion_name(one) + pair)
        bars = [
            (one.head_mm, HEAD),
            (None if one.closest is None or one.is_nearest_to_head else one.closest.distance_mm, OTHER),
        ]
        for place, (value_mm, colour) in enumerate(bars):
            if value_mm is not None:
                length = scale * min(value_mm, LONGEST_MM)
                canvas.rectangle(0, top + 15 + place * (MOTION_BAR + 1), length, MOTION_BAR, colour)
                canvas.text(length + 4, top + 24 + place * (MOTION_BAR + 1), f"{tenths(value_mm)} mm")
    return canvas.svg


def _motion_name(one: MotionRow) -> str:
    """Describe a motion in words, counting spheres and looks from 1."""
    start, end = (at.words(LOOK if at.trajectory == SKIN else SPHERE) for at in (one.start, one.end))
    return f"{end}, along the axis" if one.start == one.end else f"{start} → {end}"


def timeline_figure(
    spans: Sequence[Span], *, until_s: float | None = None, steps: Sequence[str] | None = None
) -> str:
    """Draw the timeline: steps grey, motions blue, pauses amber, abnormal ends red.

    A step has one row for all trajectories. With the same `until_s` and `steps` two runs can be compared.
    """
    rows = list(dict.fromkeys(map(step_of, spans))) if steps is None else list(steps)
    begin_s = min(span.begin_s for span in spans)
    end_s = max(span.end_s for span in spans) if until_s is None else until_s
    length_s = max(end_s - begin_s, 1e-3)
    scale = (WIDTH - 2 * MARGIN) / length_s
    height = SPAN_ROW * len(rows) + AXIS
    canvas = Canvas(height, "Steps and motions in theatre time, s")
    for tick_s in _ticks(length_s):
        x = MARGIN + tick_s * scale
        canvas.line(x, 0, x, height - AXIS + 4, GRID)
        canvas.text(x, height - 5, f"{tick_s:g} s", anchor="middle")
    for number, row in enumerate(rows):
        top = SPAN_ROW * number
        row_spans = [span for span in spans if step_of(span) == row]
        steps_s = [span.end_s - span.begin_s for span in row_spans if span.kind == "step"]
        times = f", {len(steps_s)} times" if len(steps_s) > 1 else ""
        lasted = f"{times}, {seconds(sum(steps_s))} s" if row_spans else ""
        canvas.text(MARGIN, top + 12, f"{row}{lasted}")
        for kind, inset in (("step", 0.0), ("motion", 2.0), ("rest", 2.0)):
            for span in row_spans:
                if span.kind == kind:
                    x, y = MARGIN + (span.begin_s - begin_s) * scale, top + 16 + inset
                    width = max((span.end_s - span.begin_s) * scale, LEAST_WIDTH)
                    period = f"{seconds(span.begin_s)} to {seconds(span.end_s)} s"
                    title = f"{span.name}: {period}, {span.ended}"
                    canvas.rectangle(x, y, width, SPAN_BAR - 2 * inset, _colour(span), title=title)
    return canvas.svg


def step_of(span: Span) -> str:
    """Return the step of a span without its trajectory: the row in which it is drawn."""
    return span.row.partition(":")[0]


def _colour(span: Span) -> str:
    if span.kind == "rest":
        return REST
    if span.ended != "done":
        return BROKEN
    return STEP if span.kind == "step" else MOTION


def _ticks(length_s: float) -> list[float]:
    """Return round times from zero, at most `MOST_TICKS`."""
    magnitude = 10.0 ** math.floor(math.log10(length_s / MOST_TICKS))
    step = next(f * magnitude for f in (1, 2, 5, 10, 20) if length_s / (f * magnitude) <= MOST_TICKS - 1)
    return [number * step for number in range(int(length_s / step) + 1)]


def sum_histograms(links: Sequence[LinkHealth]) -> tuple[LinkBin, ...]:
    """Sum the histograms of all streams, without empty ends."""
    edges = links[0].histogram_edges_us if links else ()
    alike = [link for link in links if link.histogram_edges_us == edges]
    bins = []
    for number, (low, high) in enumerate(itertools.pairwise(edges)):
        turnaround = sum(link.histogram_counts[number] for link in alike)
        jitter = sum(link.jitter_counts[number] for link in alike if link.jitter_counts)
        bins.append(LinkBin(low, high, turnaround, jitter))
    filled = [number for number, one in enumerate(bins) if one.turnaround_cycles or one.jitter_cycles]
    return tuple(bins[filled[0] : filled[-1] + 1]) if filled else ()


def link_figure(bins: Sequence[LinkBin]) -> str:
    """Draw a histogram of cycles by host time in microseconds: turnaround filled, jitter as a line."""
    canvas = Canvas(TOP + HISTOGRAM_HEIGHT + 22, "Cycles of the robot link over turnaround and jitter")
    low, high = math.log10(max(bins[0].from_us, LEAST_SHOWN_US)), math.log10(bins[-1].to_us)
    highest = max(max(one.turnaround_cycles, one.jitter_cycles) for one in bins)
    across = (WIDTH - LEFT - 10) / max(high - low, 1e-6)
    up = HISTOGRAM_HEIGHT / math.log10(highest + 1)

    def x(value_us: float) -> float:
        return LEFT + (math.log10(max(value_us, LEAST_SHOWN_US)) - low) * across

    def y(count: int) -> float:
        return TOP + HISTOGRAM_HEIGHT - math.log10(count + 1) * up

    canvas.text(LEFT, 11, "filled: turnaround; line: jitter of the telegrams; cycles")
    for power in range(math.ceil(low), math.floor(high) + 1):
        canvas.line(x(10.0**power), TOP, x(10.0**power), TOP + HISTOGRAM_HEIGHT, GRID)
        canvas.text(x(10.0**power), TOP + HISTOGRAM_HEIGHT + 15, f"{10**power:g} µs", anchor="middle")
    for power in range(len(str(highest))):
        canvas.line(LEFT, y(10**power), WIDTH - 10, y(10**power), GRID)
        canvas.text(LEFT - 4, y(10**power) + 4, f"{10**power:g}", anchor="end")
    for begin, end, turnaround, _ in bins:
        canvas.rectangle(
            x(begin), y(turnaround), x(end) - x(begin), TOP + HISTOGRAM_HEIGHT - y(turnaround), TURNAROUND
        )
    before, stroke = TOP + HISTOGRAM_HEIGHT, f'stroke="{JITTER}"'
    for begin, end, _, jitter in bins:
        canvas.line(x(begin), before, x(begin), y(jitter), stroke)
        canvas.line(x(begin), y(jitter), x(end), y(jitter), stroke)
        before = y(jitter)
    return canvas.svg


def looks_figure(looks_px: Sequence[LookResidual]) -> str:
    """Draw the rms residual of each view in px. Excluded views are red and clipped at the figure's top."""
    canvas = Canvas(TOP + LOOKS_HEIGHT + 18, "Rms residual of each measurement, px")
    highest_px = max((value for value, used in looks_px if used), default=1.0)
    across, up = (WIDTH - LEFT) / len(looks_px), LOOKS_HEIGHT / max(highest_px, 1e-6)
    for value_px in (0.0, highest_px / 2, highest_px):
        y = TOP + LOOKS_HEIGHT - value_px * up
        canvas.line(LEFT, y, WIDTH, y, GRID)
        canvas.text(LEFT - 4, y + 4, f"{value_px:.2f}", anchor="end")
    canvas.text(LEFT, 11, "rms of each measurement, px; red: left out")
    for number, (value_px, used) in enumerate(looks_px):
        height = min(value_px, highest_px) * up
        x, y, colour = LEFT + number * across, TOP + LOOKS_HEIGHT - height, USED if used else LEFT_OUT
        title = f"measurement {number + 1}: {value_px:.2f} px"
        canvas.rectangle(x, y, across * (1 - GAP), height, colour, title=title)
    canvas.text(LEFT, TOP + LOOKS_HEIGHT + 14, "1", anchor="start")
    canvas.text(WIDTH, TOP + LOOKS_HEIGHT + 14, str(len(looks_px)), anchor="end")
    return canvas.svg


def marker_picture(
    proposed: ProposedMarkers, head: HeadEllipsoid, trajectories: Sequence[Trajectory]
) -> bytes:
    """Draw a PNG of the head's ellipsoid, numbered markers and trajectories in LPS mm."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

    figure = Figure(figsize=SIZE_IN, layout="constrained")
    for axes, (title, across, up, (leftwards, downwards)) in zip(
        figure.subplots(1, len(VIEWS)), VIEWS, strict=True
    ):
        middle = head.centre_mm[across], head.centre_mm[up]
        size = 2.0 * head.semi_axes_mm[across], 2.0 * head.semi_axes_mm[up]
        axes.add_patch(Ellipse(middle, *size, fill=False, color=GREY))
        for one in trajectories:
            ends = one.entry_mm, one.target_mm
            axes.plot([end[across] for end in ends], [end[up] for end in ends], "-", color=BLUE)
            axes.annotate(one.identifier, (one.target_mm[across], one.target_mm[up]), color=BLUE)
        for number, centre in enumerate(proposed.centres_mm, start=1):
            axes.plot(centre[across], centre[up], "o", color=RED)
            axes.annotate(str(number), (centre[across], centre[up]), color=RED)
        axes.set_title(title)
        axes.set_aspect("equal")
        if leftwards:
            axes.invert_xaxis()
        if downwards:
            axes.invert_yaxis()
        axes.set_xlabel("xyz"[across] + " mm")
        axes.set_ylabel("xyz"[up] + " mm")
    FigureCanvasAgg(figure)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DOTS_PER_INCH)
    return content.getvalue()

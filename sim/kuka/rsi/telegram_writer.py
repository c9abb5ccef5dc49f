"""Writes the controller's telegram, `<Rob Type="KUKA">...`, byte for byte as a KR C4 does.

Elements in the order of the configuration, no white space between them, IPOC last. The layout is compiled
once per run; while the arm is at rest its numbers are not even reformatted.
"""

from __future__ import annotations

from collections.abc import Sequence

from ronna_hw.wire.kuka_context import FREE_TAG, INTERNAL, Feedback, SendElement
from sim.kuka.errors import EthernetFileInvalid

FRAME = ("X", "Y", "Z", "A", "B", "C")
AXIS = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
KEYWORD_PREFIX = "DEF_"
TECH_GENERATORS = 6
TECH_PARAMETERS = 10

# Keyword -> attributes, and their source: actual or set values, or zeros for what is not fitted.
ACTUAL_FRAME, ACTUAL_AXES, SET_FRAME, SET_AXES, NOTHING = "RIst", "AIPos", "RSol", "ASPos", ""
KEYWORDS = {
    "RIst": (FRAME, ACTUAL_FRAME),
    "RSol": (FRAME, SET_FRAME),
    "AIPos": (AXIS, ACTUAL_AXES),
    "ASPos": (AXIS, SET_AXES),
    "EIPos": (EXTERNAL, NOTHING),
    "ESPos": (EXTERNAL, NOTHING),
    "MACur": (AXIS, NOTHING),
    "MECur": (EXTERNAL, NOTHING),
}
DELAY = "Delay"
LATE_PLACE = 0  # among the integers: late packets, Stat of AXISCORR, Stat of POSCORR
STAT_PLACES = {"AXISCORR": 1, "POSCORR": 2}
ONLY_DELAY = [LATE_PLACE]
ZERO_OF = {"BOOL": "0", "LONG": "0", "STRING": ""}


class TelegramWriter:
    """The telegram of one run: `set_axes_deg` and `set_frame` are the programmed pose, constant."""

    def __init__(
        self,
        elements: Sequence[SendElement],
        precision: int,
        set_axes_deg: Sequence[float],
        set_frame: Sequence[float],
        feedback: Sequence[Feedback] = (),
    ) -> None:
        self._number = f"%.{precision}f"
        self._order: list[str] = []
        self._counts: list[int] = []  # meaning of each integer in the telegram
        self._stats = {wire.indx: STAT_PLACES[wire.object] for wire in feedback}
        constants = {SET_AXES: set_axes_deg, SET_FRAME: set_frame, NOTHING: (0.0,) * 6}
        groups: list[tuple[str, str]] = []  # name, attributes or text as a template
        for element in elements:
            self._add(groups, element, constants)
        body = "".join(
            f"<{name}{content}/>" if content.startswith(" ") else f"<{name}>{content}</{name}>"
            for name, content in groups
        )
        # Filled in two stages: positions when the arm has moved, D and IPOC in every cycle.
        self._template = f'<Rob Type="KUKA">{body}<IPOC>%%d</IPOC></Rob>'
        self._last: tuple[Sequence[float] | None, Sequence[float] | None] = (None, None)
        self._filled = ""

    def write(
        self,
        frame: Sequence[float],
        axes_deg: Sequence[float],
        late: int,
        ipoc: int,
        stats: tuple[int, int] = (0, 0),
    ) -> bytes:
        """One telegram: actual frame (mm, deg), actual axes (deg), late packets so far, time stamp.

        `stats` are Stat of AXISCORR and of POSCORR.
        """
        if self._last[0] is not axes_deg or self._last[1] is not frame:
            values: list[float] = []
            for name in self._order:
                values += frame if name == ACTUAL_FRAME else axes_deg
            self._filled = self._template % tuple(values)
            self._last = (axes_deg, frame)
        if self._counts == ONLY_DELAY:
            return (self._filled % (late, ipoc)).encode("ascii")
        counts = (late, *stats)
        return (self._filled % (*(counts[place] for place in self._counts), ipoc)).encode("ascii")

    def _add(
        self,
        groups: list[tuple[str, str]],
        element: SendElement,
        constants: dict[str, Sequence[float]],
    ) -> None:
        tag = element.tag
        if tag == FREE_TAG:
            return
        if element.indx != INTERNAL:
            name, _, attribute = tag.partition(".")
            zero = ZERO_OF.get(element.type, self._number % 0.0)
            if element.indx in self._stats:
                self._counts.append(self._stats[element.indx])
                zero = "%%d" if element.type in ZERO_OF else f"%{self._number}"
            if not attribute:
                groups.append((name, zero))
                return
            self._attribute(groups, name, f' {attribute}="{zero}"')
            return
        name, _, part = tag.removeprefix(KEYWORD_PREFIX).partition(".")
        if name == DELAY:
            self._counts.append(LATE_PLACE)
            groups.append((name, ' D="%%d"'))
        elif name == "Tech" and part[:1] == "C" and part[1:] in map(str, range(1, TECH_GENERATORS + 1)):
            text = "".join(
                f' {part}{parameter}="{self._number % 0.0}"' for parameter in range(1, TECH_PARAMETERS + 1)
            )
            self._attribute(groups, name, text)
        elif name in KEYWORDS and not part:
            attributes, source = KEYWORDS[name]
            if source in constants:
                values = [self._number % value for value in constants[source]]
            else:
                self._order.append(source)
                values = [self._number] * 6
            groups.append(
                (name, "".join(f' {a}="{value}"' for a, value in zip(attributes, values, strict=True)))
            )
        else:
            raise EthernetFileInvalid(f"SEND: {tag} is not an RSI keyword")

    @staticmethod
    def _attribute(groups: list[tuple[str, str]], name: str, text: str) -> None:
        if groups and groups[-1][0] == name and groups[-1][1].startswith(" "):
            groups[-1] = (name, groups[-1][1] + text)
        else:
            groups.append((name, text))

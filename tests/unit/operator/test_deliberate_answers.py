"""No slip of the hand moves the arm: the answers that do are marked deliberate."""

import re
from pathlib import Path

import procedures
from procedures.operator.question import DELIBERATE, Topic

CONFIRMED_MOTION = re.compile(r"(?:supervised|self)\.confirm\(\s*Topic\.(\w+)")


def test_every_answer_that_confirms_a_motion_or_lets_the_arm_continue_is_deliberate() -> None:
    sources = Path(procedures.__file__).parent.rglob("*.py")
    named = {name for source in sources for name in CONFIRMED_MOTION.findall(source.read_text())}
    assert {"FIRST_MOTION", "TOOL_CHECK", "APPROACH", "RETREAT", "PARK"} <= named
    lets_go_on = {Topic.INSTRUMENT_OUT, Topic.PAUSE, Topic.HEAD_UNSEEN}
    assert ({Topic[name] for name in named} | lets_go_on) - DELIBERATE == set()

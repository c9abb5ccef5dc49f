"""Rows are read back as written, whatever their fields are: numbers, rows, a row or none, a few rows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ronna_hw.host.row_codec import IPV4_HOST, RowCodec, one_of, text

MOST = 3


class Phase(IntEnum):
    IDLE = 0
    RUNNING = 1


class Step(NamedTuple):
    start: float
    is_last: bool


@dataclass(frozen=True)
class Target:
    position_mm: tuple[float, float, float]
    step: Step


class Sample(NamedTuple):
    number: Annotated[int, "Q"]
    phase: Annotated[Phase, "B"]
    position_mm: Annotated[tuple[float, ...], "3d"]
    side: Annotated[str, one_of(("left", "right"))]
    host: Annotated[str, IPV4_HOST]
    name: Annotated[str, text(16)]
    target: Target | None
    axes: tuple[float, float] | None
    steps: Annotated[tuple[Step, ...], MOST]
    kind: Annotated[type, one_of((Step, Target))]


numbers = st.floats(allow_nan=False)
steps = st.builds(Step, numbers, st.booleans())
samples = st.builds(
    Sample,
    number=st.integers(0, 2**64 - 1),
    phase=st.sampled_from(Phase),
    position_mm=st.tuples(numbers, numbers, numbers),
    side=st.sampled_from(["left", "right"]),
    host=st.sampled_from(["", "192.168.10.30"]),
    name=st.text(alphabet="abcäß:_", max_size=8),
    target=st.none() | st.builds(Target, st.tuples(numbers, numbers, numbers), steps),
    axes=st.none() | st.tuples(numbers, numbers),
    steps=st.lists(steps, max_size=MOST).map(tuple),
    kind=st.sampled_from([Step, Target]),
)


@given(samples)
def test_a_row_is_read_back_as_written(sample: Sample) -> None:
    codec = RowCodec(Sample)
    read = codec.unpack(codec.pack(sample))
    assert read == sample
    assert isinstance(read.phase, Phase)


def test_every_row_of_a_class_has_the_same_size() -> None:
    class Rows(NamedTuple):
        target: Target | None
        steps: Annotated[tuple[Step, ...], MOST]

    codec = RowCodec(Rows)
    step = Step(0.5, True)
    full = codec.pack(Rows(Target((1.0, 2.0, 3.0), step), (step,) * MOST))
    assert len(full) == len(codec.pack(Rows(None, ()))) == codec.size_bytes


def test_a_field_without_a_struct_code_is_named() -> None:
    class Forgotten(NamedTuple):
        number: int

    with pytest.raises(TypeError, match=r"Forgotten\.number"):
        RowCodec(Forgotten)

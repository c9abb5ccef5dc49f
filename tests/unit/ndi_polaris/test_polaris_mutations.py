"""Twenty thousand corrupted replies; `make soak` runs a million."""

from __future__ import annotations

import pytest
from polaris_mutations import MUTATIONS, Campaign, crc_by_definition, whole_binary, whole_text


@pytest.mark.hazard(16)
@pytest.mark.parametrize(("reply", "replies"), [("BX", 12_000), ("TX", 8_000)])
def test_no_corrupted_reply_is_accepted_and_two_commands_recover_the_link(reply: str, replies: int) -> None:
    campaign = Campaign(seed=1, reply=reply)
    campaign.run(replies)
    assert campaign.mutated >= replies
    assert campaign.accepted > replies / 4  # the line was whole between the bursts
    assert {"NDI-005", "NDI-006", "NDI-007", "NDI-008"} <= set(campaign.errors)


def test_the_campaign_distinguishes_intact_replies_from_corrupted_ones() -> None:
    assert crc_by_definition(b"OKAY") == 0xA896
    assert whole_text(b"remains\rOKAYA896\rOKAYA897\r") == [b"OKAY"]
    reply = bytes.fromhex("C4A50D002983010102310000002D01000000009E7D")
    assert whole_binary(b"\xc4" + reply + reply[:-1]) == [reply[6:-2]]
    assert whole_binary(reply[:8] + b"\0" + reply[9:]) == []


def test_the_campaign_includes_every_kind_of_corruption() -> None:
    names = {mutation.__name__ for mutation in MUTATIONS}
    assert {"flipped", "cut", "doubled", "delayed", "joined"} <= names

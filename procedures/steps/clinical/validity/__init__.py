"""Whether results still hold: CT and plan unchanged, head, cart and tracker where they were."""

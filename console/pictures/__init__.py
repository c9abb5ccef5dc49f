"""Images made from the CT: the surface of the head."""

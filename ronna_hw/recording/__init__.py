"""Flight recorder: raw bytes and readings of the last moments."""

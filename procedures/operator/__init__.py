"""The operator, who decides; the room's staff, who act; and the points at which a case waits for them."""

"""The operator, who decides; the room's hands, which act; and the points where a case waits for them."""

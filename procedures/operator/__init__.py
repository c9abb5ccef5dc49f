"""The operator, who decides; the room's hands, which act; and where a case rests for either."""

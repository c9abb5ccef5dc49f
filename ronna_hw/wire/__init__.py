"""Protocol vocabulary shared by both sides of a wire: constants, CRCs, layouts. No I/O, no decoding."""

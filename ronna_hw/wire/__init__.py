"""Protocol constants, CRCs and layouts shared by both ends of a link. No I/O, no decoding."""

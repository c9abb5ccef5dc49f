"""A KR C4 with an arm that has its own true geometry: RSI over UDP, EKI over TCP."""

"""Simulated KR C4 and an arm with its own true geometry: RSI over UDP, EKI over TCP."""

"""Simulated KR C4 and arm with its own true geometry: RSI over UDP, EKI over TCP."""

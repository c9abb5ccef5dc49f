"""KUKA KR C4: RSI over UDP in a process of its own, EKI over TCP for everything that is not motion."""

"""Protocol cases for KUKA's RSI and EKI: the controller (K) and its driver (L)."""

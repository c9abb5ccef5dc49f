"""The computer the code runs on: processes, ports, network cards, real-time scheduling, the control port."""

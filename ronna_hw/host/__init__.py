"""The computer the code runs on: processes, ports, network interfaces, scheduling, the control port."""

"""The computer the code runs on: processes, memory, files, networks, ports, and the control port."""

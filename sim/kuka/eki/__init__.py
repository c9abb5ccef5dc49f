"""EKI channels over TCP: the project's own and the C++ SDK's."""

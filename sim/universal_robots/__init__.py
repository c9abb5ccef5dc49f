"""Simulated Universal Robots controller with its arm: RTDE, dashboard and the client interfaces."""

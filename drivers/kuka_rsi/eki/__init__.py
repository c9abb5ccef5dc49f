"""EKI channel for program control, status, tool and base; never for real-time control."""

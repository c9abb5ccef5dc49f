"""EKI channel for program control, status, tool and base; not used for real-time control."""

"""Live view of a running case: its poses, states and pictures, for logs and for links to other programs."""

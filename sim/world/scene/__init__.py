"""The scene: its model, the named scenes, and how one is drawn from a seed."""

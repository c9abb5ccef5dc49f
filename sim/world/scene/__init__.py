"""The scene: its model, the named scenes, and drawing a scene from a seed."""

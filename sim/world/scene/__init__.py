"""Scene model, named scenes, and drawing of scenes from a seed."""

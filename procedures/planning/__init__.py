"""The plan file, its checks against CT and arm, and the paths of the whole procedure."""

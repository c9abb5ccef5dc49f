"""Registration on the skin: heads, scans and misfits drawn at random, judged by truth."""

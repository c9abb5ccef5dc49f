"""Registration on a surface that was scanned, without markers."""

"""The same pair through the vendor's library pypylon, which is an optional extra."""

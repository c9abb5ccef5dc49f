"""The check after the operation: both CTs laid over each other on bone, what was inserted, its errors."""

"""GenICam: the features of a camera, as its own description maps them to registers."""

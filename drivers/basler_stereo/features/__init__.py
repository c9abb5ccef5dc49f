"""GenICam features of a camera, mapped to registers by the camera's own description."""

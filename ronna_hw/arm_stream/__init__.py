"""Motion of an arm whose controller takes a set-point in every cycle: what does not depend on the vendor.

A driver adds its protocol: a `StreamSession` that decides each reply, a `StreamLoop` that receives and sends,
and the table of its errors.
"""

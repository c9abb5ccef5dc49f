"""Work of two arms: their bases, and insertion by the assistant through the master's guide.

`base_to_base` is the step; `base_postures`, `base_visits`, `frame_looks` and `ball_looks` are its looks.
`assisted_insertion` is the assistant's part of `at_target`, along an axis from `insertion_axis`.
"""

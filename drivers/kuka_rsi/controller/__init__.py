"""Generated KR C4 files: KRL programs, RSI context, Ethernet and EKI files, all from one description.

`python -P -m drivers.kuka_rsi.controller.generate FOLDER` writes them. `files/` contains its output for the
description of this version; a test regenerates and compares it. UNTESTED ON HARDWARE.
"""

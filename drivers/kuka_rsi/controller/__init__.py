"""The files loaded on the KR C4: KRL programs, RSI context, Ethernet and EKI files, from one description.

`python -P -m drivers.kuka_rsi.controller.generate FOLDER` writes them. The files in `files/` are what it
wrote for the description of this version; a test writes them again and compares. UNTESTED ON HARDWARE.
"""

"""Calibrations: one module per format, one for units and axes, one that finds the right reader.

Our own file is the anipose-style TOML with `[metadata] units = "m"`.
"""

from mocap.io.calibration.anipose import write_calibration
from mocap.io.calibration.reading import calibration_candidates, find_calibration, read_calibration
from mocap.io.calibration.record import CalibrationFile
from mocap.io.calibration.writing import FORMATS, write_rig

__all__ = [
    "FORMATS",
    "CalibrationFile",
    "calibration_candidates",
    "find_calibration",
    "read_calibration",
    "write_calibration",
    "write_rig",
]

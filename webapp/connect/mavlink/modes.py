"""Names of the flight modes of ArduPilot and PX4, as their ground stations show them."""

from __future__ import annotations

_ARDUPILOT, _PX4 = 3, 12
_ARMED, _CUSTOM = 0x80, 0x01

_PLANE = {
    0: "Manual", 1: "Circle", 2: "Stabilize", 3: "Training", 4: "Acro", 5: "FBWA", 6: "FBWB", 7: "Cruise",
    8: "Autotune", 10: "Auto", 11: "RTL", 12: "Loiter", 13: "Takeoff", 14: "Avoid ADSB", 15: "Guided",
    16: "Initialising", 17: "QStabilize", 18: "QHover", 19: "QLoiter", 20: "QLand", 21: "QRTL",
    22: "QAutotune", 23: "QAcro", 24: "Thermal", 25: "Loiter to QLand", 26: "Autoland",
}  # fmt: skip
_COPTER = {
    0: "Stabilize", 1: "Acro", 2: "Alt Hold", 3: "Auto", 4: "Guided", 5: "Loiter", 6: "RTL", 7: "Circle",
    9: "Land", 11: "Drift", 13: "Sport", 14: "Flip", 15: "Autotune", 16: "PosHold", 17: "Brake", 18: "Throw",
    19: "Avoid ADSB", 20: "Guided NoGPS", 21: "Smart RTL", 22: "FlowHold", 23: "Follow", 24: "ZigZag",
    25: "System ID", 26: "Autorotate", 27: "Auto RTL", 28: "Turtle",
}  # fmt: skip
_ROVER = {
    0: "Manual", 1: "Acro", 3: "Steering", 4: "Hold", 5: "Loiter", 6: "Follow", 7: "Simple", 8: "Dock",
    9: "Circle", 10: "Auto", 11: "RTL", 12: "Smart RTL", 15: "Guided", 16: "Initialising",
}  # fmt: skip
_SUB = {
    0: "Stabilize", 1: "Acro", 2: "Alt Hold", 3: "Auto", 4: "Guided", 7: "Circle", 9: "Surface",
    16: "PosHold", 19: "Manual", 20: "Motor Detect", 21: "SurfTrak",
}  # fmt: skip
_TRACKER = {0: "Manual", 1: "Stop", 2: "Scan", 3: "Servo Test", 4: "Guided", 10: "Auto", 16: "Initialising"}

_OF_TYPE = {
    **dict.fromkeys((1, 16, 19, 20, 21, 22, 23, 24, 25), _PLANE),
    **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35, 43), _COPTER),
    **dict.fromkeys((10, 11), _ROVER),
    5: _TRACKER,
    12: _SUB,
}
"""Modes of ArduPilot by `MAV_TYPE`."""

_PX4_MAIN = {
    1: "Manual", 2: "Altitude", 3: "Position", 4: "Auto", 5: "Acro", 6: "Offboard", 7: "Stabilized",
    8: "Rattitude", 10: "Termination",
}  # fmt: skip
_PX4_AUTO = {
    1: "Ready", 2: "Takeoff", 3: "Hold", 4: "Mission", 5: "Return", 6: "Land", 8: "Follow Me",
    9: "Precision Land", 10: "VTOL Takeoff",
}  # fmt: skip
_AUTO = 4


def mode_name(*, autopilot: int, kind: int, base: int, custom: int) -> str:
    """Return the name of a mode, and whether the vehicle is disarmed.

    Args:
        autopilot, kind, base, custom: `autopilot`, `type`, `base_mode` and `custom_mode` of a heartbeat.
    """
    name = None
    if base & _CUSTOM and autopilot == _ARDUPILOT:
        name = _OF_TYPE.get(kind, {}).get(custom)
    elif base & _CUSTOM and autopilot == _PX4:
        main, sub = custom >> 16 & 0xFF, custom >> 24
        name = _PX4_AUTO.get(sub) if main == _AUTO and sub else _PX4_MAIN.get(main)
    return (name or f"mode {custom}") + ("" if base & _ARMED else " (disarmed)")

"""MAVLink: vehicles with PX4 and ArduPilot, live in a mission."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.mavlink.command:mavlink", "Send vehicles with PX4 or ArduPilot to a mission, live."
)

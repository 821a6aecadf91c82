"""Client library for robots: sends poses and detected objects, and survives network outages.

It needs the standard library only.

::

    from webapp.robot import RobotClient

    with RobotClient(url, token, mission=7, spool="/var/spool/robot") as robot:
        robot.pose(50.0755, 14.4378, heading_deg=90.0)
"""

from .client import RobotClient
from .fixes import Fix, Near
from .options import RobotOptions, RobotStatus

__all__ = ["Fix", "Near", "RobotClient", "RobotOptions", "RobotStatus"]

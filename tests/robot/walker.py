"""A simulated robot: `python walker.py URL SPOOL COUNT` sends COUNT poses, and resumes after a kill."""

import dataclasses
import sys
import time

from tests.robot.quick import QUICK
from webapp.robot import RobotClient

if __name__ == "__main__":
    url, spool, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
    options = dataclasses.replace(QUICK, batch_records=20)
    with RobotClient(url, "token", mission=7, spool=spool, options=options) as robot:
        for number in range(robot.status().written, count):
            robot.pose(50 + number * 1e-6, 14, time_s=number)
            time.sleep(0.002)
        while not robot.upload(wait_s=1):
            pass

"""Options without long waits."""

from webapp.robot import RobotOptions

QUICK = RobotOptions(sync_s=0.01, every_s=0.02, timeout_s=2.0, backoff_s=0.01, backoff_max_s=0.05)

"""The robots' client: from its own distribution if installed, otherwise from the program."""

try:
    from expmap_robot import RobotClient, RobotOptions
    from expmap_robot.errors import DiskFull, ExpMapError, InputError, StorageError
    from expmap_robot.uplink import NoResponse, Uplink
except ModuleNotFoundError:
    from webapp.robot import RobotClient, RobotOptions
    from webapp.robot.errors import DiskFull, ExpMapError, InputError, StorageError
    from webapp.robot.uplink import NoResponse, Uplink

__all__ = [
    "DiskFull",
    "ExpMapError",
    "InputError",
    "NoResponse",
    "RobotClient",
    "RobotOptions",
    "StorageError",
    "Uplink",
]

"""Runs a node as a program; helpers shared by all nodes."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterable
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.exceptions import InvalidHandle
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions

from expmap_ros.parameters import ParameterError

IMAGES = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""For cameras: compatible with any publisher, and only the newest image is queued."""

RESULTS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

KEPT = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Latched: late subscribers get the last message, too."""

_LOOK_S = 0.25
"""Maximum delay until an interruption is noticed."""

_POLICIES = (
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY,
)  # fmt: skip


class DrainingExecutor(MultiThreadedExecutor):
    """Executor that shuts down after its callbacks, and survives entities destroyed while it waits.

    The executor of rclpy destroys its guard conditions first: a callback that begins after that fails, and
    "exception was never retrieved" is logged when it is garbage-collected. It also ends with `InvalidHandle`
    if a callback, such as that of a transition, destroys a subscription at the wrong moment, because it does
    not expect the events of subscriptions and publishers to be destroyed.
    """

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> Any:
        """Wait for ready callbacks; retry if an entity was destroyed meanwhile."""
        while True:
            try:
                return super().wait_for_ready_callbacks(*args, **kwargs)
            except InvalidHandle:
                if not self.context.ok():
                    raise

    def shutdown(self, timeout_sec: float | None = None, **options: Any) -> bool:
        """Wait for pending callbacks, then shut down.

        Options are those of the installed rclpy: older distributions have no `wait_for_threads`.
        """
        self._executor.shutdown(wait=True)
        return bool(super().shutdown(timeout_sec, **options))


def main(make: Callable[[], Node]) -> None:
    """Run a node until it is interrupted; running callbacks are completed.

    The exit code is 2 for an invalid parameter, and 1 if the node cannot start for another reason.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = make()
        stopping = _stop_when_interrupted()
    except KeyboardInterrupt:
        rclpy.try_shutdown()
        return
    except ParameterError as error:
        sys.exit(_refuse(str(error), code=2))
    except Exception as error:
        if not is_explained(error):
            raise
        sys.exit(_refuse(str(error), code=1))
    executor = DrainingExecutor(num_threads=3)
    executor.add_node(node)
    try:
        while not stopping.is_set():
            executor.spin_once(timeout_sec=_LOOK_S)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()


def _stop_when_interrupted() -> threading.Event:
    """Make signals set an event instead of interrupting the code that is running."""
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    return stopping


def _refuse(text: str, *, code: int) -> int:
    sys.stderr.write(f"expmap_ros: {text}\n")
    rclpy.try_shutdown()
    return code


def is_explained(error: Exception) -> bool:
    """Return whether an error is an `ExpMapError`, of either distribution, with a message for users."""
    return any(kind.__name__ == "ExpMapError" for kind in type(error).__mro__)


def overridable() -> QoSOverridingOptions:
    """Allow parameters `qos_overrides.TOPIC...` to change history, depth, reliability and durability."""
    return QoSOverridingOptions(_POLICIES)


def seconds(stamp: Time) -> float:
    """Convert a stamp to seconds; 0 means that the time is unknown."""
    return float(stamp.sec + stamp.nanosec * 1e-9)


def diagnostics(
    node: Node, level: bytes, message: str, *, values: Iterable[tuple[str, Any]]
) -> DiagnosticArray:
    """Make a message for `/diagnostics` with the state of a node."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values]
    status = DiagnosticStatus(
        level=level, name=node.get_fully_qualified_name(), message=message, values=pairs
    )
    made = DiagnosticArray(status=[status])
    made.header.stamp = node.get_clock().now().to_msg()
    return made

"""Starts a node as a program, and what all nodes share."""

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
"""Of cameras: any publisher is understood, and only the newest image waits."""

RESULTS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

KEPT = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""The last one goes to those who come later, too."""

_LOOK_S = 0.25
"""So long an interruption waits at most."""

_POLICIES = (
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY,
)  # fmt: skip


class DrainingExecutor(MultiThreadedExecutor):
    """Ends after its callbacks, and goes on when one of them destroys what it is about to wait for.

    That of rclpy first destroys what they wake it with: one that begins after that fails, and "exception was
    never retrieved" is written when it is collected. And it ends with `InvalidHandle` where a callback, such
    as that of a transition, destroys a subscription at a bad moment: it looks for events of subscriptions and
    publishers without expecting that they are gone.
    """

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> Any:
        """Wait for what is ready; once more without what is gone by now."""
        while True:
            try:
                return super().wait_for_ready_callbacks(*args, **kwargs)
            except InvalidHandle:
                if not self.context.ok():
                    raise

    def shutdown(self, timeout_sec: float | None = None, *, wait_for_threads: bool = True) -> bool:
        """Wait for the callbacks that are ready, and end."""
        self._executor.shutdown(wait=True)
        return bool(super().shutdown(timeout_sec, wait_for_threads=wait_for_threads))


def main(make: Callable[[], Node]) -> None:
    """Run a node until it is interrupted; what it is doing then, it finishes.

    The exit code is 2 where a parameter is wrong, and 1 where something else keeps it from starting.
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
    """Have interruptions set an event from now on, so that none comes in the middle of anything."""
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    return stopping


def _refuse(text: str, *, code: int) -> int:
    sys.stderr.write(f"expmap_ros: {text}\n")
    rclpy.try_shutdown()
    return code


def is_explained(error: Exception) -> bool:
    """Return whether an error of the program says what is wrong, by whatever name it is installed."""
    return any(kind.__name__ == "ExpMapError" for kind in type(error).__mro__)


def overridable() -> QoSOverridingOptions:
    """Let parameters `qos_overrides.TOPIC...` change history, depth, reliability and durability."""
    return QoSOverridingOptions(_POLICIES)


def seconds(stamp: Time) -> float:
    """Seconds of a stamp; 0 where nobody knew the time."""
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

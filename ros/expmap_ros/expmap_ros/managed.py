"""The lifecycle of all nodes: `configure` acquires resources, `activate` starts the work."""

from __future__ import annotations

import threading
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from copy import copy
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile

from expmap_ros import running
from expmap_ros.parameters import Parameter, ParameterError, declare

AUTOSTART = Parameter(
    "autostart", True, "Configure and activate at the start; otherwise a lifecycle manager does."
)
"""Parameter of every node."""


class ManagedNode(LifecycleNode, ABC):
    """A lifecycle node that starts itself unless `autostart` is false.

    Nodes override `configure` and `activate`. Everything that these create by the methods below is destroyed
    when the node is cleaned up or deactivated, after running callbacks have ended.
    """

    def __init__(self, name: str, parameters: Sequence[Parameter], **options: Any) -> None:
        self._configured = ExitStack()  # first, since a node whose creation fails is destroyed, too
        self._activated = ExitStack()
        self._problem: Exception | None = None
        self._is_starting = False
        super().__init__(name, **options)
        self._values = declare(self, (*parameters, AUTOSTART))

    @abstractmethod
    def configure(self) -> None:
        """Acquire resources, and advertise topics. Raises ParameterError."""

    @abstractmethod
    def activate(self) -> None:
        """Subscribe to topics, and start services and timers."""

    def start(self) -> None:
        """Configure and activate the node if `autostart` is true; raise the error if that fails."""
        if not self._values["autostart"]:
            return
        self._is_starting = True
        for step in (self.trigger_configure, self.trigger_activate):
            if step() != TransitionCallbackReturn.SUCCESS:
                raise self._problem or RuntimeError("the node did not start")
        self._is_starting = False

    def destroy_node(self) -> None:
        """Release all resources, and destroy the node."""
        self._close()
        super().destroy_node()

    def holds(self, close: Callable[..., Any], *arguments: Any) -> None:
        """Register a function to be called when the node is cleaned up."""
        self._configured.callback(close, *arguments)

    def advertise(self, kind: type, topic: str, quality: QoSProfile) -> Any:
        """Create a publisher, which lives until the node is cleaned up."""
        own = copy(quality)  # rclpy writes QoS overrides into the profile object
        made = self.create_publisher(kind, topic, own, qos_overriding_options=running.overridable())
        self._configured.callback(self.destroy_publisher, made)
        return made

    def listen(
        self,
        kind: type,
        topic: str,
        take: Callable[[Any, Any], None],
        *,
        quality: QoSProfile,
        group: CallbackGroup | None = None,
    ) -> None:
        """Subscribe until the node is deactivated; `take` is called with each message and its info."""
        gate = _Gate()
        made = self.create_subscription(
            kind,
            topic,
            lambda message, info: gate.run(take, message, info),
            copy(quality),
            callback_group=group,
            qos_overriding_options=running.overridable(),
        )
        self._activated.callback(self.destroy_subscription, made)
        self._activated.callback(gate.close)

    def serve(
        self, kind: type, name: str, answer: Callable[[Any, Any], Any], *, group: CallbackGroup | None = None
    ) -> None:
        """Offer a service, until the node is deactivated."""
        gate = _Gate()
        made = self.create_service(
            kind, name, lambda asked, reply: gate.run(answer, asked, reply) or reply, callback_group=group
        )
        self._activated.callback(self.destroy_service, made)
        self._activated.callback(gate.close)

    def repeat(self, period_s: float, work: Callable[[], None], *, group: CallbackGroup | None = None) -> Any:
        """Start a timer, until the node is deactivated."""
        gate = _Gate()
        made = self.create_timer(period_s, lambda: gate.run(work), callback_group=group)
        self._activated.callback(self.destroy_timer, made)
        self._activated.callback(gate.close)
        return made

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure; see `configure`."""
        return self._attempt(self.configure, undo=self._configured)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate; see `activate`."""
        return self._attempt(self.activate, undo=self._activated)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop subscriptions, services and timers; keep resources."""
        self._activated.close()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release the resources of `configure`."""
        self._configured.close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release all resources."""
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release all resources, so that the node can be configured again."""
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def _close(self) -> None:
        self._activated.close()
        self._configured.close()

    def _attempt(self, work: Callable[[], None], *, undo: ExitStack) -> TransitionCallbackReturn:
        try:
            work()
        except Exception as error:  # noqa: BLE001 - rclpy would swallow it
            undo.close()
            self._problem = error
            expected = isinstance(error, ParameterError) or running.is_explained(error)
            if not self._is_starting:
                self.get_logger().error(str(error) if expected else traceback.format_exc())
            return TransitionCallbackReturn.FAILURE if expected else TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS


class _Gate:
    """Lets callbacks run until it is closed; closing waits for a running one."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._is_open = True

    def run(self, work: Callable[..., Any], *arguments: Any) -> Any:
        with self._guard:
            return work(*arguments) if self._is_open else None

    def close(self) -> None:
        with self._guard:
            self._is_open = False

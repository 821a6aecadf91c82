"""Lifecycle of nodes: a manager configures, activates and stops them, or they start themselves."""

import gc
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import String

from expmap_ros.fix_bridge import FixBridge
from expmap_ros.mission_bridge import MissionBridge
from expmap_ros.pose_estimator import PoseEstimator
from expmap_ros.running import DrainingExecutor
from expmap_ros.visualizer import Visualizer
from ros.expmap_ros.test.support import LAT, LON
from ros.expmap_ros.test.test_answers_shown import answer

CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
SHUTDOWN = Transition.TRANSITION_INACTIVE_SHUTDOWN


class Manager:
    """Lifecycle manager of a node, through its services."""

    def __init__(self, bench, name):
        self._bench = bench
        self._change = bench.node.create_client(ChangeState, f"/{name}/change_state")
        self._get = bench.node.create_client(GetState, f"/{name}/get_state")
        assert self._change.wait_for_service(timeout_sec=60)

    def __call__(self, transition):
        """Request a transition; return whether it succeeded, and the state after it."""
        done = self._change.call_async(ChangeState.Request(transition=Transition(id=transition)))
        self._bench.until(done.done)
        now = self._get.call_async(GetState.Request())
        self._bench.until(now.done)
        return done.result().success, now.result().current_state.id


def test_a_managed_node_works_only_while_it_is_active(bench):
    node = bench.start(FixBridge, autostart=False, origin=f"{LAT},{LON}")
    manage = Manager(bench, "fix_bridge")
    poses = bench.listen(PoseWithCovarianceStamped, "/visual_pose")
    source = bench.node.create_publisher(String, "/pose_estimator/answer", 10)
    for seconds in (5, 6):  # twice: after the cleanup the node can be configured again
        assert node.count_publishers("/visual_pose") == 0
        assert manage(CONFIGURE) == (True, State.PRIMARY_STATE_INACTIVE)
        assert node.count_subscribers("/pose_estimator/answer") == 0
        assert manage(ACTIVATE) == (True, State.PRIMARY_STATE_ACTIVE)
        shown = answer(second=seconds)
        bench.until(
            lambda s=seconds: any(p.header.stamp.sec == s for p in poses),
            lambda message=shown: source.publish(message),
        )
        assert manage(DEACTIVATE) == (True, State.PRIMARY_STATE_INACTIVE)
        bench.until(lambda: node.count_subscribers("/pose_estimator/answer") == 0)
        assert manage(CLEANUP) == (True, State.PRIMARY_STATE_UNCONFIGURED)
        bench.until(lambda: node.count_publishers("/visual_pose") == 0)
    assert manage(CONFIGURE)[0]
    assert manage(SHUTDOWN) == (True, State.PRIMARY_STATE_FINALIZED)


@pytest.mark.parametrize("kind", [PoseEstimator, Visualizer])
def test_a_node_that_cannot_be_configured_says_so_and_stays_unconfigured(bench, tmp_path, kind, capfd):
    (tmp_path / "map.cfg").write_text("no map")
    node = bench.start(kind, autostart=False, map_file=str(tmp_path / "map.cfg"))
    assert Manager(bench, node.get_name())(CONFIGURE) == (False, State.PRIMARY_STATE_UNCONFIGURED)
    assert "map.cfg" in capfd.readouterr().err


def test_a_bridge_that_is_cleaned_up_releases_its_spool(bench, server, values):
    bench.start(MissionBridge, autostart=False, **values)
    manage = Manager(bench, "mission_bridge")
    for transition in (CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP):
        assert manage(transition)[0]
    bench.start(MissionBridge, **values, **{"qos_overrides./fix.subscription.depth": 7})


def test_a_callback_that_is_ready_at_the_end_ends_in_peace(bench, monkeypatch, capsys):
    released = threading.Event()
    end_threads = ThreadPoolExecutor.shutdown

    def release_and_end(pool, *arguments, **named):
        released.set()
        end_threads(pool, *arguments, **named)

    monkeypatch.setattr(ThreadPoolExecutor, "shutdown", release_and_end)
    node, ran = Node("busy", context=bench.context), []

    def work():
        assert released.wait(60)
        ran.append(1)

    for _ in range(3):
        node.create_timer(0.001, work, callback_group=MutuallyExclusiveCallbackGroup())
    executor = DrainingExecutor(num_threads=2, context=bench.context)
    executor.add_node(node)
    while executor._executor._work_queue.empty():  # both threads are busy, and the third callback is queued
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    del executor, node
    gc.collect()
    assert len(ran) >= 3
    assert "never retrieved" not in capsys.readouterr().err


def test_what_a_callback_destroys_at_a_bad_moment_ends_no_node(bench, monkeypatch):
    subscription = bench.node.create_subscription(String, "/words", print, 10)
    (event, *_) = subscription.event_handlers
    add, added = event.add_to_wait_set, []

    def destroy_first(wait_set):
        """Destroy the subscription as another thread may, after the executor has listed its entities."""
        bench.node.destroy_subscription(subscription)
        added.append(event)
        add(wait_set)

    monkeypatch.setattr(event, "add_to_wait_set", destroy_first)
    ticks = []
    bench.node.create_timer(0.01, lambda: ticks.append(1))
    bench.until(lambda: ticks)
    assert added

"""A process with nodes of rclpy, run by the Python that has ROS 2's wheels.

usage: node.py ACT DOMAIN TOPIC TEXT SECONDS NODE... [--ros-args ...]

The first five are what pqsec_pki.trial tells a peer, and what is printed is what a peer says:
`joined`, `matched`, `received TEXT`, `refused WHY`. In its domain a node is by ROS_DOMAIN_ID.

send      publish TEXT on TOPIC until who listened has gone
receive   listen on TOPIC until the first message
idle      be there for SECONDS
raise     likewise, and end by an exception
call      list the parameters of the node called TOPIC
clock     use simulated time
managed   be a lifecycle node
serve     offer the action TOPIC
act       use it once
"""

import sys
import time
from pathlib import Path

import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.action import ActionClient, ActionServer
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from test_msgs.action import Fibonacci

REFUSED = 3
TURN = 0.02
"""Seconds that a node is spun at a time."""


def say(*words):
    print(*words, flush=True)


class Process:
    """The nodes of this process, the first of which acts."""

    def __init__(self, topic, text, seconds):
        self.topic, self.text, self.end = topic, text, time.monotonic() + float(seconds)
        self.nodes = []

    @property
    def node(self):
        return self.nodes[0]

    def turn(self):
        """Let the nodes live; whether there is time left."""
        for node in self.nodes:
            rclpy.spin_once(node, timeout_sec=TURN)
        return time.monotonic() < self.end

    def until(self, condition):
        """Whether it came about in time."""
        while not (met := condition()) and self.turn():
            pass
        return met

    def send(self):
        publisher = self.node.create_publisher(String, self.topic, 10)
        say("joined")
        if self.until(publisher.get_subscription_count):
            say("matched")
        while publisher.get_subscription_count() and self.turn():
            publisher.publish(String(data=self.text))

    def receive(self):
        got = []
        self.node.create_subscription(String, self.topic, got.append, 10)
        say("joined")
        if self.until(lambda: got):
            say("received", got[0].data)

    def idle(self):
        say("joined")
        self.until(lambda: False)

    def clock(self):
        simulated = Parameter("use_sim_time", Parameter.Type.BOOL, value=True)
        assert self.node.set_parameters([simulated])[0].successful
        self.idle()

    managed = idle

    def call(self):
        client = self.node.create_client(ListParameters, f"{self.topic}/list_parameters")
        say("joined")
        if self.until(client.service_is_ready):
            answer = client.call_async(ListParameters.Request())
            if self.until(answer.done):
                say("received", *answer.result().result.names)

    def serve(self):
        def work(goal):
            goal.succeed()
            return Fibonacci.Result(sequence=[1, 1, 2])

        ActionServer(self.node, Fibonacci, self.topic, work)
        self.idle()

    def act(self):
        client = ActionClient(self.node, Fibonacci, self.topic)
        say("joined")
        if not self.until(client.server_is_ready):
            return
        say("matched")
        sent = client.send_goal_async(Fibonacci.Goal(order=3))
        if self.until(sent.done):
            result = sent.result().get_result_async()
            if self.until(result.done):
                say("received", list(result.result().result.sequence))


def main():
    act, _, topic, text, seconds, *rest = sys.argv[1:]
    names = rest[: rest.index("--ros-args")] if "--ros-args" in rest else rest
    kind = LifecycleNode if act == "managed" else Node
    process = Process(topic, text, seconds)
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    try:
        for name in names:
            namespace, _, base = name.rpartition("/")
            process.nodes.append(kind(base, namespace=namespace))
        if act == "raise":
            process.idle()
            raise SystemExit("as it was told")
        getattr(process, act)()
    except RuntimeError as error:  # what rclpy makes of what rcl says
        say("refused", str(error).replace("\n", " "))
        sys.exit(REFUSED)
    files = {line.rpartition("/")[2] for line in Path("/proc/self/maps").read_text().splitlines()}
    say("loaded", *sorted(name for name in files if "dds_security" in name or "pqsec" in name))
    for node in process.nodes:
        node.destroy_node()
    rclpy.shutdown()
    say("ended")


main()

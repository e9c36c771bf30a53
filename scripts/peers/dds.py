"""Exchanges images, clouds and transforms between lsdc-dds and Eclipse Cyclone DDS (its Python package), there and back.

    pip install cyclonedds
    cargo build --release -p lsdc-dds --example relay
    python scripts/peers/dds.py target/release/examples/relay

The program republishes every message under another name; all bytes must come back unchanged. Then each side is killed
(SIGKILL) and restarted. `--graph` also reads the node's name as `ros2 node list` does.
"""

import argparse
import multiprocessing
import os
import subprocess
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

DOMAIN = 87
PATIENCE = 20.0


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class Node(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[array[uint8, 16]]
    writer_gid_seq: sequence[array[uint8, 16]]


@dataclass
class Graph(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: array[uint8, 16]
    node_entities_info_seq: sequence[Node]


def qos(name):
    if name == "sensor":
        return Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
    reliable = Policy.Reliability.Reliable(duration(milliseconds=100))
    if name == "latched":
        return Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    return Qos(reliable, Policy.History.KeepLast(10))


def header(number):
    return Header(Time(number, 500_000_000), f"frame_{number}")


def image(number):
    data = bytes((at * 7 + number) & 255 for at in range(2560)) * 480
    return Image(header(number), 480, 640, "32FC1", 0, 2560, list(data))


def cloud(number):
    fields = [PointField(name, 4 * at, 7, 1) for at, name in enumerate("xyz")]
    data = bytes((at + number) & 255 for at in range(12 * 1024)) * 163
    return PointCloud2(header(number), 1, len(data) // 12, fields, False, 12, len(data), list(data), True)


def transforms(number):
    pose = Transform(Vector3(1.5, -2.25, number), Quaternion(0.0, 0.0, 0.6, 0.8))
    return TFMessage([TransformStamped(header(number), "camera", pose)])


class Ends:
    """A writer of one topic and a reader of another."""

    def __init__(self, kind, quality, out, back):
        self.participant = DomainParticipant(DOMAIN)
        self.writer = DataWriter(self.participant, Topic(self.participant, out, kind), qos=qos(quality))
        self.reader = DataReader(self.participant, Topic(self.participant, back, kind), qos=qos(quality))

    def exchange(self, message, again=False):
        """Writes a message until it comes back, repeatedly while the other side is starting."""
        start = written = time.monotonic()
        self.writer.write(message)
        while time.monotonic() - start < PATIENCE:
            for received in self.reader.take(10):
                if received == message:
                    return time.monotonic() - written
            if again and time.monotonic() - written > 1:
                written = time.monotonic()
                self.writer.write(message)
            time.sleep(0.001)
        raise SystemExit(f"{type(message).__name__} did not come back within {PATIENCE:.0f} s")


def start(relay, out, back, kind, quality):
    environment = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)}
    return subprocess.Popen([relay, out, back, kind, quality], env=environment, stdout=subprocess.DEVNULL)


def publish_until_killed(quality):
    ends = Ends(Image, quality, "rt/camera/image_raw", "rt/nothing")
    message = image(77)
    while True:
        ends.writer.write(message)
        time.sleep(0.1)


def check(relay, kind, name, make, quality, count):
    with_name = f"rt/{name}", f"rt/{name}_back"
    process = start(relay, f"/{name}", f"/{name}_back", kind, quality)
    try:
        ends = Ends(type(make(0)), quality, *with_name)
        ends.exchange(make(0), again=True)
        times = sorted(ends.exchange(make(number)) for number in range(1, count + 1))
        print(f"{kind}, {quality}: {count} there and back, median {1e3 * times[count // 2]:.1f} ms", flush=True)
    finally:
        process.kill()
        process.wait()


def check_kills(relay):
    arguments = "/camera/image_raw", "/camera/back", "sensor_msgs/msg/Image", "default"
    process = start(relay, *arguments)
    ends = Ends(Image, "default", "rt/camera/image_raw", "rt/camera/back")
    ends.exchange(image(1), again=True)
    process.kill()
    process.wait()
    process = start(relay, *arguments)
    ends.exchange(image(2), again=True)
    print("lsdc killed and started again: goes on", flush=True)
    for number in range(2):
        publisher = multiprocessing.get_context("spawn").Process(target=publish_until_killed, args=("default",))
        publisher.start()
        begin = time.monotonic()
        while not any(message == image(77) for message in ends.reader.take(10)):
            if time.monotonic() - begin > PATIENCE:
                raise SystemExit("nothing came from a publisher that was started again")
            time.sleep(0.01)
        publisher.kill()
        publisher.join()
        ends.reader.take(100)
    print("the publisher killed and started again: goes on", flush=True)
    process.kill()
    process.wait()


def check_latched(relay):
    """Checks that a transform written before there were listeners arrives."""
    ends = Ends(TFMessage, "latched", "rt/tf_static", "rt/tf_static_back")
    ends.writer.write(transforms(3))
    time.sleep(1)
    process = start(relay, "/tf_static", "/tf_static_back", "tf2_msgs/msg/TFMessage", "latched")
    begin = time.monotonic()
    # A second listener joins after the transform has come back.
    for reader in (ends, None):
        if reader is None:
            reader = Ends(TFMessage, "latched", "rt/other", "rt/tf_static_back")
        while reader.reader.take(10) != [transforms(3)]:
            if time.monotonic() - begin > PATIENCE:
                raise SystemExit("the latched transform did not come")
            time.sleep(0.01)
    print("tf2_msgs/msg/TFMessage, latched: for those that come later, both ways", flush=True)
    process.kill()
    process.wait()


def check_graph(relay):
    process = start(relay, "/a", "/b", "sensor_msgs/msg/Image", "default")
    participant = DomainParticipant(DOMAIN)
    reader = DataReader(participant, Topic(participant, "ros_discovery_info", Graph), qos=qos("latched"))
    begin, nodes = time.monotonic(), None
    while nodes != [("/", "lsdc", 1, 1)]:
        for message in reader.take(10):
            nodes = [
                (node.node_namespace, node.node_name, len(node.reader_gid_seq), len(node.writer_gid_seq))
                for node in message.node_entities_info_seq
            ]
        if time.monotonic() - begin > PATIENCE:
            raise SystemExit(f"the graph has {nodes}")
        time.sleep(0.01)
    print("ros_discovery_info: node /lsdc with one reader and one writer", flush=True)
    process.kill()
    process.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("relay", help="the example `relay` of lsdc-dds")
    parser.add_argument("--count", type=int, default=10, help="messages of each kind [default: 10]")
    options = parser.parse_args()
    relay = os.path.abspath(options.relay)
    for quality in ("sensor", "default"):
        check(relay, "sensor_msgs/msg/Image", "image", image, quality, options.count)
        check(relay, "sensor_msgs/msg/PointCloud2", "points", cloud, quality, options.count)
    check(relay, "tf2_msgs/msg/TFMessage", "tf", transforms, "default", options.count)
    check_latched(relay)
    check_kills(relay)
    check_graph(relay)


if __name__ == "__main__":
    main()

"""Plays a recording to `lsdc node` with Eclipse Cyclone DDS, and measures the results.

    pip install cyclonedds mcap
    python scripts/recordings.py drive 60 /tmp/drive     # makes a recording; needs more packages, which it names
    python scripts/peers/node.py target/release/lsdc /tmp/drive/drive.mcap --image /camera/image_raw --points /lidar/points \\
        --rate 10 --seconds 600

A separate process sends images at a fixed rate, with the other messages of the recording at their relative times; the
recording is repeated with later stamps. Prints the numbers of images sent and depths received, the latency from sending an
image to receiving its depth, and processor time and memory of the node. Diagnostics and, in the end, the node report on every
image. With --kill N, node and player are each killed (SIGKILL) and restarted N times. --within starts the node with another
command, such as `ip netns exec NAME`. --loss permits images to be lost in transit. Other options are passed to the node.
"""

import argparse
import os
import re
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass

from cyclonedds.core import Listener
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from mcap.reader import make_reader

import dds

DOMAIN = 88
TYPES = {f"sensor_msgs/msg/{kind.__name__}": kind for kind in [dds.Image, dds.CompressedImage, dds.CameraInfo, dds.PointCloud2]}
TYPES["tf2_msgs/msg/TFMessage"] = dds.TFMessage


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: dds.Header
    status: sequence[DiagnosticStatus]


def as_bytes(kind, data):
    """A message that is already encoded: encoding lists in Python would take longer than the node."""
    message = object.__new__(kind)
    message.serialize = lambda **_: data
    return message


class Received:
    """A received message as bytes, for the same reason."""

    def __init__(self, data):
        self.data = bytes(data)


def aligned(offset, size):
    """Returns the next offset of a value of this size in CDR, which begins after four bytes."""
    return 4 + (offset - 4 + size - 1) // size * size


def stamps(data, kind):
    """Returns the offsets of the stamps of a message."""
    if kind != "tf2_msgs/msg/TFMessage":
        return [4]
    (count,) = struct.unpack_from("<I", data, 4)
    found, offset = [], 8
    for _ in range(count):
        offset = aligned(offset, 4)
        found.append(offset)
        offset += 8
        for _ in range(2):
            offset = aligned(offset, 4)
            (length,) = struct.unpack_from("<I", data, offset)
            offset += 4 + length
        offset = aligned(offset, 8) + 7 * 8
    return found


def later(data, kind, seconds):
    data = bytearray(data)
    for offset in stamps(data, kind):
        (whole,) = struct.unpack_from("<i", data, offset)
        struct.pack_into("<i", data, offset, whole + seconds)
    return bytes(data)


def stamp(data):
    return struct.unpack_from("<iI", data, 4)


def usage(process):
    """Returns the processor time in seconds, and the memory in MB."""
    with open(f"/proc/{process.pid}/stat") as file:
        user, system = file.read().rsplit(")", 1)[1].split()[11:13]
    with open(f"/proc/{process.pid}/status") as file:
        memory = int(re.search(r"VmRSS:\s+(\d+)", file.read()).group(1)) / 1024
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK"), memory


def play(args):
    """Sends messages until it is killed; prints stamps and times of images, and the lap at which the next player begins."""
    messages = []
    with open(args.recording, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            messages.append((channel.topic, schema.name, message.data))
    images = [data for topic, _, data in messages if topic == args.image]
    (first, _), (last, _) = stamp(images[0]), stamp(images[-1])
    period = last - first + 10
    participant = DomainParticipant(DOMAIN)
    writers = {}
    for topic, kind in {(topic, kind) for topic, kind, _ in messages if kind in TYPES}:
        quality = "latched" if topic.endswith("static") else "default"
        writers[topic] = DataWriter(participant, Topic(participant, "rt" + topic, TYPES[kind]), qos=dds.qos(quality))
    while len(writers[args.image].get_matched_subscriptions()) < 1:
        time.sleep(0.1)
    time.sleep(1.0)
    begun, number, lap = time.monotonic(), 0, args.lap
    while True:
        for topic, kind, data in messages:
            if topic not in writers or (topic.endswith("static") and lap > args.lap):
                continue
            data = later(data, kind, lap * period)
            if topic == args.image:
                wait = begun + number / args.rate - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                number += 1
                print(*stamp(data), time.monotonic(), lap, flush=True)
            writers[topic].write(as_bytes(TYPES[kind], data))
        lap += 1


class Side:
    """A process that is killed and restarted."""

    def __init__(self, command, **pipes):
        self.command, self.pipes, self.spent, self.memory = command, pipes, 0.0, []
        self.start()

    def start(self):
        self.process, self.first = subprocess.Popen(self.command(), **self.pipes), None

    def measure(self):
        self.now, memory = usage(self.process)
        # Reading weights, before the first image, does not count as work on images.
        self.first = self.now if self.first is None else self.first
        self.memory.append(memory)

    def kill(self):
        self.measure()
        self.spent += self.now - self.first
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def kinds_left_out(values):
    """Returns the reasons for skipped images in the node's diagnostics: after the first two values, before the latency."""
    kinds = {}
    for key, value in values[2:]:
        if key == "latency":
            break
        kinds[key] = int(value)
    return kinds


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program")
    parser.add_argument("recording")
    parser.add_argument("--image", required=True)
    parser.add_argument("--points", required=True)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--kill", type=int, default=0)
    parser.add_argument("--within", default="")
    parser.add_argument("--loss", action="store_true")
    parser.add_argument("--domain", type=int, default=88)
    parser.add_argument("--lap", type=int, help=argparse.SUPPRESS)
    args, rest = parser.parse_known_args()
    global DOMAIN
    DOMAIN = args.domain
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    if args.lap is not None:
        return play(args)

    sent, received, said, lock = {}, {}, {}, threading.Lock()
    runs, lap = 0, 0
    participant = DomainParticipant(DOMAIN)
    diagnostics = DataReader(participant, Topic(participant, "rt/diagnostics", DiagnosticArray), qos=dds.qos("default"))
    dds.Image.deserialize = Received
    depth = Topic(participant, "rt/lsdc/depth/image", dds.Image)

    class Take(Listener):
        def on_data_available(self, reader):
            now = time.monotonic()
            for message in reader.take(10):
                if isinstance(message, Received):
                    with lock:
                        received.setdefault(stamp(message.data), now)

    reader = DataReader(participant, depth, qos=dds.qos("default"), listener=Take())
    log = tempfile.TemporaryFile("w+")
    node_command = [*args.within.split(), args.program, "node", "--image", args.image, "--points", args.points, *rest]
    node = Side(lambda: node_command, stderr=log, stdout=log)
    player_command = [sys.executable, __file__, args.program, args.recording, "--image", args.image, "--points", args.points]
    player_command += ["--rate", str(args.rate), "--domain", str(DOMAIN), "--lap"]
    player = Side(lambda: [*player_command, str(lap)], stdout=subprocess.PIPE, text=True)

    def note(lines):
        nonlocal lap
        for line in lines:
            second, nanosecond, at, now = line.split()
            sent[int(second), int(nanosecond)] = float(at)
            lap = int(now) + 1

    reading = threading.Thread(target=note, args=(player.process.stdout,))
    reading.start()
    while not sent:
        time.sleep(0.05)
    begun, kills = time.monotonic(), 0
    while time.monotonic() - begun < args.seconds:
        time.sleep(0.5)
        node.measure()
        for message in diagnostics.take(100):
            if isinstance(message, DiagnosticArray):
                values = [(value.key, value.value) for value in message.status[0].values]
                said[runs] = values
        if kills < 2 * args.kill and time.monotonic() - begun > (kills + 1) * args.seconds / (2 * args.kill + 1):
            side, kills = [node, player][kills % 2], kills + 1
            side.kill()
            if side is player:
                reading.join()
            side.start()
            if side is player:
                reading = threading.Thread(target=note, args=(player.process.stdout,))
                reading.start()
            else:
                runs += 1
    player.kill()
    reading.join()
    time.sleep(2.0)
    node.measure()
    node.process.terminate()
    node.process.wait()
    log.seek(0)
    text = log.read().strip()
    with lock:
        times = sorted(received[key] - sent[key] for key in sent if key in received)
    assert times, f"no depth was received\n{text}"
    text = text.rsplit("node ", 1)[-1]
    counts = re.search(r"(\d+) received, (\d+) completed, (\d+) waiting", text)
    seen, completed, waiting = map(int, counts.groups())
    left_out = {kind: int(count) for count, kind in re.findall(r"^left out  (\d+) (.*)$", text, re.M)}
    assert seen == completed + waiting + sum(left_out.values()), "an image is not accounted for"
    # The last diagnostics of killed nodes, up to a second old.
    for run, values in said.items():
        if run < runs and values[0][0] == "images":
            images, done, kinds = int(values[0][1]), int(values[1][1]), kinds_left_out(values)
            assert 0 <= images - done - sum(kinds.values()) <= 20, f"an image is not accounted for: {values}"
            seen, completed = seen + images, completed + done
            for kind, count in kinds.items():
                left_out[kind] = left_out.get(kind, 0) + count
    print(f"sent {len(sent)} images in {args.seconds:.0f} s, received {len(times)} depths; {kills} kills")
    print(f"said {seen} received, {completed} completed", *(f"{count} {kind}" for kind, count in left_out.items()), sep="; ")
    at = lambda share: 1000 * times[min(int(share * len(times)), len(times) - 1)]
    print(f"latency p50 {at(0.5):.0f} ms, p90 {at(0.9):.0f} ms, p99 {at(0.99):.0f} ms")
    processor = node.spent + node.now - node.first
    memory = " ".join(f"{m:.0f}" for m in node.memory[:: max(1, len(node.memory) // 20)])
    print(f"processor {processor / args.seconds:.2f} cores, {1000 * processor / len(times):.0f} ms a depth; memory {memory} MB")
    assert args.kill or args.loss or (seen == len(sent) and completed == len(times)), "messages were lost"


if __name__ == "__main__":
    main()

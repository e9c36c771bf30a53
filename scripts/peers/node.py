"""Plays a recording to `lsdc node` by Eclipse Cyclone DDS, and measures what comes back.

    pip install cyclonedds mcap
    python scripts/peers/node.py target/release/lsdc drive.mcap --image /camera/image_raw --points /lidar/points \
        --rate 10 --seconds 600

Images are sent at a rate, other messages of the recording at their times beside them; the recording is repeated with later
stamps. Prints how many images were sent, how many depths were received, the latency from sending an image to receiving its
depth, and processor time and memory of the node. In the end the node says what became of every image. With --kill, the node is
killed (SIGKILL) and started again so many times.
"""

import argparse
import os
import re
import signal
import struct
import subprocess
import tempfile
import threading
import time

from cyclonedds.core import Listener
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from mcap.reader import make_reader

import dds

DOMAIN = 88
TYPES = {f"sensor_msgs/msg/{kind.__name__}": kind for kind in [dds.Image, dds.CompressedImage, dds.CameraInfo, dds.PointCloud2]}
TYPES["tf2_msgs/msg/TFMessage"] = dds.TFMessage


def as_bytes(kind, data):
    """A message of a type that is encoded already: encoding lists in Python would take longer than the node."""
    message = object.__new__(kind)
    message.serialize = lambda **_: data
    return message


class Received:
    """A message as bytes, for the same reason."""

    def __init__(self, data):
        self.data = bytes(data)


def aligned(offset, size):
    """The next offset of a value of this size in CDR, which begins after four bytes."""
    return 4 + (offset - 4 + size - 1) // size * size


def stamps(data, kind):
    """The offsets of the stamps of a message."""
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
    """Processor time in seconds, and the peak of memory in MB."""
    with open(f"/proc/{process.pid}/stat") as file:
        user, system = file.read().rsplit(")", 1)[1].split()[11:13]
    with open(f"/proc/{process.pid}/status") as file:
        memory = int(re.search(r"VmRSS:\s+(\d+)", file.read()).group(1)) / 1024
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK"), memory


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("program")
    parser.add_argument("recording")
    parser.add_argument("--image", required=True)
    parser.add_argument("--points", required=True)
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--kill", type=int, default=0)
    args, rest = parser.parse_known_args()

    messages = []
    with open(args.recording, "rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            messages.append((channel.topic, schema.name, message.data))
    images = [data for topic, _, data in messages if topic == args.image]
    (first, _), (last, _) = stamp(images[0]), stamp(images[-1])
    period = last - first + 10

    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    participant = DomainParticipant(DOMAIN)
    writers = {}
    for topic, kind in {(topic, kind) for topic, kind, _ in messages}:
        if kind not in TYPES:
            print(f"left out: {topic} of {kind}")
            continue
        quality = "latched" if topic.endswith("static") else "default"
        writers[topic] = DataWriter(participant, Topic(participant, "rt" + topic, TYPES[kind]), qos=dds.qos(quality))

    sent, received, lock = {}, {}, threading.Lock()
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
    start = lambda: subprocess.Popen([args.program, "node", "--image", args.image, "--points", args.points, *rest],
                                     stderr=log, stdout=log)
    node = start()
    while len(writers[args.image].get_matched_subscriptions()) < 1:
        time.sleep(0.1)
    time.sleep(1.0)
    begun, number, memory, kills, lap = time.monotonic(), 0, [], 0, 0
    spent = 0.0
    while time.monotonic() - begun < args.seconds:
        for topic, kind, data in messages:
            if topic not in writers or (topic.endswith("static") and lap > 0):
                continue
            data = later(data, kind, lap * period)
            if topic == args.image:
                wait = begun + number / args.rate - time.monotonic()
                if wait > 0:
                    time.sleep(wait)
                number += 1
                sent[stamp(data)] = time.monotonic()
                if number % 50 == 0:
                    memory.append(usage(node)[1])
            writers[topic].write(as_bytes(TYPES[kind], data))
            if kills < args.kill and time.monotonic() - begun > (kills + 1) * args.seconds / (args.kill + 1):
                spent += usage(node)[0]
                node.send_signal(signal.SIGKILL)
                node.wait()
                node, kills = start(), kills + 1
            if time.monotonic() - begun > args.seconds:
                break
        lap += 1
    time.sleep(2.0)
    processor, _ = usage(node)
    node.terminate()
    node.wait()
    with lock:
        times = sorted(received[key] - sent[key] for key in sent if key in received)
    log.seek(0)
    said = log.read().strip()
    print(said)
    print(f"sent {len(sent)} images in {args.seconds:.0f} s, received {len(times)} depths")
    at = lambda share: 1000 * times[min(int(share * len(times)), len(times) - 1)]
    if times:
        print(f"latency p50 {at(0.5):.0f} ms, p90 {at(0.9):.0f} ms, p99 {at(0.99):.0f} ms")
    print(f"processor {(processor + spent) / args.seconds:.2f} cores; memory {' '.join(f'{m:.0f}' for m in memory[:: max(1, len(memory) // 8)])} MB")
    counts = re.search(r"(\d+) received, (\d+) completed, (\d+) waiting", said.rsplit("node ", 1)[-1])
    seen, completed, waiting = map(int, counts.groups())
    left_out = sum(map(int, re.findall(r"^left out  (\d+)", said.rsplit("node ", 1)[-1], re.M)))
    assert seen == completed + waiting + left_out, "an image is not accounted for"
    assert args.kill or (seen == len(sent) and completed == len(times)), "messages were lost"
    assert times, "no depth was received"


if __name__ == "__main__":
    main()

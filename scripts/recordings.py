#!/usr/bin/env python3
"""Exchange of recordings with other programs, in both directions.

    pip install rosbags mcap mcap-ros2-support numpy opencv-python-headless pyrvl
    python3 scripts/recordings.py golden             writes tests/golden/recordings
    python3 scripts/recordings.py check [PROGRAM]    reads back what lsdc writes
    python3 scripts/recordings.py drive FRAMES OUT   makes a recording of rendered frames (docs/recordings.md)
    python3 scripts/recordings.py truth POINTS       compares points with the rendered depth: lines `stamp,u,v,depth`, as
                                                     printed by the example `points` of lsdc-recordings

`golden` writes `types`, a message of every type and encoding in every container; `drive`, a car with a camera and a scanner;
`turn`, a scanner that passes a wall while it turns; and `expected.json`, results of NumPy and OpenCV: colours, depths, and
projected points.
"""

import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pyrvl
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests/golden/recordings"
STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
START = 1_700_000_000_000_000_000


def header(stamp: int, frame: str):
    time = T["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return T["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def image(stamp: int, frame: str, encoding: str, pixels: np.ndarray, padding: int = 0):
    """An image whose rows end with padding."""
    rows = pixels.reshape(pixels.shape[0], -1).view(np.uint8)
    rows = np.hstack([rows, np.full((rows.shape[0], padding), 99, np.uint8)])
    return T["sensor_msgs/msg/Image"](
        header=header(stamp, frame),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(pixels.dtype.byteorder == ">"),
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def compressed(stamp: int, frame: str, form: str, data: bytes):
    message = T["sensor_msgs/msg/CompressedImage"]
    return message(header=header(stamp, frame), format=form, data=np.frombuffer(data, np.uint8))


def camera(stamp: int, frame: str, size, model: str, k, d):
    fx, fy, cx, cy = k
    return T["sensor_msgs/msg/CameraInfo"](
        header=header(stamp, frame),
        height=size[1],
        width=size[0],
        distortion_model=model,
        d=np.array(d, np.float64),
        k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], np.float64),
        r=np.eye(3).reshape(-1),
        p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0], np.float64),
        binning_x=0,
        binning_y=0,
        roi=T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def cloud(stamp: int, frame: str, points: np.ndarray, layout: np.dtype, big=False, rows=1, times=None):
    """Points in any layout; fields other than x, y, z and the last one (times) contain arbitrary numbers."""
    kinds = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}
    data = np.zeros(len(points), layout)
    if times is not None:
        data[layout.names[-1]] = times
    for axis, name in enumerate("xyz"):
        data[name] = points[:, axis]
    fields = [
        T["sensor_msgs/msg/PointField"](name=name, offset=offset, datatype=kinds[kind.str[1:]], count=1)
        for name, (kind, offset) in layout.fields.items()
    ]
    return T["sensor_msgs/msg/PointCloud2"](
        header=header(stamp, frame),
        height=rows,
        width=len(points) // rows,
        fields=fields,
        is_bigendian=big,
        point_step=layout.itemsize,
        row_step=layout.itemsize * (len(points) // rows),
        data=np.frombuffer(data.tobytes(), np.uint8),
        is_dense=False,
    )


def transform(stamp: int, parent: str, child: str, rotation, translation):
    """A transform; `rotation` is a rotation vector, whose length is the angle."""
    x, y, z = map(float, translation)
    angle = float(np.linalg.norm(rotation))
    axis = np.array(rotation, float) / max(angle, 1e-300)
    qx, qy, qz = (axis * np.sin(angle / 2)).tolist()
    move = T["geometry_msgs/msg/Transform"](
        translation=T["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
        rotation=T["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=float(np.cos(angle / 2))),
    )
    return T["geometry_msgs/msg/TransformStamped"](header=header(stamp, parent), child_frame_id=child, transform=move)


def transforms(*found):
    return T["tf2_msgs/msg/TFMessage"](transforms=list(found))


def matrix(rotation, translation) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = cv2.Rodrigues(np.array(rotation, float))[0]
    found[:3, 3] = translation
    return found


class Log(list):
    """Messages in recording order: topic, time in nanoseconds, type, bytes."""

    def add(self, topic: str, time: int, message, little: bool = True):
        kind = message.__msgtype__
        self.append((topic, time, kind, bytes(STORE.serialize_cdr(message, kind, little_endian=little))))

    def mcap(self, path: Path, compression, chunks: bool = True, index: bool = True, size: int = 1 << 14):
        kinds = IndexType.ALL if index else IndexType.NONE
        with open(path, "wb") as file:
            writer = Writer(file, chunk_size=size, compression=compression, use_chunking=chunks, index_types=kinds)
            writer.start(profile="ros2")
            schemas, channels = {}, {}
            for number, (topic, time, kind, data) in enumerate(self):
                if kind not in schemas:
                    text = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
                    schemas[kind] = writer.register_schema(kind, "ros2msg", text)
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "cdr", schemas[kind], {"offered_qos_profiles": ""})
                writer.add_message(channels[topic], time, data, time, number)
            writer.finish()

    def bag(self, folder: Path, plugin):
        with BagWriter(folder, version=9, storage_plugin=plugin) as bag:
            known = {}
            for topic, time, kind, data in self:
                if topic not in known:
                    known[topic] = bag.add_connection(topic, kind, typestore=STORE)
                bag.write(known[topic], time, data)


def compressed_depth(depth: np.ndarray, encoding: str, form: str = "png") -> bytes:
    """A message as written by compressed_depth_image_transport with its default parameters."""
    a, b, stored = 0.0, 0.0, depth
    if encoding == "32FC1":
        farthest, quantisation = 10.0, 100.0
        a = np.float32(quantisation * (quantisation + 1))
        b = np.float32(1 - a / farthest)
        seen = (depth > 0) & (depth < farthest)
        stored = np.zeros(depth.shape, np.uint16)
        stored[seen] = (a / depth[seen] + b).astype(np.uint16)
    if form == "png":
        data = cv2.imencode(".png", stored)[1].tobytes()
    else:
        # From the package of RVL's author, whose 16-bit sizes differ from those of the transport.
        rows, columns = stored.shape
        data = struct.pack("<II", columns, rows) + pyrvl.compress(stored)[4:]
    return struct.pack("<iff", 0, a, b) + data


def yuv(encoding: str, size: tuple[int, int], rng) -> tuple[np.ndarray, np.ndarray]:
    """Returns random bytes as an image of this encoding, and its colours. The rows of planes follow each other."""
    columns, rows = size
    if encoding in ("nv12", "nv21"):
        pixels = rng.integers(0, 256, (rows * 3 // 2, columns), np.uint8)
        return pixels, cv2.cvtColor(pixels, getattr(cv2, f"COLOR_YUV2RGB_{encoding.upper()}"))
    if encoding == "nv24":
        # OpenCV lacks this encoding: use an image of twice the width, in which each pair of pixels is one pixel.
        pixels = rng.integers(0, 256, (rows * 3, columns), np.uint8)
        y, uv = pixels[:rows], pixels[rows:].reshape(rows, columns, 2)
        pairs = np.stack([uv[..., 0], y, uv[..., 1], y], -1).reshape(rows, 2 * columns, 2)
        return pixels, cv2.cvtColor(pairs, cv2.COLOR_YUV2RGB_UYVY)[:, ::2]
    pixels = rng.integers(0, 256, (rows, columns, 2), np.uint8)
    code = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2"}[encoding]
    return pixels, cv2.cvtColor(pixels, getattr(cv2, f"COLOR_YUV2RGB_{code}"))


def types() -> tuple[Log, dict]:
    """Returns a message of every type and encoding, and their contents."""
    rng = np.random.default_rng(7)
    log, expected = Log(), {"colours": {}, "depths": {}, "clouds": {}, "cameras": {}}
    size = (14, 10)
    smooth = cv2.resize(rng.integers(0, 256, (4, 5, 3), np.uint8), size, interpolation=cv2.INTER_CUBIC)
    alpha = np.full((*smooth.shape[:2], 1), 7, np.uint8)
    grey = smooth[..., 1]
    encodings = {
        "rgb8": (smooth, smooth),
        "bgr8": (smooth[..., ::-1], smooth),
        "rgba8": (np.dstack([smooth, alpha]), smooth),
        "bgra8": (np.dstack([smooth[..., ::-1], alpha]), smooth),
        "mono8": (grey, np.dstack([grey] * 3)),
    }
    time = START
    # OpenCV names a mosaic by its second row and column.
    mosaics = {"rggb": "BayerBG", "bggr": "BayerRG", "gbrg": "BayerGR", "grbg": "BayerGB"}
    for name, other in mosaics.items():
        mosaic = np.empty(smooth.shape[:2], np.uint8)
        for place, color in enumerate(name):
            mosaic[place // 2 :: 2, place % 2 :: 2] = smooth[place // 2 :: 2, place % 2 :: 2, "rgb".index(color)]
        code = getattr(cv2, f"COLOR_{other}2RGB")
        encodings[f"bayer_{name}8"] = (mosaic, cv2.cvtColor(mosaic, code))
    for number, (encoding, (pixels, seen)) in enumerate(encodings.items()):
        log.add(f"/image/{encoding}", time, image(time, "eye", encoding, np.ascontiguousarray(pixels), number))
        expected["colours"][f"/image/{encoding}"] = seen.reshape(-1).tolist()
        time += 10**6
    colours = np.random.default_rng(8)
    for number, encoding in enumerate(("yuv422", "uyvy", "yuv422_yuy2", "yuyv", "nv12", "nv21", "nv24")):
        pixels, seen = yuv(encoding, size, colours)
        message = image(time, "eye", encoding, pixels, number if pixels.ndim == 3 else 0)
        message.height = size[1]
        log.add(f"/image/{encoding}", time, message)
        expected["colours"][f"/image/{encoding}"] = seen.reshape(-1).tolist()
        time += 10**6
    for form in ("jpeg", "png"):
        data = cv2.imencode(f".{form}", smooth[..., ::-1])[1].tobytes()
        log.add(f"/image/{form}", time, compressed(time, "eye", f"bgr8; {form} compressed bgr8", data))
        seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        expected["colours"][f"/image/{form}"] = seen.reshape(-1).tolist()
        time += 10**6
    metres = (1 + 6 * rng.random(smooth.shape[:2])).astype(np.float32)
    metres[2, 3:6] = [np.nan, 0, np.inf]
    whole = np.nan_to_num(np.round(metres * 1000), nan=0, posinf=0).astype(np.uint16)
    seen = np.where(np.isfinite(metres), metres, 0)
    depths = {
        "metres": (image(time, "eye", "32FC1", metres, 4), seen),
        "whole": (image(time, "eye", "16UC1", whole), whole / 1000),
        "big": (image(time, "eye", "16UC1", whole.astype(">u2")), whole / 1000),
    }
    for encoding, depth in (("16UC1", whole), ("32FC1", np.nan_to_num(metres, posinf=0))):
        _, a, b = struct.unpack("<iff", compressed_depth(depth, encoding)[:12])
        data = compressed_depth(depth, encoding)[12:]
        stored = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED).astype(np.float32)
        with np.errstate(divide="ignore"):
            back = stored / 1000 if encoding == "16UC1" else np.where(stored > 0, a / (stored - b), 0)
        for form, name in (("png", "compressed"), ("rvl", "rvl")):
            data = compressed_depth(depth, encoding, form)
            message = compressed(time, "eye", f"{encoding}; compressedDepth {form}", data)
            depths[f"{name}_{encoding}"] = (message, back)
    for name, (message, seen) in depths.items():
        log.add(f"/depth/{name}", time, message)
        expected["depths"][f"/depth/{name}"] = seen.reshape(-1).tolist()
    points = np.round(rng.normal(0, 3, (12, 3)), 3)
    points[5] = np.nan
    layouts = {
        "plain": (np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]), False, 1),
        "ouster": (
            np.dtype(
                {
                    "names": ["x", "y", "z", "intensity", "ring"],
                    "formats": ["<f4", "<f4", "<f4", "<f4", "<u2"],
                    "offsets": [0, 4, 8, 16, 26],
                    "itemsize": 32,
                }
            ),
            False,
            3,
        ),
        "doubles": (np.dtype([("ring", "<u1"), ("z", "<f8"), ("y", "<f8"), ("x", "<f8")]), False, 1),
        "big": (np.dtype([("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("pad", ">f4")]), True, 2),
    }
    for name, (layout, big, rows) in layouts.items():
        log.add(f"/points/{name}", time, cloud(time, "eye", points, layout, big, rows), little=not big)
        kept = points.astype(np.float64 if name == "doubles" else np.float32).astype(np.float64)
        expected["clouds"][f"/points/{name}"] = [None if np.isnan(p).any() else p.tolist() for p in kept]
    place = np.array([[0.4, -0.3, 2.0]])
    k = (12.0, 12.5, 6.4, 4.7)
    lenses = {
        "straight": ("plumb_bob", [0.0] * 5),
        "plumb_bob": ("plumb_bob", [-0.2, 0.05, 0.001, -0.002, 0.01]),
        "rational": ("rational_polynomial", [0.3, -0.1, 0.001, 0.002, 0.02, 0.4, -0.05, 0.01]),
        "equidistant": ("equidistant", [0.02, -0.01, 0.003, -0.001]),
    }
    for name, (model, d) in lenses.items():
        log.add(f"/cameras/{name}/camera_info", time, camera(time, "eye", size, model, k, d))
        intrinsic = np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1]])
        project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
        d = np.array(d, float)
        if model == "equidistant":
            seen = project(place[None], np.zeros(3), np.zeros(3), intrinsic, d)[0]
        else:
            seen = project(place, np.zeros(3), np.zeros(3), intrinsic, d)[0]
        expected["cameras"][f"/cameras/{name}/camera_info"] = [place[0].tolist(), seen.reshape(-1).tolist()]
    # A second camera beside the first, which measures depths.
    far = (2 + np.add.outer(0.05 * np.arange(size[1]), 0.02 * np.arange(size[0]))).astype(np.float32)
    beside = ([0.0, 0.05, 0.0], [0.1, 0.0, 0.05])
    log.add("/other/depth", time, image(time, "other", "32FC1", far))
    log.add("/other/camera_info", time, camera(time, "other", size, "plumb_bob", k, [0.0] * 5))
    log.add("/tf_static", time, transforms(transform(time, "eye", "other", *beside)))
    v, u = np.indices(far.shape).reshape(2, -1)
    far = far.reshape(-1).astype(float)
    places = np.column_stack([(u - k[2]) / k[0] * far, (v - k[3]) / k[1] * far, far, np.ones(len(far))])
    places = (matrix(*beside) @ places.T).T[:, :3]
    seen = np.column_stack([places[:, :2] / places[:, 2:] * k[:2] + k[2:], places[:, 2]])
    inside = (seen[:, :2] > -0.5).all(1) & (seen[:, :2] < np.array(size) - 0.5).all(1)
    expected["beside"] = np.round(seen[inside], 6).tolist()
    text = T["std_msgs/msg/String"](data="other types are counted")
    log.add("/notes", time, text)
    return log, expected


# Poses of the sensors on the car. In ROS, a car looks along x, with y to the left; a camera looks along z.
LIDAR = ([0.0, 0.0, 0.3], [0.5, 0.0, 1.6])
CAMERA = ([-1.2091996, 1.2091996, -1.2091996], [0.8, 0.1, 1.4])


def car(seconds: float):
    """Returns the pose of the car in odom: it drives 8 m/s and turns. Between TF samples, every 50 ms, it goes straight."""
    before = np.floor(seconds / 0.05 + 1e-9) * 0.05
    share = (seconds - before) / 0.05

    def sample(t):
        return np.array([0, 0, 0.4 * t + 0.3 * t * t]), np.array([8 * t, 2 * t * t, 0])

    (a, b), (c, d) = sample(before), sample(before + 0.05)
    # About one axis, the shortest rotation at an even speed is that of the angle.
    return a + (c - a) * share, b + (d - b) * share


def drive() -> tuple[Log, dict]:
    """Records a car that passes a wall, with a frame without transforms, and one without points."""
    size, k, d = (96, 72), (80.0, 80.0, 47.5, 35.5), [-0.1, 0.02, 0.001, -0.0005, 0.0]
    room = cv2.resize(cv2.imread(str(ROOT / "assets/room/rgb.png")), size, interpolation=cv2.INTER_AREA)
    rng = np.random.default_rng(3)
    # A wall with bumps ahead of the car, in odom.
    y, z = rng.uniform(-8, 8, 320), rng.uniform(-2, 5, 320)
    wall = np.column_stack([16 + 0.3 * np.sin(y), y, z, np.ones(len(y))])
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    events = []
    lidar, eye = matrix(*LIDAR), matrix(*CAMERA)
    static = transforms(transform(START, "base_link", "lidar", *LIDAR), transform(START, "base_link", "camera", *CAMERA))
    events.append((0.0, "/tf_static", static))
    for step in range(1, 13):
        seconds = 0.05 * step
        stamp = START + step * 50_000_000
        events.append((seconds + 0.004, "/tf", transforms(transform(stamp, "odom", "base_link", *car(seconds)))))
    clouds = {}
    for turn in (0, 1, 2, 4, 5):
        seconds = 0.1 * turn + 0.02
        points = (np.linalg.inv(matrix(*car(seconds)) @ lidar) @ wall.T).T[:, :3].astype(np.float32)
        clouds[seconds] = points.astype(np.float64)
        events.append((seconds + 0.06, "/lidar/points", cloud(START + round(seconds * 1e9), "lidar", points, layout)))
    expected = {"frames": [], "dropped": []}
    intrinsic = np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1]])
    for shot in range(6):
        seconds = 0.1 * shot
        stamp = START + shot * 100_000_000
        shown = np.roll(room, 2 * shot, axis=1)
        data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
        events.append((seconds + 0.03, "/camera/image_raw/compressed", compressed(stamp, "camera", "bgr8; jpeg", data)))
        events.append((seconds + 0.03, "/camera/camera_info", camera(stamp, "camera", size, "plumb_bob", k, d)))
        nearest = min(clouds, key=lambda time: abs(time - seconds))
        if shot == 0 or abs(nearest - seconds) > 0.05:
            expected["dropped"].append(stamp)
            continue
        seen = np.column_stack([clouds[nearest], np.ones(len(wall))])
        moved = np.linalg.inv(matrix(*car(seconds)) @ eye) @ matrix(*car(nearest)) @ lidar
        places = (moved @ seen.T).T[:, :3]
        places = places[places[:, 2] > 0.1]
        pixels = cv2.projectPoints(places, np.zeros(3), np.zeros(3), intrinsic, np.array(d))[0].reshape(-1, 2)
        inside = (pixels > -0.49).all(1) & (pixels < np.array(size) - 0.51).all(1)
        found = np.column_stack([pixels, places[:, 2]])[inside]
        expected["frames"].append({"stamp": stamp, "points": np.round(found, 4).tolist()})
    log = Log()
    for seconds, topic, message in sorted(events, key=lambda event: event[0]):
        log.add(topic, START + round(seconds * 1e9), message)
    return log, expected


def turn() -> tuple[Log, dict]:
    """Records a car whose scanner sweeps over a wall while it drives and turns, twice, the second time after the last
    transform. The times of points have the formats of several drivers. The wall is intersected in closed form."""
    size, k = (48, 36), (40.0, 40.0, 23.5, 17.5)
    lidar, eye = matrix(*LIDAR), matrix(*CAMERA)
    normal, offset = np.array([0.96, 0.28, 0.0]), 14.0
    log, expected = Log(), {"frames": []}
    fixed = transforms(transform(START, "base_link", "lidar", *LIDAR), transform(START, "base_link", "camera", *CAMERA))
    log.add("/tf_static", START, fixed)
    for step in range(13):
        stamp = START + step * 50_000_000
        log.add("/tf", stamp, transforms(transform(stamp, "odom", "base_link", *car(0.05 * step))))
    grey = np.full((size[1], size[0]), 90, np.uint8)
    grey[:, ::2] = 140
    nanoseconds = np.arange(80) * 1_000_000
    elevations = np.radians(np.linspace(-18, 18, 6))
    for begin, shot in ((0.28, 0.32), (0.56, 0.58)):
        start, stamp = START + round(begin * 1e9), START + round(shot * 1e9)
        log.add("/camera/image_raw", stamp, image(stamp, "camera", "mono8", grey))
        log.add("/camera/camera_info", stamp, camera(stamp, "camera", size, "plumb_bob", k, [0.0] * 5))
        points = []
        for past in nanoseconds:
            pose = matrix(*car(begin + past * 1e-9)) @ lidar
            # The scanner is rotated relative to the car; it sweeps from right to left.
            azimuth = np.radians(-28 + 56 * past / nanoseconds[-1]) - LIDAR[0][2]
            level = np.cos(elevations)
            rays = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevations)])
            far = (offset - normal @ pose[:3, 3]) / (rays @ pose[:3, :3].T @ normal)
            points.append(rays * far[:, None])
        points, times = np.concatenate(points), np.repeat(nanoseconds, len(elevations))
        last = int(nanoseconds[-1])
        drivers = {
            "ouster": (start, "t", "<u4", times),
            "velodyne": (start + last, "time", "<f4", (times - last) * 1e-9),
            "hesai": (start, "timestamp", "<f8", (start + times) * 1e-9),
            "livox": (start, "timestamp", "<f8", (start + times).astype(float)),
        }
        for name, (time, field, kind, values) in drivers.items():
            layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), (field, kind)])
            log.add(f"/{name}/points", time, cloud(time, "lidar", points, layout, times=values))
        pose = matrix(*car(shot)) @ eye
        plane = [*(normal @ pose[:3, :3]), offset - normal @ pose[:3, 3]]
        expected["frames"].append({"stamp": stamp, "plane": plane})
    log.sort(key=lambda message: message[1])
    return log, expected


def golden() -> None:
    GOLDEN.mkdir(parents=True, exist_ok=True)
    log, kinds = types()
    log.mcap(GOLDEN / "zstd.mcap", CompressionType.ZSTD, size=1 << 12)
    log.mcap(GOLDEN / "alone.mcap", CompressionType.NONE, chunks=False, index=False)
    with tempfile.TemporaryDirectory() as folder:
        log.bag(Path(folder) / "bag", StoragePlugin.SQLITE3)
        (GOLDEN / "bag").mkdir(exist_ok=True)
        for file in (Path(folder) / "bag").iterdir():
            (GOLDEN / "bag" / file.name).write_bytes(file.read_bytes())
    log, frames = drive()
    log.mcap(GOLDEN / "drive.mcap", CompressionType.LZ4)
    log, wall = turn()
    log.mcap(GOLDEN / "turn.mcap", CompressionType.ZSTD)
    (GOLDEN / "expected.json").write_text(json.dumps({**kinds, **frames, "turn": wall}, separators=(",", ":")) + "\n")
    total = sum(file.stat().st_size for file in GOLDEN.rglob("*") if file.is_file())
    print(f"{total} bytes in {GOLDEN}")


def check(program: str) -> None:
    """Checks that depths in a recording equal those in files, with the stamps and frames of the images."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        source = str(GOLDEN / "drive.mcap")
        for output in (["files", "--formats", "npy"], ["out.mcap", "--copy", "--cloud"], ["mm.mcap", "--units", "mm"]):
            subprocess.run([program, "complete", source, "-o", *output], cwd=folder, check=True)
        expected = {int(file.name.split("_")[0]): np.load(file) for file in (folder / "files").glob("*.npy")}
        seen = 0
        with open(folder / "out.mcap", "rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, message, decoded in reader.iter_decoded_messages():
                if not channel.topic.startswith("/lsdc/"):
                    continue
                stamp = decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec
                assert decoded.header.frame_id == "camera" and message.log_time == stamp + 30_000_000
                depth = expected[stamp]
                if channel.topic == "/lsdc/depth":
                    found = np.frombuffer(decoded.data, np.float32).reshape(decoded.height, decoded.width)
                    assert (found == depth).all()
                else:
                    points = np.frombuffer(decoded.data, np.float32).reshape(-1, 4)
                    assert np.allclose(points[:, 2], depth[depth > 0])
                seen += 1
        assert seen == 2 * len(expected) == 8
        # Read by another library, with its own definitions of the types.
        with make_any(folder / "mm.mcap") as reader:
            for connection, _, data in reader.messages():
                message = STORE.deserialize_cdr(data, connection.msgtype)
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                found = message.data.view(np.uint16).reshape(message.height, message.width)
                assert np.abs(found / 1000 - expected[stamp]).max() < 0.0005001
    print("all are the same")


def make_any(path: Path):
    from rosbags.highlevel import AnyReader

    return AnyReader([path], default_typestore=STORE)


# A room with boxes, in metres: corners and colour of each.
SIZE, FOCAL, MIDDLE = (640, 480), 525.0, (319.5, 239.5)
ROOM = np.array([[-6, -5, 0], [6, 5, 3]], float)
BOXES = np.array(
    [
        [[-3, 1, 0], [-2, 2.5, 1.2]],
        [[1, 2, 0], [2.5, 3, 0.8]],
        [[3, -3, 0], [4, -1, 2.2]],
        [[-1, -4, 0], [0.5, -3, 1.5]],
        [[-5, -2, 0], [-4.2, 0, 2.0]],
        [[4.5, 1, 0], [5.5, 4, 0.75]],
        [[-0.4, 3.8, 0], [0.4, 4.6, 1.9]],
    ],
    float,
)


def cast(origins: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the distance along each ray, and the object that it hits: 0 for the room, otherwise the number of a box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (ROOM[:, None] - origins) / rays
        far, hit = np.nanmin(sides.max(0), axis=-1), np.zeros(len(rays), int)
        for number, box in enumerate(BOXES, 1):
            sides = (box[:, None] - origins) / rays
            near, last = sides.min(0).max(-1), sides.max(0).min(-1)
            nearer = (near > 0) & (near < last) & (near < far)
            far, hit = np.where(nearer, near, far), np.where(nearer, number, hit)
    return far, hit


def walk(seconds: float) -> np.ndarray:
    """Returns the pose of a robot that walks in a circle through the room, looking ahead and slightly around."""
    angle = 0.15 * seconds
    heading = angle + np.pi / 2 + 0.4 * np.sin(0.7 * seconds)
    return matrix([0, 0, heading], [2.6 * np.cos(angle), 0.3 + 1.6 * np.sin(angle), 0.5])


SCANNER = ([0.0, 0.0, 0.0], [0.1, 0.0, 0.4])
EYE = (CAMERA[0], [0.15, 0.0, 0.3])


def spinning(seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scans one turn of 16 lasers, starting at a time, while the scanner moves: returns points in its frame at the time of
    each, these times in nanoseconds, and the points in the room."""
    turns = np.arange(900)
    elevations = np.radians(np.linspace(-15, 15, 16))
    points, room = [], []
    for turn in turns:
        pose = walk(seconds + 0.1 * turn / len(turns)) @ matrix(*SCANNER)
        # It looks ahead in the middle of the turn.
        azimuth = 2 * np.pi * (turn / len(turns) - 0.5)
        level = np.cos(elevations)
        rays = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevations)])
        far, _ = cast(pose[:3, 3], rays @ pose[:3, :3].T)
        points.append(rays * far[:, None])
        room.append(points[-1] @ pose[:3, :3].T + pose[:3, 3])
    times = np.repeat(np.round(1e8 * turns / len(turns)).astype(np.uint32), len(elevations))
    return np.concatenate(points), times, np.concatenate(room)


def rendered(pose: np.ndarray) -> np.ndarray:
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = np.stack([(u - MIDDLE[0]) / FOCAL, (v - MIDDLE[1]) / FOCAL, np.ones(u.shape)], -1).reshape(-1, 3)
    rays = rays @ pose[:3, :3].T
    far, hit = cast(pose[:3, 3], rays)
    places = pose[:3, 3] + rays * far[:, None]
    pattern = np.sin(7 * places).sum(1) + 0.5 * np.sin(23 * places + hit[:, None]).sum(1)
    base = np.array([[150, 140, 120], [170, 60, 50], [60, 120, 160], [90, 150, 70]])[hit % 4]
    shaded = base * (1 + 0.12 * pattern[:, None]) / (1 + 0.04 * far[:, None])
    return np.clip(shaded, 0, 255).astype(np.uint8).reshape(SIZE[1], SIZE[0], 3)


def room_drive(frames: int, output: Path) -> None:
    """Records ten images and turns of the scanner per second, which begin 30 ms before the images; writes the same frames as
    files, without hidden points."""
    (output / "images").mkdir(parents=True)
    (output / "points").mkdir()
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
    log = Log()
    fixed = [transform(START, "base_link", "lidar", *SCANNER), transform(START, "base_link", "camera", *EYE)]
    log.add("/tf_static", START, transforms(*fixed))
    for step in range(5 * frames + 10):
        seconds = 0.02 * step - 0.1
        stamp, pose = START + round(seconds * 1e9), walk(seconds)
        turned = cv2.Rodrigues(pose[:3, :3])[0].reshape(-1)
        log.add("/tf", stamp, transforms(transform(stamp, "odom", "base_link", turned, pose[:3, 3])))
        if step < 5 or step % 5 or step // 5 > frames:
            continue
        shot = pose @ matrix(*EYE)
        shown, (points, times, room) = rendered(shot), spinning(seconds - 0.03)
        log.add("/camera/image_raw", stamp, image(stamp, "camera", "rgb8", shown))
        info = camera(stamp, "camera", SIZE, "plumb_bob", (FOCAL, FOCAL, *MIDDLE), [0.0] * 5)
        log.add("/camera/camera_info", stamp, info)
        log.add("/lidar/points", stamp + 70_000_000, cloud(stamp - 30_000_000, "lidar", points, layout, times=times))
        places = (room - shot[:3, 3]) @ shot[:3, :3]
        places = places[places[:, 2] > 0]
        seen = np.column_stack([FOCAL * places[:, :2] / places[:, 2:] + MIDDLE, places[:, 2]])
        inside = (seen[:, :2] > -0.5).all(1) & (seen[:, :2] < np.array(SIZE) - 0.5).all(1)
        cv2.imwrite(str(output / f"images/{stamp}.png"), shown[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
        np.save(output / f"points/{stamp}.npy", seen[inside])
    log.sort(key=lambda message: message[1])
    log.mcap(output / "drive.mcap", CompressionType.LZ4, size=4 << 20)


def truth(path: Path) -> None:
    """Compares the depths of points with those that the camera of `drive` sees at their positions."""
    rows = np.loadtxt(path, delimiter=",", dtype=np.float64, converters={0: lambda text: int(text) - START})
    off = []
    for stamp in np.unique(rows[:, 0]):
        u, v, depth = rows[rows[:, 0] == stamp, 1:].T
        pose = walk(stamp * 1e-9) @ matrix(*EYE)
        rays = np.column_stack([(u - MIDDLE[0]) / FOCAL, (v - MIDDLE[1]) / FOCAL, np.ones(len(u))]) @ pose[:3, :3].T
        off.append(depth - cast(pose[:3, 3], rays)[0])
    off = np.abs(np.concatenate(off))
    rms = np.sqrt((off**2).mean())
    print(f"{len(off)} points: {rms:.4f} m rms, median {np.median(off):.4f} m, {(off > 0.05).mean():.2%} off by 5 cm")


if __name__ == "__main__":
    if sys.argv[1:2] == ["golden"]:
        golden()
    elif sys.argv[1:2] == ["check"]:
        check(str(Path(sys.argv[2] if len(sys.argv) > 2 else ROOT / "target/release/lsdc").resolve()))
    elif sys.argv[1:2] == ["drive"] and len(sys.argv) == 4:
        room_drive(int(sys.argv[2]), Path(sys.argv[3]))
    elif sys.argv[1:2] == ["truth"] and len(sys.argv) == 3:
        truth(Path(sys.argv[2]))
    else:
        sys.exit(__doc__)

"""Compares the node `register` of depth_image_proc with lsdc on the drive of `scripts/recordings.py`.

    pip install rosbags mcap mcap-ros2-support numpy opencv-python-headless pyrvl
    python scripts/recordings.py drive 60 /tmp/drive
    lsdc complete /tmp/drive/drive.mcap -o /tmp/drive/dense.mcap       # the depths of `lsdc node`, bit for bit
    python scripts/peers/register.py /tmp/drive/drive.mcap /tmp/drive/dense.mcap

The node itself cannot be run without ROS, so its arithmetic is repeated here: every point is transformed at the time of the
image, projected, rounded to the nearest pixel, and the nearest depth of a pixel is kept; nothing is filled. It gets the points
of a cloud instead of a depth image, and does not compensate motion within a turn.
"""

import sys
import time
from pathlib import Path

import numpy as np
from mcap_ros2.reader import read_ros2_messages

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from recordings import EYE, FOCAL, MIDDLE, SCANNER, SIZE, START, cast, matrix, walk  # noqa: E402


def nanoseconds(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def true_depth(pose):
    """Returns the true depth of every pixel."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = np.stack([(u - MIDDLE[0]) / FOCAL, (v - MIDDLE[1]) / FOCAL, np.ones(u.shape)], -1).reshape(-1, 3)
    return cast(pose[:3, 3], rays @ pose[:3, :3].T)[0].reshape(SIZE[1], SIZE[0])


def registered(points, motion):
    """Returns the depths of `register`; 0 at pixels without a point."""
    places = points @ motion[:3, :3].T + motion[:3, 3]
    places = places[places[:, 2] > 0]
    pixels = (FOCAL * places[:, :2] / places[:, 2:] + MIDDLE + 0.5).astype(int)
    inside = ((pixels >= 0) & (pixels < SIZE)).all(1)
    (u, v), depth = pixels[inside].T, places[inside, 2]
    nearest = np.full((SIZE[1], SIZE[0]), np.inf)
    np.minimum.at(nearest, (v, u), depth)
    return np.where(np.isfinite(nearest), nearest, 0)


def is_flat(truth):
    """Selects pixels whose 24 neighbours are within 10 cm: at others, a point beside the centre may have another depth."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(truth, 2, mode="edge"), (5, 5))
    return windows.max((2, 3)) - windows.min((2, 3)) < 0.1


def line(name, found, pixels):
    errors, flat = (np.concatenate(part) for part in zip(*found))
    rms = lambda values: np.sqrt((values**2).mean())
    print(
        f"{name:20} coverage {len(errors) / pixels:7.2%}   rms {rms(errors):.3f} m   median {np.median(errors):.4f} m   "
        f"off by 10 cm {(errors > 0.1).mean():.1%}   away from edges: rms {rms(errors[flat]):.3f} m   "
        f"off by 10 cm {(errors[flat] > 0.1).mean():.1%}"
    )


def main():
    drive, dense = sys.argv[1:3]
    clouds = {}
    for message in read_ros2_messages(drive, topics=["/lidar/points"]):
        cloud = message.ros_msg
        data = np.frombuffer(bytes(cloud.data), np.uint8).reshape(-1, cloud.point_step)
        clouds[nanoseconds(cloud)] = data[:, :12].copy().view("<f4").astype(np.float64)
    errors = {name: [] for name in ("register", "lsdc", "lsdc, same pixels")}
    pixels, spent = 0, 0.0
    for number, message in enumerate(read_ros2_messages(dense, topics=["/lsdc/depth"])):
        if number % 5:
            continue
        found = message.ros_msg
        stamp = nanoseconds(found)
        measured = min(clouds, key=lambda other: abs(other - stamp))
        seconds, before = (stamp - START) * 1e-9, (measured - START) * 1e-9
        truth = true_depth(walk(seconds) @ matrix(*EYE))
        begun = time.process_time()
        motion = np.linalg.inv(walk(seconds) @ matrix(*EYE)) @ walk(before) @ matrix(*SCANNER)
        sparse = registered(clouds[measured], motion)
        spent += time.process_time() - begun
        depth = np.frombuffer(bytes(found.data), "<f4").reshape(SIZE[1], SIZE[0])
        pixels += truth.size
        has = sparse > 0
        flat = is_flat(truth)
        for name, depths, where in [
            ("register", sparse, has),
            ("lsdc", depth, depth > 0),
            ("lsdc, same pixels", depth, has & (depth > 0)),
        ]:
            errors[name].append((np.abs(depths - truth)[where], flat[where]))
    for name, found in errors.items():
        line(name, found, pixels)
    print(f"register: {1000 * spent * SIZE[0] * SIZE[1] / pixels:.1f} ms of processor time an image, in NumPy")


if __name__ == "__main__":
    main()

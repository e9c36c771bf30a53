"""Opens a recording of lsdc in Rerun's SDK, and compares the decoded data with the messages.

    pip install rerun-sdk mcap-ros2-support
    lsdc complete drive.mcap --cloud --copy -o dense.mcap
    python scripts/peers/rerun_mcap.py dense.mcap

Depths must become depth images with the same bytes, clouds points at the same positions, cameras pinholes, and transforms
transforms. Rerun's viewer is not checked.
"""

import sys
from collections import defaultdict

import numpy as np
from mcap_ros2.reader import read_ros2_messages
from rerun.chunk import McapReader

# Rerun's archetype column for each type.
MADE = {
    "Image": "DepthImage:buffer",
    "PointCloud2": "Points3D:positions",
    "CameraInfo": "Pinhole:image_from_camera",
    "CompressedImage": "EncodedImage:blob",
    "TFMessage": "Transform3D:translation",
}


def main():
    path = sys.argv[1]
    found = defaultdict(list)
    for chunk in McapReader(path).stream():
        batch = chunk.to_record_batch()
        for name in set(batch.schema.names) & set(MADE.values()):
            column = batch.column(batch.schema.get_field_index(name))
            found[chunk.entity_path, name] += [row for row in column if row.is_valid]
    messages = defaultdict(list)
    for message in read_ros2_messages(path):
        messages[message.channel.topic, message.schema.name.rsplit("/")[-1]].append(message.ros_msg)
    for (topic, kind), sent in messages.items():
        rows = found[topic, MADE[kind]]
        if kind == "TFMessage":
            assert len(rows) == sum(len(message.transforms) for message in sent), topic
        else:
            assert len(rows) == len(sent), f"{topic}: {len(rows)} of {len(sent)}"
        for row, message in zip(rows, sent):
            if kind == "Image":
                assert message.encoding == "32FC1", message.encoding
                buffer = row.values.flatten().to_numpy(zero_copy_only=False)
                assert bytes(buffer.astype(np.uint8)) == bytes(message.data), topic
            if kind == "PointCloud2":
                data = np.frombuffer(bytes(message.data), np.uint8).reshape(-1, message.point_step)
                offset = {field.name: field.offset for field in message.fields}
                xyz = [data[:, offset[axis] : offset[axis] + 4].copy().view("<f4")[:, 0] for axis in "xyz"]
                positions = row.values.flatten().to_numpy(zero_copy_only=False).reshape(-1, 3)
                assert np.array_equal(positions, np.stack(xyz, 1), equal_nan=True), topic
        print(f"{topic}: {len(rows)} {MADE[kind].split(':')[0]}")


if __name__ == "__main__":
    main()

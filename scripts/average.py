#!/usr/bin/env python3
"""Averages the tensors of two weights files of one network: runs that one set off from the other, for example.

    python3 scripts/average.py FIRST SECOND [--share 0.5] -o AVERAGE.safetensors

The share is that of the second, whose settings are kept. A prior is one of the functions that it was learned for:
`lsdc calibrate --weights AVERAGE.safetensors` must learn another. Needs numpy.
"""

import argparse
import json
import struct
from pathlib import Path

import numpy as np

TYPES = {"F16": np.float16, "F32": np.float32}


def read(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """The metadata and the tensors of a file."""
    data = path.read_bytes()
    start = 8 + struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8:start])
    notes = header.pop("__metadata__", {})
    tensors = {}
    for name, about in header.items():
        first, last = (start + offset for offset in about["data_offsets"])
        values = np.frombuffer(data[first:last], TYPES[about["dtype"]])
        tensors[name] = values.astype(np.float32).reshape(about["shape"])
    return notes, tensors


def write(path: Path, notes: dict, tensors: dict[str, np.ndarray]) -> None:
    header, at = {"__metadata__": notes}, 0
    for name, values in sorted(tensors.items()):
        size = values.nbytes
        header[name] = {"dtype": "F32", "shape": list(values.shape), "data_offsets": [at, at + size]}
        at += size
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    values = b"".join(tensors[name].astype("<f4").tobytes() for name in sorted(tensors))
    path.write_bytes(struct.pack("<Q", len(text)) + text + values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("--share", type=float, default=0.5)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    (_, first), (notes, second) = read(args.first), read(args.second)
    if {n: t.shape for n, t in first.items()} != {n: t.shape for n, t in second.items()}:
        parser.error("the tensors of both files must have the same names and shapes")
    mean = {n: (1.0 - args.share) * first[n] + args.share * second[n] for n in second}
    write(args.output, notes, mean)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Averages the tensors of two weights files of one network, such as a run and the run from which it started.

    python3 scripts/average.py FIRST SECOND [--share 0.5] [--only PREFIX] -o AVERAGE.safetensors

SHARE is the weight of SECOND, whose settings are kept. With --only, settings and all tensors whose names do not begin with
PREFIX come from FIRST, and only tensors with PREFIX must be in both: `--only edges --share 1` takes the affinities of
SECOND. A prior is valid only for the functions for which it was learned: learn another one with
`lsdc calibrate --weights AVERAGE.safetensors`. The average records the history of both (`lsdc weights info`). Needs numpy.
"""

import argparse
import json
import os
import struct
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

TYPES = {"F16": np.float16, "F32": np.float32}

PRIOR = "table.prior."


def read(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Returns the metadata and the tensors of a file."""
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


def contents(path: Path) -> str:
    """Returns lsdc's hash of the bytes of a file: 64-bit FNV-1a, with a separator at the end."""
    state = 0xCBF29CE484222325
    for byte in path.read_bytes() + b"\xff":
        state = (state ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
    return f"{state:016x}"


def made(files: list[tuple[Path, dict]], share: float, only: str) -> dict:
    """Returns the history entry, as lsdc records it."""
    first, second = (json.loads(notes.get("history", "[]")) for _, notes in files)
    # Common entries are recorded once.
    histories = [first, [entry for entry in second if entry not in first]]
    return {
        "by": "scripts/average.py",
        "program": {},
        "of": [
            {
                "role": f"averaged, share {part:g}" + (f" of `{only}`" if only else ""),
                "weights": str(path),
                "contents": contents(path),
                "history": history,
            }
            for (path, _), part, history in zip(files, [1.0 - share, share], histories)
        ],
        "settings": {"share": share} | ({"only": only} if only else {}),
        "ended": datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
    }


def write(path: Path, notes: dict, tensors: dict[str, np.ndarray]) -> None:
    header, at = {"__metadata__": notes}, 0
    for name, values in sorted(tensors.items()):
        size = values.nbytes
        header[name] = {"dtype": "F32", "shape": list(values.shape), "data_offsets": [at, at + size]}
        at += size
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    values = b"".join(tensors[name].astype("<f4").tobytes() for name in sorted(tensors))
    # Replace the file atomically.
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(struct.pack("<Q", len(text)) + text + values)
    os.replace(part, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("--share", type=float, default=0.5)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", metavar="PREFIX", default="")
    args = parser.parse_args()
    (old, first), (notes, second) = read(args.first), read(args.second)
    kept, lent = (args.first, args.second) if args.only else (args.second, args.first)
    # The mean has the settings of one file; `lsdc calibrate` learns a new prior.
    ours, others = (first, second) if args.only else (second, first)
    for name in [n for n in others if n.startswith(PRIOR) and n not in ours]:
        print(f"left out: {name} of {lent}, which {kept} does not have; calibrate the mean")
        del others[name]
    shapes = [{n: t.shape for n, t in f.items() if n.startswith(args.only)} for f in [first, second]]
    if shapes[0] != shapes[1]:
        parser.error("the tensors of both files must have the same names and shapes")
    if not shapes[0]:
        parser.error(f"no tensor begins with `{args.only}`")
    mean = {n: (1.0 - args.share) * first[n] + args.share * second[n] for n in shapes[0]}
    record = made([(args.first, old), (args.second, notes)], args.share, args.only)
    write(args.output, {**(old if args.only else notes), "history": json.dumps([record])}, {**ours, **mean})


if __name__ == "__main__":
    main()

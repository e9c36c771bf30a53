"""Compares two depth maps (.npy, float32): `near.py FOUND OTHER TOLERANCE` fails if they differ by more than the tolerance,
relative to the range of the other's depths. Needs no NumPy."""
import array
import sys


def depths(path):
    data = open(path, "rb").read()
    return array.array("f", data[10 + int.from_bytes(data[8:10], "little"):])


found, other, tolerance = depths(sys.argv[1]), depths(sys.argv[2]), float(sys.argv[3])
apart = max(abs(a - b) for a, b in zip(found, other, strict=True)) / (max(other) - min(other))
same = sum(a == b for a, b in zip(found, other)) / len(other)
print(f"{apart:.2g} of the range of depths apart at most, {100 * same:.0f} % the same bits")
sys.exit(not apart <= tolerance)

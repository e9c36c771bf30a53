"""Depth as a picture, for notebooks."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

# The turbo colour map (Mikhailov 2019), as approximated by d3: coefficients of polynomials for red, green and blue,
# highest power first.
TURBO = (
    (14825.05, -38394.49, 33300.12, -10793.56, 1172.33, 34.61),
    (707.56, 1073.77, -3574.96, 1225.33, 557.33, 23.31),
    (6838.66, -22569.18, 27814.0, -15327.97, 3211.1, 27.2),
)


def coloured(depth: NDArray[np.float32], low: float, high: float) -> NDArray[np.uint8]:
    """Returns colours `(H, W, 3)` from blue at `low` to red at `high`; black at pixels without depth."""
    share = np.clip((depth - low) / max(high - low, 1e-12), 0.0, 1.0)
    colours = np.stack([np.polyval(channel, share) for channel in TURBO], axis=-1)
    colours[~(depth > 0)] = 0.0
    levels: NDArray[np.uint8] = np.clip(colours, 0, 255).astype(np.uint8)
    return levels


def png(colours: NDArray[np.uint8]) -> bytes:
    """Encodes colours `(H, W, 3)` as a PNG file."""

    def chunk(name: bytes, data: bytes) -> bytes:
        checked = name + data
        return struct.pack(">I", len(data)) + checked + struct.pack(">I", zlib.crc32(checked))

    height, width, _ = colours.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    # Every row begins with its filter type: none.
    rows = np.pad(colours.reshape(height, -1), ((0, 0), (1, 0)))
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body

"""Frames, from files to rows of results."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from .._completer import Completer
from .._errors import Error, InputError, ReadError
from .._input import Array, ImageLike
from ._options import Options, as_text

SCHEMA = pa.schema(
    [
        ("key", pa.string()),
        ("error", pa.string()),
        ("width", pa.int32()),
        ("height", pa.int32()),
        ("encoding", pa.string()),
        ("step", pa.float64()),
        ("depth", pa.binary()),
        ("standard_deviation", pa.binary()),
        ("clipped", pa.int32()),
        ("report", pa.string()),
    ]
)
"""The columns of results. Where `error` is given, a frame has nothing else."""

# Times differ between runs, and are not stored.
TIMES = ("network", "fit", "field", "solve")

TYPES = {"f16": "<f2", "u16": "<u2", "f32": "<f4"}
# The smallest and largest stored values.
LIMITS = {"f16": (2.0**-24, 65504.0), "u16": (1.0, 65535.0)}


@dataclass(frozen=True)
class Inputs:
    """Inputs of the completion of a frame."""

    image: ImageLike
    sparse: Array
    sigma: Array | None = None
    guide: Array | None = None
    left_out: Mapping[str, int] | None = None
    """Numbers of points that the source left out, by reason."""


@dataclass(frozen=True)
class Frame:
    """A fetched frame; `decode` fails if its data is missing or damaged."""

    key: str
    decode: Callable[[], Inputs]


def completed(frame: Frame, completer: Completer, options: Options) -> dict[str, Any]:
    """Returns the row of a frame with its depth, or with the reason of a failure."""
    try:
        result = _result(frame.decode(), completer, options)
        return {"key": frame.key, "error": None, **result}
    # Image decoders may raise any exception, which must not end a run over millions of frames.
    except Exception as error:
        hint = error.hint if isinstance(error, Error) else None
        message = str(error) if isinstance(error, Error) else f"{type(error).__name__}: {error}"
        return failed(frame.key, message if hint is None else f"{message} ({hint})")


def failed(key: str, error: str) -> dict[str, Any]:
    """Returns the row of a failed frame."""
    return {**dict.fromkeys(SCHEMA.names), "key": key, "error": error}


def _result(inputs: Inputs, completer: Completer, options: Options) -> dict[str, Any]:
    sigma = options.sigma if inputs.sigma is None else inputs.sigma
    completion = completer.complete(
        inputs.image,
        inputs.sparse,
        sigma=sigma,
        unit=options.unit,
        guide=inputs.guide,
        size=options.size,
        order=options.order,
    )
    depth, clipped = encoded(completion.depth, options.encoding, options.step)
    deviation = None
    if options.standard_deviation:
        # Always floats: steps of a unit would be too coarse for small deviations.
        form = "f32" if options.encoding == "f32" else "f16"
        deviation, _ = encoded(completion.standard_deviation, form, 1.0)
    width, height = completion.size
    report = {name: _finite(value) for name, value in completion.report.items() if name not in TIMES}
    if inputs.left_out is not None:
        report["left_out"] = dict(inputs.left_out)
    return {
        "width": width,
        "height": height,
        "encoding": options.encoding,
        "step": options.step if options.encoding == "u16" else 1.0,
        "depth": depth.tobytes(),
        "standard_deviation": None if deviation is None else deviation.tobytes(),
        "clipped": clipped,
        "report": as_text(report),
    }


def _finite(value: Any) -> Any:
    """Replaces NaN and infinity, which JSON lacks, by None."""
    return None if isinstance(value, float) and not np.isfinite(value) else value


def encoded(values: NDArray[np.float32], encoding: str, step: float) -> tuple[NDArray[Any], int]:
    """Encodes values, clipped to the range of the encoding, and returns the number of clipped ones."""
    if encoding == "f32":
        return values.astype(TYPES[encoding]), 0
    scaled = values.astype(np.float64)
    if encoding == "u16":
        scaled = np.rint(scaled / step)
    low, high = LIMITS[encoding]
    clipped = int(np.count_nonzero((scaled < low) | (scaled > high)))
    return np.clip(scaled, low, high).astype(TYPES[encoding]), clipped


def decode(row: dict[str, Any], column: str = "depth") -> NDArray[np.float32] | None:
    """Decodes the depths `(H, W)` of a row of results as float32, in metres (or the unit of the given floats), or the
    standard deviations, with `column="standard_deviation"`. None if there are none."""
    data = row[column]
    if data is None:
        return None
    is_depth = column == "depth"
    form = row["encoding"] if is_depth or row["encoding"] == "f32" else "f16"
    stored = np.frombuffer(data, TYPES[form]).reshape(row["height"], row["width"])
    values = stored.astype(np.float32)
    if is_depth and form == "u16":
        values = (stored * np.float64(row["step"])).astype(np.float32)
    return values


def as_picture(value: Any) -> Any:
    """Reads an image from an array, the bytes of a file, or a struct with these bytes, as in Hugging Face datasets."""
    value = _bytes(value)
    if not isinstance(value, bytes):
        return value
    from PIL import Image, ImageOps

    with Image.open(io.BytesIO(value)) as opened:
        return ImageOps.exif_transpose(opened)


def as_depths(value: Any) -> Any:
    """Reads depths from an array or the bytes of a file: npy, or a 16-bit image."""
    value = _bytes(value)
    if not isinstance(value, bytes):
        return value
    if value.startswith(b"\x93NUMPY"):
        try:
            return np.load(io.BytesIO(value), allow_pickle=False)
        except (ValueError, EOFError) as error:
            raise ReadError(f"depths are no sound npy file: {error}") from error
    from PIL import Image

    with Image.open(io.BytesIO(value)) as opened:
        if not opened.mode.startswith("I"):
            hint = "give npy, or a greyscale image of 16 bits"
            raise InputError(f"depths are an image of the kind {opened.mode}", hint)
        # Pillow may also decode 16-bit images to 32 bits.
        return np.asarray(opened).astype(np.uint16)


def _bytes(value: Any) -> Any:
    if isinstance(value, dict) and "bytes" in value:
        value = value["bytes"]
    if value is None:
        raise InputError("a value is missing")
    return bytes(value) if isinstance(value, (bytearray, memoryview)) else value

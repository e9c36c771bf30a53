"""Options of the completion of frames."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
import ray

from .._completer import Completer
from .._errors import SettingsError
from .._input import Order, Size, Unit, as_size, per_metre
from .._native import check_device, golden

Encoding = Literal["f16", "u16", "f32"]
"""How depths are stored: as floats of 16 or 32 bits, or as unsigned integers of 16 bits in a unit of their own."""

ENCODINGS = ("f16", "u16", "f32")


@dataclass(frozen=True)
class Options:
    """Options of `Completer.complete` and of the storage of its results. Invalid options are refused when this is created,
    not on the cluster."""

    completer: Completer
    unit: Unit | None = None
    sigma: float | None = None
    size: Size | None = None
    order: Order = "rgb"
    encoding: Encoding = "f16"
    step: float = 0.001
    standard_deviation: bool = False
    device: str = "cpu"
    """Of the workers: `completer` is on the CPU, because the process that starts the job may have no GPU."""

    def __post_init__(self) -> None:
        check_device(self.device)
        per_metre(self.unit)
        if self.size is not None:
            as_size(self.size, "size")
        if self.order not in ("rgb", "bgr"):
            raise SettingsError(f"`order` is {self.order!r}", 'orders are "rgb" and "bgr"')
        if self.encoding not in ENCODINGS:
            raise SettingsError(f"`encoding` is {self.encoding!r}", f"encodings are {', '.join(ENCODINGS)}")
        for name, value in (("step", self.step), ("sigma", self.sigma)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SettingsError(f"`{name}` is {value!r}, not a positive number")

    def record(self) -> dict[str, Any]:
        """Returns everything that determines the bits of a result, besides the frame and the instruction set.
        
        `numerics` identifies the numerics of this version: versions with the same numerics can resume a run.
        """
        name, weights, given = cast("tuple[Any, ...]", self.completer.__reduce__()[1])
        side = given["encoder_side"]
        if isinstance(weights, bytes):
            name = f"sha256:{hashlib.sha256(weights).hexdigest()}"
        return {
            "numerics": golden(),
            "weights": name,
            "fit": self.completer.fit,
            "working_size": given["working_size"],
            **({} if side is None else {"encoder_side": side}),
            **({} if self.device == "cpu" else {"device": self.device}),
            "unit": self.unit,
            "sigma": self.sigma,
            "size": self.size,
            "order": self.order,
            "encoding": self.encoding,
            "step": self.step if self.encoding == "u16" else None,
            "standard_deviation": self.standard_deviation,
        }


    def on_worker(self) -> Completer:
        """Returns the completer of a worker: on the GPU that Ray assigned to it, unless the device names one."""
        if self.device == "cpu":
            return self.completer
        assigned = ray.get_runtime_context().get_accelerator_ids().get("GPU", [])
        device = self.device
        if device == "wgpu" and assigned:
            if not assigned[0].isdecimal():
                what = f"Ray assigned the GPU `{assigned[0]}`, which is not a number"
                raise SettingsError(what, 'give a device with a number, such as "wgpu:0"')
            device = f"wgpu:{assigned[0]}"
        return self.completer.with_device(device)


def as_text(record: Any) -> str:
    """Returns canonical JSON."""
    return json.dumps(record, sort_keys=True, allow_nan=False)

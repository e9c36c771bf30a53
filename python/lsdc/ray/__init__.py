"""Depth completion on a cluster: Ray Data on top of `lsdc`.

`complete` is a step in a pipeline of Ray Data; `python -m lsdc.ray SOURCE DEST` completes folders, models of COLMAP,
tars of WebDataset and Parquet, and can be interrupted at any time. Needs `pip install lsdc[ray]`.
"""

from __future__ import annotations

try:
    import pyarrow as _pyarrow
    import ray as _ray
except ImportError as error:
    raise ImportError(f"lsdc.ray needs Ray: pip install 'lsdc[ray]' ({error})") from error

from ._dataset import complete
from ._frame import SCHEMA, decode
from ._options import Encoding

__all__ = ["SCHEMA", "Encoding", "complete", "decode"]

del _pyarrow, _ray

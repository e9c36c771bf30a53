"""A trained network with the settings of the fit."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal, Union, cast

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._completion import Completion
from ._errors import InputError, ReadError, SettingsError, WeightsError
from ._input import Array, ImageLike, Noise, Order, Size, Unit, as_image, as_outputs, as_size
from ._many import Completed, Progress, complete_each
from ._scene import Guide, Scene, as_native_guide
from ._settings import FitSettings, Robust, as_json
from ._sparse import Sparse
from ._views import PosedView, neighbours

Weights = Union[Literal["default", "small", "anything", "none"], str, "os.PathLike[str]", bytes]
"""A name, the path of a weights file, or the bytes of one."""

NAMES = ("default", "small", "anything", "none")
HINT = f"give {', '.join(map(json.dumps, NAMES))}, or the path of a weights file"


class Completer:
    """A trained network with the settings of the fit. Create one, and use it for all images, from any thread.

    Parameters
    ----------
    weights : name, path or bytes
        "default", the most accurate without an installation; "small", for weak machines; "anything", the most accurate
        of all, with an encoder that the program `lsdc` installs once (`lsdc weights get anything`, or offline
        `lsdc weights add FILE`); "none", no network, for scenes with a guide; or a weights file as written by
        `lsdc train`. For a file with one of these names, give `Path("default")`.
    fit : FitSettings, optional
        Settings that differ from those stored with the weights, under the names of the program's configuration, such as
        `{"method": "lse", "joint": {"cosines": 0}}`.
    robust : optional
        Short for `fit={"robust": ...}`: "auto", the name of another loss, or `RobustSettings`.
    working_size : (width, height), optional
        Images are resized to about this number of pixels before they enter the network, instead of the size of the
        training images. More pixels resolve more edges and take more time.
    encoder_side : int, optional
        Size of the images that the encoder of "anything" reads: the shorter side of one of 4:3 with as many pixels, from 252 to
        518 (default: 336).
    threads : int, optional
        Number of threads of a separate pool. By default, all completers share a pool with a thread per core (or
        RAYON_NUM_THREADS). Results are the same bits for any number of threads.
    device : str
        Where the network runs, with its encoder and depth head: "cpu", or in a package built with the feature `gpu`, "wgpu" (the
        best GPU), "wgpu:N" (discrete, from 0), "wgpu:integrated" or "wgpu:software". The fit stays on the CPU.

    Raises
    ------
    ReadError, WeightsError, SettingsError
        A file cannot be read or is not a weights file, an encoder is not installed, settings are out of range, or there is no
        such device.

    >>> completer = lsdc.Completer("small")
    >>> completer
    lsdc.Completer('small')
    >>> scene = completer.scene(image)                 # the network runs, once
    >>> for points in (sparse, sparse * 2):
    ...     print(f"{scene.complete(points).depth.mean():.1f} m")
    2.0 m
    4.0 m

    Completers can be pickled, for multiprocessing, Ray and Dask; weights from a file are included.
    """

    def __init__(
        self,
        weights: Weights = "default",
        *,
        fit: FitSettings | None = None,
        robust: Robust = None,
        working_size: Size | None = None,
        encoder_side: int | None = None,
        threads: int | None = None,
        device: str = "cpu",
    ) -> None:
        try:
            changes: dict[str, Any] = dict(fit or {})
        except (TypeError, ValueError):
            hint = 'for example `fit={"method": "lse"}`'
            raise SettingsError(f"`fit` is {fit!r}, not a dict", hint) from None
        if robust is not None:
            if "robust" in changes:
                raise SettingsError("`robust` is given twice, once in `fit`")
            changes["robust"] = robust
        if threads is not None and threads < 1:
            raise SettingsError(f"`threads` is {threads}, which is less than one")
        self._name, self._weights = _loaded(weights)
        self._changes = as_json(changes) if changes else None
        self._working_size = None if working_size is None else as_size(working_size, "working_size")
        if encoder_side is not None and encoder_side < 0:
            raise SettingsError(f"`encoder_side` is {encoder_side}, not 252 to 518")
        self._encoder_side = encoder_side
        self._threads = threads
        self._device = device
        self._build()

    def _build(self) -> None:
        self._process = os.getpid()
        self._native = _native.Completer(
            self._weights, self._changes, self._working_size, self._threads, self._device
        )
        if self._encoder_side is not None:
            self._native = self._native.with_encoder_side(self._encoder_side)

    def _here(self) -> _native.Completer:
        """Made again in a process that was forked, where the threads of the other one are missing."""
        if self._process != os.getpid():
            self._build()
        return self._native

    @property
    def fit(self) -> FitSettings:
        """All settings of the fit.

        >>> lsdc.Completer("small", fit={"method": "lse"}).fit["method"]
        'lse'
        """
        return cast(FitSettings, json.loads(self._native.fit))

    @property
    def parameters(self) -> int:
        """Number of trained parameters of the network."""
        return self._native.parameters

    @property
    def has_depth_head(self) -> bool:
        """Whether scenes without a given guide use the depth head of "anything" as a guide, which is installed with the encoder
        of these weights."""
        return self._native.has_depth_head

    @property
    def threads(self) -> int:
        """Number of threads of this completer."""
        return self._here().threads

    @property
    def device(self) -> str:
        """The device of the network."""
        return self._device

    def with_device(self, device: str) -> Completer:
        """Returns a completer with the same weights and settings whose network runs on another device.

        >>> lsdc.Completer("small").with_device("cpu").device
        'cpu'
        """
        return _restored(self._name, self._weights, {**self._options(), "device": device})

    def scene(
        self,
        image: ImageLike,
        *,
        guide: Guide | Literal["none"] | None = None,
        outputs: Sequence[Array] | None = None,
        order: Order = "rgb",
    ) -> Scene:
        """Runs the network on an image, and computes everything that depends only on the image.

        Parameters
        ----------
        image : array (H, W, 3), (H, W) or (H, W, 4), image of Pillow, or path
            Unsigned integers of 8 or 16 bits, or floats from 0 to 1. The fourth channel is ignored.
        guide : DepthGuide, array (H, W) or "none", optional
            A depth prediction from another source; an array contains depths. By default, the prediction of the depth head
            of the weights "anything", if it is installed; "none" switches this off.
        outputs : (basis, affinities), optional
            Basis functions (functions, H', W') and affinities (2, H', W') computed by another program instead of the
            network, from `network_input(image)` with weights from `lsdc weights export`. Basis functions are interpolated
            at points between their pixels.
        order : "rgb" or "bgr"
            The order of the colours in memory: "bgr" as read by OpenCV.

        Raises
        ------
        InputError
            Not an image, or colours that are NaN or far above 1; outputs of other shapes.
        """
        if isinstance(guide, str) and guide != "none":
            raise InputError(f'`guide` is "{guide}", neither a map nor "none"')
        given = None if guide is None or isinstance(guide, str) else as_native_guide(guide)
        known = None if outputs is None else as_outputs(outputs)
        return Scene(self._here().scene(*as_image(image, order), known, given, guide is None))

    def network_input(self, image: ImageLike, *, order: Order = "rgb") -> NDArray[np.float32]:
        """Returns the network input for an image, `(1, 3, H', W')`: resized to the working size, colours from 0 to 1.

        Another program can run the network of `lsdc weights export` on it; `scene` takes the outputs.

        >>> lsdc.Completer("small").network_input(image).shape
        (1, 3, 228, 304)
        """
        return self._here().network_input(*as_image(image, order))[None]

    def complete(
        self,
        image: ImageLike,
        sparse: Sparse,
        *,
        sigma: Array | float | None = None,
        noise: Noise | None = None,
        unit: Unit | None = None,
        guide: Guide | Literal["none"] | None = None,
        size: Size | None = None,
        order: Order = "rgb",
    ) -> Completion:
        """`scene(image).complete(sparse)`, for an image that has one set of points; see `Scene.complete`.

        >>> lsdc.Completer("small").complete(image, sparse)
        <lsdc.Completion 64x48, 192 points, residual 0.00... m>
        """
        scene = self.scene(image, guide=guide, order=order)
        return scene.complete(sparse, sigma=sigma, noise=noise, unit=unit, size=size)

    def complete_many(
        self,
        images: Iterable[ImageLike],
        points: Iterable[Sparse],
        *,
        guides: Iterable[Guide | Literal["none"] | None] | None = None,
        sigma: float | None = None,
        noise: Noise | None = None,
        unit: Unit | None = None,
        robust: Robust = None,
        size: Size | None = None,
        order: Order = "rgb",
        workers: int = 2,
        progress: Progress | None = None,
    ) -> Iterator[Completed]:
        """Completes many images, each with its own depths. Images, points and results of only `workers` images are in memory at
        a time, unless you keep them.

        Parameters
        ----------
        images, points, guides : iterables of the same length
            Arrays or paths, as for `complete`. Items are requested as images are completed, so generators can read them.
        sigma : number, optional
            Standard deviation of all depths; for individual ones, use a fourth column of the points.
        noise, unit, robust, size, order
            As for `complete`.
        workers : int
            Number of images that are read and completed at the same time. All share the threads of the completer; two keep
            them busy while files are read.
        progress : callable, optional
            Called with the number of completed images and the total (None if no argument has a length).

        Yields
        ------
        Completed
            One for each image, in their order: its `completion`, or its `error`. An error does not stop the other images.

        >>> names = ["a", "b"]
        >>> for done in lsdc.Completer("small").complete_many([image, image], [sparse, 2 * sparse]):
        ...     print(names[done.index], round(float(done.result().depth.mean())))
        a 2
        b 4
        """

        def work(image: ImageLike, known: Sparse, guide: Guide | Literal["none"] | None = None) -> Completion:
            scene = self.scene(image, guide=guide, order=order)
            return scene.complete(known, sigma=sigma, noise=noise, unit=unit, robust=robust, size=size)

        columns: list[Iterable[Any]] = [images, points, *([] if guides is None else [guides])]
        return complete_each(work, columns, workers, progress)

    def complete_views(
        self,
        images: Iterable[ImageLike],
        views: Sequence[PosedView],
        *,
        count: int = 8,
        only_past: bool = False,
        max_points: int = 2000,
        robust: Robust = None,
        size: Size | None = None,
        order: Order = "rgb",
        workers: int = 2,
        progress: Progress | None = None,
    ) -> Iterator[Completed]:
        """Completes the images of a sequence, each with its points and those of its neighbours, transferred by their poses.

        Parameters
        ----------
        images : iterable
            Arrays or paths, requested as images are completed.
        views : sequence of PosedView
            One for each image: its points, its camera and its pose.
        count : int
            Largest number of neighbours of an image.
        only_past : bool
            Whether only earlier views are neighbours, as in online use.
        max_points : int
            Largest number of points transferred to an image.
        robust, size, order, workers, progress
            As for `complete_many`.

        Yields
        ------
        Completed
            One for each image, in their order. `completion.views` reports on the points of neighbours.

        >>> camera = lsdc.Camera((60, 60), (31.5, 23.5), size=(64, 48))
        >>> wall = np.stack(np.meshgrid(np.arange(2.0, 64, 9), np.arange(2.0, 48, 9), 2.0), axis=-1).reshape(-1, 3)
        >>> views = []
        >>> for i in range(3):                         # the camera moves to the right, in front of a wall
        ...     pose = np.eye(4)
        ...     pose[:3, 3] = 0.1 * i, 0, 0
        ...     views.append(lsdc.PosedView(wall + [i, 2 * i, 0], camera, pose))
        >>> for done in lsdc.Completer("small").complete_views([image] * 3, views, only_past=True):
        ...     print(done.index, done.result().views.considered)
        0 0
        1 1
        2 2
        """
        views = list(views)

        def work(image: ImageLike, index: int) -> Completion:
            scene = self.scene(image, order=order)
            others = [views[i] for i in neighbours(views, index, count=count, only_past=only_past)]
            return scene.complete_with_views(views[index], others, max_points=max_points, robust=robust, size=size)

        return complete_each(work, [images, range(len(views))], workers, progress)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._name, self._weights, self._options())

    def _options(self) -> dict[str, Any]:
        """The arguments besides the weights."""
        return {
            "fit": None if self._changes is None else json.loads(self._changes),
            "working_size": self._working_size,
            "encoder_side": self._encoder_side,
            "threads": self._threads,
            "device": self._device,
        }

    def __repr__(self) -> str:
        parts = [repr(self._name)]
        usual = {"device": "cpu"}
        given = ((name, value) for name, value in self._options().items() if value not in (None, usual.get(name)))
        parts.extend(f"{name}={value!r}" for name, value in given)
        return f"lsdc.Completer({', '.join(parts)})"


def _restored(name: str, weights: str | bytes, options: dict[str, Any]) -> Completer:
    completer = Completer(weights, **options)
    completer._name = name
    return completer


def _loaded(weights: Weights) -> tuple[str, str | bytes]:
    """Returns a name for messages, and a name known to the extension module or the bytes of a file."""
    if isinstance(weights, (bytes, bytearray, memoryview)):
        return f"<{len(weights)} bytes>", bytes(weights)
    if isinstance(weights, str) and weights in NAMES:
        return weights, weights
    path = os.fspath(weights)
    like_a_name = os.path.basename(path) == path and not os.path.splitext(path)[1]
    if isinstance(weights, str) and like_a_name and not os.path.exists(path):
        raise WeightsError(f"there are no weights `{path}`", HINT)
    try:
        with open(path, "rb") as file:
            return path, file.read()
    except OSError as error:
        raise ReadError(f"cannot read weights from `{path}`: {error.strerror or error}", HINT) from error

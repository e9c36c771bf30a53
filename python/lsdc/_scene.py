"""The network output for one image, ready to be fitted to points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Union

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._alignment import Alignment
from ._completion import Completion
from ._guide import DepthGuide
from ._input import Array, Noise, Size, Unit, as_array, as_count, as_positions, as_size
from ._pickling import Unpicklable
from ._settings import Robust, as_json
from ._sparse import Sparse, observed
from ._views import PosedView
from ._views_report import ViewsReport

Guide = Union[DepthGuide, Array]


class Scene(Unpicklable):
    """The basis functions and affinities of an image. New points for the same image need only a fit.

    Created by `Completer.scene`; can be shared between threads.
    """

    _instead = "send the completer and the image, and make the scene there, or send arrays such as `completion.depth`"

    def __init__(self, native: _native.Scene) -> None:
        self._native = native

    @property
    def size(self) -> Size:
        """Width and height of the image."""
        return self._native.width, self._native.height

    @property
    def network_time(self) -> float:
        """The run time of the network in seconds."""
        return self._native.network_time

    def complete(
        self,
        sparse: Sparse,
        *,
        sigma: Array | float | None = None,
        noise: Noise | None = None,
        unit: Unit | None = None,
        robust: Robust = None,
        guide: Guide | None = None,
        near: Completion | NDArray[np.float64] | None = None,
        size: Size | None = None,
    ) -> Completion:
        """Fits the basis functions of the image to known depths.

        Parameters
        ----------
        sparse : array (H, W), (N, 3) or (N, 4), tuple of arrays (N,), or path
            A depth map of the image's shape, or of the same proportions with fewer or more pixels, where 0, negative,
            NaN, infinite and masked values mean no measurement; or points as rows x, y, depth[, sigma]; or these columns
            as a tuple; or a file of a map or points, as for `read_points`. x points to the right, y down, in pixels from
            the centre of the first pixel, with fractions. Depths are measured along the optical axis.
        sigma : array of the shape of the depths, or a number, optional
            Standard deviations of the depths in the same unit. Values that are not positive and finite mean unknown, and
            are counted in the report (`without_deviation`).
        noise : "kinect", "realsense", "tof" or (A, B, C), optional
            Noise of a depth camera: depths without a standard deviation get A + B z + C z^2 metres at z metres. Depths
            must be in metres, or `unit` must be given.
        unit : "m", "cm", "mm" or the metres of one step, optional
            Unit of `sparse` and `sigma`; required for integers. Floats are in metres or any other unit; the result is in
            the same unit.
        robust : optional
            Limits the influence of outliers: "auto", the name of another loss, or `RobustSettings`. By default, the
            setting of the completer.
        guide : DepthGuide or array (H, W), optional
            A depth prediction from another source, in place of the scene's guide.
        near : Completion or its weights, optional
            The fit of the previous frame of a video, which regularises this one, up to scale.
        size : (width, height), optional
            Size of the maps of the completion; by default the size of the image.

        Returns
        -------
        Completion
            Unusable points (positions outside the image, depths that are not positive and finite) are left out and counted
            in its report.

        Raises
        ------
        FitError
            No depth can be used.
        InputError
            Arrays of other shapes or types.

        >>> scene = lsdc.Completer("small").scene(image)
        >>> points = np.array([[5.0, 7.5, 2.0], [40.2, 30.0, 2.2], [60.0, 12.0, 1.8], [99.0, 12.0, 1.8]])
        >>> report = scene.complete(points).report
        >>> report["used"], report["outside"]
        (3, 1)
        """
        known = observed(sparse, sigma, noise, unit, self.size)
        scene = self._native
        if robust is not None:
            scene = scene.with_robust(as_json(robust))
        if guide is not None:
            scene = scene.with_guide(as_native_guide(guide))
        weights = near.weights if isinstance(near, Completion) else near
        if weights is not None:
            weights = np.ascontiguousarray(as_array(weights, "`near`"), dtype=np.float64)
        size = self.size if size is None else as_size(size, "size")
        return Completion(scene.complete(known, weights), known, size)

    def complete_with_views(
        self,
        view: PosedView,
        others: Sequence[PosedView],
        *,
        max_points: int = 2000,
        robust: Robust = None,
        size: Size | None = None,
    ) -> Completion:
        """Fits the basis functions of the image to its own depths together with those of other views.

        Parameters
        ----------
        view : PosedView
            The view of this image.
        others : sequence of PosedView
            Views whose points are transferred, preferably those of `neighbours`, closest first.
        max_points : int
            Largest number of points transferred.
        robust, size
            As for `complete`.

        Returns
        -------
        Completion
            Its `views` reports on the points of other views. Residuals, leave-one-out errors and outliers are those of the
            image's own depths.

        Raises
        ------
        FitError
            No depth of the image can be used.
        InputError
            A view has another size than the image.

        >>> camera = lsdc.Camera((60, 60), (31.5, 23.5), size=(64, 48))
        >>> poses = [np.eye(4), np.eye(4)]
        >>> poses[1][:3, 3] = 0.2, 0, 0                # the second camera, 20 cm to the right
        >>> wall = np.stack(np.meshgrid(np.arange(2.0, 64, 9), np.arange(2.0, 48, 9), 2.0), axis=-1).reshape(-1, 3)
        >>> views = [lsdc.PosedView(wall + [shift, shift, 0], camera, pose) for shift, pose in zip((0, 3), poses)]
        >>> others = [views[i] for i in lsdc.neighbours(views, 0)]
        >>> completion = lsdc.Completer("small").scene(image).complete_with_views(views[0], others)
        >>> completion.views.outcome, completion.views.carried > 20
        ('used', True)
        """
        scene = self._native
        if robust is not None:
            scene = scene.with_robust(as_json(robust))
        size = self.size if size is None else as_size(size, "size")
        natives = [other._native for other in others]
        native, report = scene.complete_with_views(view._native, natives, as_count(max_points, "max_points"))
        return Completion(native, view._given, size, ViewsReport(**report))

    def alignment(self, sparse: Sparse, *, unit: Unit | None = None) -> Alignment:
        """Tests whether points are aligned with the image, which they are not with wrong extrinsics or time stamps.

        At most 2000 points are predicted from each other, unshifted and with 40 shifts of up to a twentieth of the width of
        the image. One image is rarely enough, so add the evidence of the first five to ten frames of a recording. Each frame
        takes as long as about 41 fits. `sparse` and `unit` are those of `complete`. Fewer than 100 points away from the
        border give no evidence.

        >>> completer, alignment = lsdc.Completer("small"), lsdc.Alignment()
        >>> for image, points in [(image, sparse)] * 5:
        ...     alignment += completer.scene(image).alignment(points)
        >>> shift = alignment.shift
        >>> shift.frames, "check extrinsics and time stamps" if shift.is_clear else "no evidence of a shift"
        (5, 'no evidence of a shift')
        """
        return Alignment(self._native.alignment(observed(sparse, None, None, unit, self.size)))

    def basis_functions(self, positions: Array) -> NDArray[np.float32]:
        """Returns the basis functions of the network, `(N, functions)`, at positions `(N, 2)` of x and y; the first is the
        constant."""
        return self._native.basis_functions(as_positions(positions))

    def __repr__(self) -> str:
        width, height = self.size
        return f"<lsdc.Scene {width}x{height}>"


def as_native_guide(guide: Guide) -> _native.DepthGuide:
    guide = guide if isinstance(guide, DepthGuide) else DepthGuide(guide)
    return guide._native

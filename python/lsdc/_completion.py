"""A fit and everything derived from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._camera import Camera
from ._cloud import PointCloud, cloud_of
from ._input import Array, Size, as_positions, as_size
from ._pickling import Unpicklable
from ._picture import coloured, png
from ._views_report import ViewsReport

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Outliers:
    """The depths that are more likely outliers than inliers, judged by the others; worst first. All arrays `(M,)`."""

    index: NDArray[np.int64]
    """Row among the given points."""
    probability: Floats
    """That it is wrong."""
    score: Floats
    """Distance from the value predicted by the others, in the scale of the errors that right depths have there;
    positive where the depth is farther away."""
    error: Floats
    """Its depth minus the depth predicted by the others, in metres."""
    weight: Floats
    """What it kept in a robust fit."""

    def __len__(self) -> int:
        return len(self.index)


class Completion(Unpicklable):
    """A scene fitted to known depths.

    Everything beyond the fit is computed on first use and cached, as read-only arrays (use `.copy()` to modify them). Depths
    are along the optical axis, in metres or in the unit of the given floats.

    >>> completion = lsdc.Completer("small").complete(image, sparse)
    >>> completion.depth.shape, completion.depth.dtype
    ((48, 64), dtype('float32'))
    >>> bool((completion.standard_deviation > 0).all())
    True
    >>> len(completion.residuals) == len(completion.points) == completion.report["given"]
    True
    """

    _instead = "send its arrays, such as `completion.depth`, or the completer, the image and the points"

    def __init__(
        self,
        native: _native.Completion,
        given: _native.Observations,
        size: Size,
        views: ViewsReport | None = None,
    ) -> None:
        self._native = native
        self._given = given
        self._size = size
        self._views = views

    @property
    def size(self) -> Size:
        """Width and height of the maps."""
        return self._size

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """The dense depth `(H, W)`: positive and finite at every pixel."""
        return _kept(self.depth_at(self._size))

    def depth_at(self, size: Size) -> NDArray[np.float32]:
        """Computes the dense depth at another width and height."""
        return self._native.depth_at(*as_size(size, "size"))

    @cached_property
    def standard_deviation(self) -> NDArray[np.float32]:
        """The standard deviation of the depth error at every pixel `(H, W)`: 68.27 % of errors are expected to be smaller.
        Errors have heavier tails than a normal distribution; `interval` gives the number of deviations for another share.

        Raises `FitError` if there are too few points for an estimate."""
        return _kept(self.standard_deviation_at(self._size))

    def standard_deviation_at(self, size: Size) -> NDArray[np.float32]:
        """Computes the standard deviations at another width and height."""
        return self._native.standard_deviation_at(*as_size(size, "size"))

    def interval(self, level: float) -> float:
        """Returns the number of standard deviations around the depth that contain a share of errors between 0 and 1.

        >>> round(lsdc.Completer("small").complete(image, sparse).interval(0.6827), 2)
        1.0
        """
        return self._native.interval(level)

    @property
    def sky_pixels(self) -> int:
        """Number of pixels of the image that show sky that no point measured, where Depth Anything predicted the guide.

        Their standard deviation is at least the depth, whose value means nothing there. 0 without such a guide.
        """
        return self._native.sky_pixels()

    @property
    def freedom(self) -> float | None:
        """Degrees of freedom of the distribution of errors; None if it is assumed to be normal."""
        return self._native.freedom()

    def at(self, positions: Array) -> NDArray[np.float32]:
        """Returns the depth `(N,)` at positions `(N, 2)` of x and y in the image, which may lie between pixels."""
        return self._native.at(as_positions(positions))

    def point_cloud(
        self,
        camera: Camera,
        *,
        size: Size | None = None,
        max_sigma: float | None = None,
        max_relative_sigma: float | None = 0.1,
        voxel: float | None = None,
        keep_flying: bool = False,
    ) -> PointCloud:
        """Returns the depth map as a point cloud with the colours of the image.

        Parameters
        ----------
        camera : Camera
            Camera of the image; with `size`, of the image at that size.
        size : (width, height), optional
            Size of the map whose pixels become points; by default the size of this completion's maps.
        max_sigma : float, optional
            Leaves out pixels with a larger standard deviation, in metres.
        max_relative_sigma : float, optional
            Leaves out pixels whose standard deviation, relative to their depth, is larger. Pixels above the default count as
            not measured; None keeps them.
        voxel : float, optional
            Keeps one point in each cube of this edge length, in metres: the mean of its pixels.
        keep_flying : bool
            Keeps flying pixels, which lie between the surfaces at a depth edge: pixels at which the surface along a row, a
            column or a diagonal is seen at more than 80 degrees from its normal, and does not continue as a plane.

        Raises
        ------
        InputError
            The camera belongs to an image of another shape.
        FitError
            `max_sigma` is given, but there are too few points for an estimate of the standard deviations.

        >>> completion = lsdc.Completer("small").complete(image, sparse)
        >>> cloud = completion.point_cloud(lsdc.Camera((60, 60), (31.5, 23.5)))
        >>> cloud.points.shape, cloud.points.dtype, cloud.colors.shape, cloud.flying
        ((3072, 3), dtype('float32'), (3072, 3), 0)
        """
        size = self._size if size is None else as_size(size, "size")
        return cloud_of(self._native, camera, size, max_sigma, max_relative_sigma, voxel, keep_flying)

    @cached_property
    def points(self) -> Floats:
        """The given depths `(N, 3)`, as rows x, y, depth; for a map, its measurements row by row."""
        return _kept(self._given.table())

    @cached_property
    def residuals(self) -> Floats:
        """Every given depth minus the fitted depth `(N,)`; NaN for depths that were not used."""
        return self._own(self._native.residuals())

    @cached_property
    def leave_one_out(self) -> Floats:
        """Every given depth minus the prediction of a fit to all others `(N,)`; NaN for depths that were not used, and for
        depths that the fit interpolates whatever their values are."""
        return self._own(self._native.leave_one_out())

    @cached_property
    def leave_one_out_error(self) -> float | None:
        """Root mean square of the leave-one-out errors, an estimate of the error between the points without ground truth,
        if the points are distributed like the pixels; None if there are no such errors."""
        return self._native.leave_one_out_error()

    @cached_property
    def point_weights(self) -> Floats:
        """Final weight of every given depth `(N,)`: 1 in a plain fit without standard deviations; NaN for depths that were
        not used."""
        return self._own(self._native.point_weights())

    @cached_property
    def outliers(self) -> Outliers:
        """The depths that are more likely outliers than inliers.

        >>> wrong = sparse.copy()
        >>> wrong[18, 18] *= 3
        >>> completion = lsdc.Completer("small").complete(image, wrong)
        >>> completion.points[completion.outliers.index]
        array([[18. , 18. , ...]])
        """
        found = self._native.outliers()
        own = found[0] < len(self._given)
        return Outliers(*(_kept(column[own]) for column in found))

    @cached_property
    def weights(self) -> Floats:
        """Weights of the basis functions, starting with the constant or the image's map, followed by the weights of the
        cosines; for `Scene.complete(near=...)`."""
        return _kept(self._native.weights())

    @property
    def views(self) -> ViewsReport | None:
        """Report on the points of other views; None for a fit without them."""
        return self._views

    def _own(self, values: NDArray[Any]) -> NDArray[Any]:
        """Selects the entries of the given depths, which precede those of other views."""
        return _kept(values[: len(self._given)])

    @property
    def limits(self) -> tuple[float, float]:
        """Range of depths: that of the points, widened by a factor of 10 at both ends.

        Nearer than 0.7 times the nearest point, the fitted depth is continued linearly in inverse depth.
        """
        return self._native.limits()

    @property
    def report(self) -> dict[str, Any]:
        """Statistics of the fit.

        - `given`, `used`, `invalid` (depth not positive and finite), `outside` (the image):
          numbers of points, including points used from other views; `given = used + invalid + outside`
        - `ignored`: number of values of a map that were NaN, infinite or negative
        - `without_deviation`: points without a usable standard deviation, if others have one
        - `smoothed`: dense points that were smoothed by their standard deviations
        - `limited`: pixels in holes of dense depths at which basis functions contradicted the surrounding depths
        - `method`: the model of depth
        - `residual`: root mean square of the residuals
        - `rank`: number of directions that the points determine, at most `functions`
        - `lambda`: the strength of the prior; `guide_trust`: trust in the guide, 0 for none
        - `median_share`: share of the median in the map: 0 is the joint fit, 1 the median of this fit, the field alone and the
          surface spanned by the points
        - `network`, `fit` (which contains `field` and `solve`): seconds
        """
        report = self._native.report()
        report["ignored"] = self._given.ignored
        return report

    def __repr__(self) -> str:
        width, height = self._size
        report = self.report
        return f"<lsdc.Completion {width}x{height}, {report['used']} points, residual {report['residual']:.4f} m>"

    def _repr_png_(self) -> bytes:
        """The depth from blue (near) to red (far), between its 1st and 99th percentiles, for notebooks."""
        # Largest side of the picture, in pixels.
        most = 1024
        step = -(-max(self._size) // most)
        depth = self.depth[::step, ::step]
        low, high = np.quantile(depth, [0.01, 0.99])
        return png(coloured(depth, float(low), float(high)))


def _kept(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values

"""Depth completion by least squares: an image and a few depths in, a dense depth map out, with its errors.

>>> depth = lsdc.complete(image, sparse)          # (H, W) float32, metres

A network computes basis functions from the image alone, and a fit combines them to match the depths. For an image whose
points change, run the network once (`Completer.scene`) and fit as often as you like (`Scene.complete`). A `Completion` has
standard deviations, residuals, leave-one-out errors, outliers and a `point_cloud`. For a folder or a video, use
`complete_many`.
"""

from ._alignment import Alignment, Shift
from ._camera import Camera, Cloud
from ._cloud import PointCloud
from ._complete import complete, complete_many
from ._completer import Completer
from ._completion import Completion, Outliers
from ._errors import Error, FitError, InputError, ReadError, SettingsError, WeightsError
from ._files import Colmap, read_depth, read_points
from ._guide import DepthGuide
from ._many import Completed
from ._native import __version__
from ._scene import Scene
from ._settings import FitSettings, JointSettings, RobustSettings
from ._sparse import remove_hidden
from ._views import PosedView, neighbours
from ._views_report import ViewsReport
from ._warnings import FileWarning, InputWarning

__all__ = [
    "Alignment",
    "Camera",
    "Cloud",
    "Colmap",
    "Completed",
    "Completer",
    "Completion",
    "DepthGuide",
    "Error",
    "FileWarning",
    "FitError",
    "FitSettings",
    "InputError",
    "InputWarning",
    "JointSettings",
    "Outliers",
    "PointCloud",
    "PosedView",
    "ReadError",
    "RobustSettings",
    "Scene",
    "SettingsError",
    "Shift",
    "ViewsReport",
    "WeightsError",
    "__version__",
    "complete",
    "complete_many",
    "neighbours",
    "read_depth",
    "read_points",
    "remove_hidden",
]

"""Known depths in every format."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lsdc


@pytest.fixture(scope="module")
def expected(scene, sparse):
    return scene.complete(sparse).depth


def rows(sparse):
    v, u = np.nonzero(sparse)
    return np.column_stack([u, v, sparse[v, u]])


MISSING = [np.nan, -1.0, np.inf, -np.inf]


@pytest.mark.parametrize("missing", MISSING)
def test_what_is_no_measurement(scene, sparse, expected, missing):
    marked = np.where(sparse > 0, sparse, np.float32(missing))
    completion = scene.complete(marked)
    assert_array_equal(completion.depth, expected)
    assert completion.report["ignored"] == (sparse == 0).sum()


def test_masks(scene, sparse, expected):
    filled = np.where(sparse > 0, sparse, 9.0)
    assert_array_equal(scene.complete(np.ma.masked_array(filled, sparse == 0)).depth, expected)
    table = rows(sparse)
    wrong = np.vstack([table, [[3.0, 3.0, 50.0]]])
    mask = np.zeros_like(wrong, bool)
    mask[-1] = True
    completion = scene.complete(np.ma.masked_array(wrong, mask))
    assert_array_equal(completion.depth, expected)
    assert completion.report["invalid"] == 1


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, ">f4"])
@pytest.mark.parametrize("layout", [np.asarray, np.asfortranarray, lambda map: map[::-1].copy()[::-1]])
def test_types_and_layouts(scene, sparse, dtype, layout):
    quarters = np.rint(sparse * 4) / 4
    assert_array_equal(scene.complete(layout(quarters.astype(dtype))).depth, scene.complete(quarters).depth)


@pytest.mark.parametrize(
    ("unit", "steps", "dtype"),
    [
        ("mm", 1000, np.uint16),
        ("cm", 100, np.int32),
        (1 / 256, 256, np.uint16),
        (1 / 5000, 5000, np.uint16),
        ("m", 1, np.float64),
    ],
)
def test_units(scene, sparse, unit, steps, dtype):
    stored = np.rint(sparse * steps).astype(dtype) if dtype != np.float64 else sparse.astype(dtype)
    # The result of a correctly rounded division.
    metres = (stored.astype(np.float64) / steps).astype(np.float32)
    assert_array_equal(scene.complete(stored, unit=unit).depth, scene.complete(metres).depth)
    table = rows(sparse)
    table[:, 2] *= steps
    assert_allclose(scene.complete(table, unit=unit).depth, scene.complete(sparse).depth, rtol=1e-5)


def test_integers_need_a_unit(scene, sparse):
    millimetres = (sparse * 1000).astype(np.uint16)
    v, u = np.nonzero(millimetres)
    for form in (millimetres, rows(millimetres), (u, v, millimetres[v, u])):
        with pytest.raises(lsdc.InputError, match="unit") as caught:
            scene.complete(form)
        assert "mm" in caught.value.hint
        scene.complete(form, unit="mm")
    # 1000 was probably meant as 1 / 1000.
    for unit in ("feet", 0, -1.0, float("nan"), 1000, 256):
        with pytest.raises(lsdc.InputError, match="not a unit"):
            scene.complete(millimetres, unit=unit)


def test_points(scene, sparse, expected):
    table = rows(sparse)
    u, v, depth = table.T
    for form in (
        table,
        table.tolist(),
        np.asfortranarray(table),
        (u, v, depth),
        (u.astype(int), v.astype(int), depth),
    ):
        completion = scene.complete(form)
        assert_array_equal(completion.depth, expected)
        assert_array_equal(completion.points, table)


def test_depths_scale_the_result(scene, sparse, expected):
    # Exactly, because the network sees no depths.
    assert_array_equal(scene.complete(sparse * 4).depth, expected * 4)


def test_deviations(scene, sparse):
    table = rows(sparse)
    sigma = np.linspace(0.01, 0.2, len(table)).astype(np.float32)
    expected = scene.complete(table, sigma=sigma).depth
    assert (expected != scene.complete(table).depth).any()
    assert_array_equal(scene.complete(np.column_stack([table, sigma])).depth, expected)
    assert_array_equal(scene.complete((*table.T, sigma)).depth, expected)
    as_map = np.zeros_like(sparse)
    as_map[sparse > 0] = sigma
    assert_array_equal(scene.complete(sparse, sigma=as_map).depth, expected)
    # Standard deviations in the unit of the depths.
    in_mm = scene.complete(sparse * 1000, sigma=as_map * 1000, unit="mm").depth
    assert_allclose(in_mm, expected, rtol=1e-4)
    same = scene.complete(table, sigma=np.full(len(table), 0.05)).depth
    assert_array_equal(scene.complete(table, sigma=0.05).depth, same)
    assert_array_equal(scene.complete(sparse, sigma=0.05).depth, same)


def test_deviations_that_cannot_be_are_unknown(scene, sparse):
    table = rows(sparse)
    sigma = np.full(len(table), 0.05)
    depths = []
    for unknown in ([0.0, -1.0, np.nan, np.inf], [np.nan] * 4):
        sigma[:4] = unknown
        completion = scene.complete(table, sigma=sigma)
        report = completion.report
        assert (report["used"], report["invalid"], report["without_deviation"]) == (len(table), 0, 4)
        depths.append(completion.depth)
    assert_array_equal(*depths)


def test_marks_of_no_measurement_are_no_depths(scene, sparse):
    millimetres = np.rint(sparse * 1000).astype(np.uint16)
    expected = scene.complete(millimetres, unit="mm").depth
    marked = millimetres.copy()
    marked[0, :5] = 65535
    with pytest.warns(lsdc.InputWarning, match="the sparse depths: 5 depths .* 65535, .* left out"):
        completion = scene.complete(marked, unit="mm")
    assert_array_equal(completion.depth, expected)
    assert completion.report["ignored"] == 5


def test_what_is_left_out_is_counted(scene):
    points = [
        [5, 5, 2.0],
        [6.5, 9.25, 2.1],
        [-1, 5, 2.0],
        [64, 5, 2.0],
        [5, 5, np.nan],
        [5, np.inf, 2.0],
        [5, 5, 0.0],
    ]
    completion = scene.complete(points)
    report = completion.report
    assert (report["used"], report["outside"], report["invalid"]) == (2, 2, 3)
    assert_array_equal(np.isnan(completion.residuals), [False, False, True, True, True, True, True])


def test_maps_of_fewer_and_more_pixels(scene):
    low = np.linspace(1.5, 2.5, 12 * 16, dtype=np.float32).reshape(12, 16)
    v, u = np.mgrid[:12, :16]
    # The centre of a pixel of the map is between four by four pixels of the image.
    points = np.column_stack([4 * u.ravel() + 1.5, 4 * v.ravel() + 1.5, low.ravel()])
    completion = scene.complete(low, sigma=np.full_like(low, 0.1))
    assert_array_equal(completion.points, points)
    assert_array_equal(completion.depth, scene.complete(points, sigma=0.1).depth)
    high = scene.complete(np.full((96, 128), 2.0)).points
    assert_array_equal(high[[0, -1], :2], [[-0.25, -0.25], [63.25, 47.25]])


REFUSED = {
    "another shape": lambda sparse: sparse[:-1],
    "no pixels": lambda sparse: sparse[:0, :0],
    "turned": lambda sparse: sparse.T,
    "half the rows": lambda sparse: sparse[::2],
    "one number": lambda sparse: 2.0,
    "two columns": lambda sparse: np.ones((9, 2)),
    "five columns": lambda sparse: np.ones((9, 5)),
    "columns of different lengths": lambda sparse: (np.ones(3), np.ones(3), np.ones(4)),
    "two columns in a tuple": lambda sparse: (np.ones(3), np.ones(3)),
    "rows in a tuple": lambda sparse: ((5, 5, 2.0), (9, 9, 2.0), (20, 9, 2.1)),
    "maps in a tuple": lambda sparse: (sparse, sparse, sparse),
    "truth values": lambda sparse: sparse > 0,
    "complex": lambda sparse: sparse.astype(complex),
    "objects": lambda sparse: sparse.astype(object),
    "bytes": lambda sparse: b"sparse.npy",
    "nothing": lambda sparse: None,
}


def test_maps_of_one_channel(scene, sparse, expected):
    assert_array_equal(scene.complete(sparse[None]).depth, expected)
    assert_array_equal(scene.complete(sparse[..., None]).depth, expected)


def test_files(scene, sparse, expected, tmp_path):
    np.save(tmp_path / "map.npy", sparse)
    np.save(tmp_path / "points.npy", rows(sparse))
    for name in ("map.npy", "points.npy"):
        assert_array_equal(scene.complete(str(tmp_path / name), unit="m").depth, expected)
    completion = scene.complete(tmp_path / "map.npy", sigma=0.05)
    assert_array_equal(completion.depth, scene.complete(sparse, sigma=0.05).depth)
    # The unit of integers is guessed.
    np.save(tmp_path / "steps.npy", (sparse * 1000).astype(np.uint16))
    with pytest.warns(lsdc.FileWarning, match="taken to be in") as caught:
        scene.complete(tmp_path / "steps.npy")
    assert caught[0].filename == __file__
    with pytest.raises(lsdc.ReadError):
        scene.complete(tmp_path / "nothing.npy")
    with pytest.raises(lsdc.InputError, match="the guide") as caught:
        scene.complete(sparse, guide=str(tmp_path / "map.npy"))
    assert "read" in caught.value.hint


def test_what_hints_say(scene, sparse):
    for sparse, hint in ((sparse.T, "transpose"), (sparse[::2], "rows x, y, depth")):
        with pytest.raises(lsdc.InputError) as caught:
            scene.complete(sparse)
        assert hint in caught.value.hint


@pytest.mark.parametrize("form", REFUSED)
def test_what_is_no_depth_is_refused(scene, sparse, form):
    with pytest.raises(lsdc.InputError):
        scene.complete(REFUSED[form](sparse), unit="m")


@pytest.mark.parametrize(
    "form",
    [
        np.zeros((48, 64), np.float32),
        np.full((48, 64), np.nan),
        np.zeros((0, 3)),
        np.zeros((0, 4)),
        [[99, 99, 2.0]],
    ],
)
def test_no_depth_at_all(scene, form):
    with pytest.raises(lsdc.FitError, match="no sparse depth") as caught:
        scene.complete(form)
    assert caught.value.hint


def test_a_map_that_may_be_a_table_is_refused(completer):
    scene = completer.scene(np.zeros((20, 3), np.uint8))
    with pytest.raises(lsdc.InputError, match="may be") as caught:
        scene.complete(np.ones((20, 3)))
    assert "tuple" in caught.value.hint
    assert scene.complete((np.ones(20), np.arange(20.0), np.ones(20))).report["used"] == 20


@pytest.mark.parametrize("sigma", [np.ones(3), np.ones((64, 48)), "a", None, 0, -1.0, np.nan])
def test_deviations_of_another_shape_are_refused(scene, sparse, sigma):
    if sigma is None:
        with pytest.raises(lsdc.InputError, match="too"):
            scene.complete(np.ones((5, 4)), sigma=np.ones(5))
    else:
        with pytest.raises(lsdc.InputError):
            scene.complete(sparse, sigma=sigma)


def test_huge_and_tiny_depths(scene, sparse):
    for factor in (1e-12, 1e12):
        depth = scene.complete(sparse.astype(np.float64) * factor).depth
        assert_allclose(depth / factor, scene.complete(sparse).depth, rtol=1e-4)
    # Values that float32 cannot represent, at pixels without depth.
    beyond = sparse.astype(np.float64)
    beyond[2, 2] = 1e300
    report = scene.complete(beyond).report
    assert (report["ignored"], report["used"]) == (1, (sparse > 0).sum() - 1)


def test_noise_of_a_depth_camera(scene, sparse, tmp_path):
    # Fankhauser et al. (2015).
    sigma = np.where(sparse > 0, 0.0015 - 0.0005 * sparse + 0.0003 * sparse**2, 1.0)
    expected = scene.complete(sparse, sigma=sigma).depth
    for noise in ["tof", (0.0015, -0.0005, 0.0003)]:
        assert_allclose(scene.complete(sparse, noise=noise).depth, expected, rtol=1e-5)
    with pytest.raises(lsdc.SettingsError, match="no noise of a depth camera"):
        scene.complete(sparse, noise="radar")
    np.save(tmp_path / "sparse.npy", sparse)
    with pytest.raises(lsdc.InputError, match="may be a guess"):
        scene.complete(tmp_path / "sparse.npy", noise="tof")


def test_background_between_the_returns_of_an_object_is_hidden():
    scan = np.zeros((200, 600), np.float32)
    scan[::5, ::4] = 30
    scan[50:150:5, 200:300:4] = 8
    seen, hidden = lsdc.remove_hidden(scan)
    assert hidden == 0
    assert_array_equal(seen, scan)
    # A scanner to the left of the camera sees the wall past the object.
    occluded = np.zeros(scan.shape, bool)
    occluded[52:152:5, 201:213:4] = True
    seen, hidden = lsdc.remove_hidden(np.where(occluded, 30, scan) * 1000, unit="mm")
    assert not seen[occluded].any()
    assert_array_equal(seen[scan == 8], 8)
    assert occluded.sum() <= hidden < 0.1 * np.count_nonzero(scan)
    with pytest.raises(lsdc.InputError, match=r"shape \(2, 2, 2\)"):
        lsdc.remove_hidden(np.ones((2, 2, 2)))

"""Images in every format give the depth of the plain array."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import lsdc


@pytest.fixture(scope="module")
def expected(scene, sparse):
    return scene.complete(sparse).depth


def padded(image):
    """Returns the same pixels as a view of a larger array."""
    larger = np.zeros((50, 70, 3), np.uint8)
    larger[1:49, 3:67] = image
    return larger[1:49, 3:67]


def read_only(image):
    image = image.copy()
    image.flags.writeable = False
    return image


class Exchanged:
    """An array of another library that supports only DLPack."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


class Interface:
    """An object of the older protocol."""

    def __init__(self, array):
        self.__array_interface__ = array.__array_interface__
        self.array = array


LAYOUTS = {
    "plain": lambda image: image,
    "padded rows": padded,
    "columns first": np.asfortranarray,
    "upside down twice": lambda image: np.ascontiguousarray(image[::-1])[::-1],
    "mirrored twice": lambda image: np.ascontiguousarray(image[:, ::-1])[:, ::-1],
    "planes": lambda image: np.ascontiguousarray(image.transpose(2, 0, 1)).transpose(1, 2, 0),
    "colours reversed in memory": lambda image: np.ascontiguousarray(image[..., ::-1])[..., ::-1],
    "read-only": read_only,
    "16 bits": lambda image: image.astype(np.uint16) * 257,
    "16 bits, other byte order": lambda image: (image.astype(np.uint16) * 257).astype(">u2"),
    "float32": lambda image: image.astype(np.float32) / 255,
    "float64": lambda image: image / 255,
    "fourth channel": lambda image: np.dstack([image, np.full(image.shape[:2], 7, np.uint8)]),
    "DLPack": Exchanged,
    "DLPack, read-only": lambda image: Exchanged(read_only(image)),
    "array interface": Interface,
    "other byte order": lambda image: (image.astype(np.float32) / 255).astype(">f4"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts(completer, image, sparse, expected, layout):
    found = completer.complete(LAYOUTS[layout](image), sparse)
    assert_array_equal(found.depth, expected)


def test_blue_first(completer, image, sparse, expected):
    opencv = np.ascontiguousarray(image[..., ::-1])
    assert_array_equal(completer.complete(opencv, sparse, order="bgr").depth, expected)
    # A view whose memory has the order of colours that is given.
    assert_array_equal(completer.complete(image[..., ::-1], sparse, order="bgr").depth, expected)
    alpha = np.dstack([opencv, opencv[..., :1]])
    assert_array_equal(completer.complete(alpha, sparse, order="bgr").depth, expected)
    assert (completer.complete(opencv, sparse).depth != expected).any()


def test_grey(completer, image, sparse):
    grey = image[..., 1]
    expected = completer.complete(np.dstack([grey] * 3), sparse).depth
    for form in (grey, grey[:, :, None], grey.astype(np.float32) / 255):
        assert_array_equal(completer.complete(form, sparse).depth, expected)


def test_pillow_and_files(completer, image, sparse, expected, tmp_path):
    Image = pytest.importorskip("PIL.Image")
    picture = Image.fromarray(image)
    picture.save(tmp_path / "image.png")
    for form in (picture, picture.convert("RGBA"), tmp_path / "image.png", str(tmp_path / "image.png")):
        assert_array_equal(completer.complete(form, sparse).depth, expected)
    # Indices into a palette are not grey values.
    palette = picture.convert("P")
    expected = completer.complete(np.asarray(palette.convert("RGB")), sparse).depth
    assert_array_equal(completer.complete(palette, sparse).depth, expected)
    turned = Image.fromarray(np.rot90(image))
    exif = turned.getexif()
    # To be rotated clockwise.
    exif[274] = 6
    turned.save(tmp_path / "turned.png", exif=exif)
    assert completer.scene(tmp_path / "turned.png").size == (64, 48)
    with pytest.raises(lsdc.ReadError, match="missing.png"):
        completer.scene(tmp_path / "missing.png")
    with pytest.raises(lsdc.ReadError):
        completer.scene(__file__)


def test_a_picture_is_read_as_by_the_program(completer, image, sparse, tmp_path):
    Image = pytest.importorskip("PIL.Image")
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.jpg", quality=70)
    from lsdc import _native

    found, remarks = _native.read_image(str(tmp_path / "noise.jpg"))
    assert remarks == []
    assert found.shape == (48, 64, 3) and found.dtype == np.uint8
    # The decoders round differently.
    assert np.abs(found.astype(int) - np.asarray(Image.open(tmp_path / "noise.jpg"))).max() <= 40
    expected = completer.complete(found, sparse).depth
    assert_array_equal(completer.complete(tmp_path / "noise.jpg", sparse).depth, expected)


def test_a_picture_that_is_cut_off_is_refused(completer, image, tmp_path):
    Image = pytest.importorskip("PIL.Image")
    Image.fromarray(image).save(tmp_path / "whole.jpg")
    whole = (tmp_path / "whole.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(lsdc.ReadError, match="cut.jpg"):
        completer.scene(tmp_path / "cut.jpg")


def test_12_bits_in_16_are_stretched_with_a_word(completer, image, sparse, expected, tmp_path):
    Image = pytest.importorskip("PIL.Image")
    deep = image[..., 0].astype(np.uint16) * 16
    Image.fromarray(deep).save(tmp_path / "deep.png")
    found = []
    for form, category in ((deep, lsdc.InputWarning), (tmp_path / "deep.png", lsdc.FileWarning)):
        with pytest.warns(category):
            found.append(completer.complete(form, sparse).depth)
    assert_array_equal(*found)


def test_tensors(completer, image, sparse, expected):
    torch = pytest.importorskip("torch")
    colours, depths = torch.from_numpy(image.copy()), torch.from_numpy(sparse)
    assert_array_equal(completer.complete(colours, depths).depth, expected)
    assert_array_equal(completer.complete(colours.permute(2, 0, 1).permute(1, 2, 0), depths).depth, expected)
    with pytest.raises(lsdc.InputError, match="grad") as caught:
        completer.complete(colours, depths.requires_grad_())
    assert "detach" in caught.value.hint


REFUSED = {
    "planes first": (lambda image: image.transpose(2, 0, 1), "transpose"),
    "two channels": (lambda image: image[..., :2], r"\(H, W, 3\)"),
    "one row": (lambda image: image[0, :, 0], r"\(H, W, 3\)"),
    "a batch": (lambda image: image[None], r"\(H, W, 3\)"),
    "integers of unknown range": (lambda image: image.astype(np.int64), "8 or 16 bits"),
    "truth values": (lambda image: image > 9, "8 or 16 bits"),
    "objects": (lambda image: image.astype(object), None),
    "text": (lambda image: np.array([["a"]]), "8 or 16 bits"),
    "no rows": (lambda image: image[:0], None),
    "no columns": (lambda image: image[:, :0], None),
    "0 to 255 in floats": (lambda image: image.astype(np.float32), "from 0 to 1"),
    "NaN": (lambda image: np.full((48, 64, 3), np.nan, np.float32), None),
    "too many pixels": (lambda image: np.broadcast_to(image[:1, :1], (1, (1 << 30) + 1, 3))[:, :0], None),
    "nothing": (lambda image: None, None),
    "a dictionary": (lambda image: {}, None),
    "ragged": (lambda image: [[1, 2], [3]], None),
}


@pytest.mark.parametrize("form", REFUSED)
def test_what_is_no_image_is_refused(completer, image, form):
    make, hint = REFUSED[form]
    with pytest.raises(lsdc.InputError) as caught:
        completer.scene(make(image))
    assert isinstance(caught.value, ValueError)
    if hint is not None:
        import re

        assert re.search(hint, caught.value.hint)


def test_an_unknown_order_is_refused(completer, image):
    with pytest.raises(lsdc.InputError, match="rbg"):
        completer.scene(image, order="rbg")


@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (3, 4)])
def test_small_images(completer, shape):
    image = np.full((*shape, 3), 90, np.uint8)
    depth = completer.complete(image, (np.array([0.0]), np.array([0.0]), np.array([2.0]))).depth
    assert depth.shape == shape and np.isfinite(depth).all() and (depth > 0).all()

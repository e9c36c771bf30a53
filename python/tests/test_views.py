"""Images with poses use points of their neighbours."""

import subprocess

import numpy as np
import pytest

import lsdc
from test_program import PROGRAM

WIDTH, HEIGHT, FRAMES = 96, 72, 4
CAMERA = lsdc.Camera((80, 80), (47.5, 35.5), size=(WIDTH, HEIGHT))


def place(frame):
    """Pose of a camera that moves to the right in front of a wall at 3 m without turning."""
    pose = np.eye(4)
    pose[0, 3] = 0.15 * frame
    return pose


def wall(frame):
    """Depth of a wavy wall, z = 3 + 0.3 sin(2.4 x + 2 y), at every pixel of a frame."""
    down, across = np.mgrid[:HEIGHT, :WIDTH]
    right, down = (across - 47.5) / 80, (down - 35.5) / 80
    z = np.full((HEIGHT, WIDTH), 3.0)
    for _ in range(100):  # a contraction: waves are less steep than rays
        z = 3 + 0.3 * np.sin(2.4 * (place(frame)[0, 3] + right * z) + 2 * down * z)
    return z


def points(frame):
    """Points of a frame, at different places of the wall for each frame."""
    pixels = np.arange(frame * 13, WIDTH * HEIGHT, 151)
    return np.stack([pixels % WIDTH, pixels // WIDTH, wall(frame).ravel()[pixels]], axis=1)


def picture(frame):
    down, across = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([across * 2, down * 3, np.full_like(down, frame)], axis=-1).astype(np.uint8)


@pytest.fixture(scope="module")
def images():
    return [picture(frame) for frame in range(FRAMES)]


@pytest.fixture(scope="module")
def views():
    return [lsdc.PosedView(points(frame), CAMERA, place(frame)) for frame in range(FRAMES)]


def test_points_of_neighbours_lower_the_error(completer, images, views):
    alone, together = [], []
    for done in completer.complete_views(images, views):
        frame, completion = done.index, done.result()
        single = completer.complete(images[frame], points(frame))
        report = completion.views
        assert (report.outcome, report.considered, report.inconsistent) == ("used", 3, 0)
        assert report.carried > 100
        assert single.views is None
        for errors, found in ((alone, single), (together, completion)):
            errors.append(np.sqrt(np.mean((found.depth - wall(frame)) ** 2)))
        # Points of the image itself.
        own = len(points(frame))
        assert len(completion.residuals) == len(completion.leave_one_out) == len(completion.points) == own
        assert completion.report["given"] == own + report.carried
        assert (completion.outliers.index < own).all()
    assert np.mean(together) < 0.7 * np.mean(alone)


def test_the_same_as_the_program(completer, images, views, tmp_path):
    image = pytest.importorskip("PIL.Image")
    if not PROGRAM.exists():
        pytest.skip("the program is not built")
    for folder in ("images", "points"):
        (tmp_path / folder).mkdir()
    rows = []
    for frame in range(FRAMES):
        image.fromarray(images[frame]).save(tmp_path / f"images/{frame}.png")
        lines = [f"{int(u)},{int(v)},{float(z)!r}" for u, v, z in points(frame)]
        (tmp_path / f"points/{frame}.csv").write_text("\n".join(["u,v,depth", *lines]))
        rows.append(f"{frame} {float(place(frame)[0, 3])!r} 0 0 0 0 0 1")
    (tmp_path / "poses.txt").write_text("\n".join(rows))
    for options in ([], ["--views-past"]):
        out = tmp_path / f"out{len(options)}"
        camera = ["--camera", "80,80,47.5,35.5", "--views=poses.txt", "--weights", "small", "--formats", "npy"]
        command = [PROGRAM, "complete", "images", "points", "-o", out, "--quiet", *camera, *options]
        subprocess.run(command, check=True, cwd=tmp_path)
        for done in completer.complete_views(images, views, only_past=bool(options)):
            expected = np.load(out / f"{done.index}_depth.npy")
            np.testing.assert_array_equal(done.result().depth, expected)


def test_neighbours_share_the_view(views):
    assert lsdc.neighbours(views, 0) == [1, 2, 3]
    assert lsdc.neighbours(views, 3, count=2) == [2, 1]
    assert lsdc.neighbours(views, -1, only_past=True) == [2, 1, 0]
    assert lsdc.neighbours(views, 0, only_past=True) == []
    away = lsdc.PosedView(points(0), CAMERA, np.diag([-1.0, 1, -1, 1]))
    assert lsdc.neighbours([*views, away], 4) == []


def test_a_wrong_pose_is_left_out(completer, images, views):
    wrong = place(2)
    wrong[2, 3] = 1.2
    scene = completer.scene(images[1])
    others = [views[0], lsdc.PosedView(points(2), CAMERA, wrong)]
    report = scene.complete_with_views(views[1], others).views
    assert (report.used, report.inconsistent) == (1, 1)
    assert scene.complete_with_views(views[1], []).views.outcome == "no points"


def test_points_that_views_share_count_once(completer, images):
    grid = np.mgrid[-1:1:25j, -1:1:25j].reshape(2, -1)
    x, y = grid
    world = np.stack([x, y, 3 + 0.3 * np.sin(1.8 * x + 1.5 * y)], axis=1)
    pair = []
    for frame in range(2):
        camera = CAMERA.with_pose(place(frame))
        seen = camera.project(world)
        inside = (seen[:, 0] > 0) & (seen[:, 0] < WIDTH - 1) & (seen[:, 1] > 0) & (seen[:, 1] < HEIGHT - 1)
        pair.append(lsdc.PosedView(seen[inside], camera, ids=np.flatnonzero(inside)))
    report = completer.scene(images[0]).complete_with_views(pair[0], pair[1:]).views
    assert report.doubled > 300 and report.carried == 0


def test_a_pose_leads_from_the_camera_to_the_world():
    turned = np.array([[0.0, 0, 1, 5], [-1, 0, 0, 6], [0, -1, 0, 7], [0, 0, 0, 1]])
    camera = CAMERA.with_pose(turned)
    # Two metres ahead, along the world's x axis.
    np.testing.assert_allclose(camera.project([[7, 6, 7]]), [[47.5, 35.5, 2]], atol=1e-12)
    np.testing.assert_allclose(CAMERA.with_pose(turned[:3]).rotation, turned[:3, :3].T)
    fisheye = lsdc.Camera((80, 80), (47.5, 35.5), lens="fisheye").with_pose(turned)
    assert (fisheye.lens, fisheye.size) == ("fisheye", None)


def test_what_is_wrong_is_said(views, completer, images):
    with pytest.raises(lsdc.InputError, match="transposed"):
        CAMERA.with_pose(np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [5, 6, 7, 1]]))
    with pytest.raises(lsdc.SettingsError, match="mirrors or scales"):
        CAMERA.with_pose(np.diag([1.0, 1, -1, 1]))
    with pytest.raises(lsdc.InputError, match="shape"):
        CAMERA.with_pose(np.eye(3))
    with pytest.raises(lsdc.InputError, match="size"):
        lsdc.PosedView(points(0), lsdc.Camera((80, 80), (47.5, 35.5)))
    with pytest.raises(lsdc.Error, match="ids"):
        lsdc.PosedView(points(0), CAMERA, ids=np.arange(3))
    with pytest.raises(lsdc.InputError, match="whole numbers"):
        lsdc.PosedView(points(0), CAMERA, ids=np.arange(3.0))
    with pytest.raises(IndexError):
        lsdc.neighbours(views, 9)
    small = completer.scene(images[0][:48, :64])
    with pytest.raises(lsdc.Error, match="96x72"):
        small.complete_with_views(views[0], [])
    failed = list(completer.complete_views([images[0][:48, :64]], views[:1]))
    assert failed[0].completion is None and "96x72" in str(failed[0].error)

"""KITTI's files against their geometry written out, and against the real ones where they are."""

import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from pmbm.datasets import with_origins
from pmbm.datasets.kitti import Kitti
from pmbm.datasets.kitti_files import image_boxes, read_calibration
from pmbm.errors import InputError
from pmbm.types import Label, Tracks, TrackSequence

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"


@pytest.fixture
def folder(tmp_path):
    """A copy of the sample, with poses: a quarter turn to the left and 5 m ahead a frame."""
    shutil.copytree(SAMPLE, tmp_path / "kitti")
    root = tmp_path / "kitti" / "training"
    shutil.copytree(tmp_path / "kitti" / "detections_ab3dmot", root / "detections")
    (root / "pose").mkdir()
    lines = ["1 0 0 0 0 1 0 0 0 0 1 0", "0 0 -1 0 0 1 0 0 1 0 0 5", "-1 0 0 0 0 1 0 0 0 0 -1 10"]
    (root / "pose" / "0000.txt").write_text("\n".join(lines) + "\n")
    return root


def dataset(root, **changes):
    values = {"root": root, "detections": str(root / "detections"), "poses": root / "pose"}
    return Kitti(**{**values, **changes})


def test_the_sample_in_the_world(folder):
    made = dataset(folder).recording("0000")
    assert [len(frame) for frame in made.truth] == [1, 1, 1]
    assert [len(frame) for frame in made.detections] == [1, 1, 1]
    first = made.truth[0]
    assert first.label.tolist() == [Label.CAR]
    assert first.observable.tolist() == [True]
    np.testing.assert_allclose(first.size, [[4.1, 1.65, 1.55]])
    # x right 1.2, y down 1.7, z forward 22, bottom face: 0.775 m higher is the centre.
    np.testing.assert_allclose(first.position, [[22.0, -1.2, -1.7 + 0.775]])
    # ry = -1.55: the length axis points to (cos, 0, -sin) = (.02, 0, 1): nearly ahead.
    np.testing.assert_allclose(first.yaw, [-math.pi / 2 + 1.55])
    # Frame 1: the camera looks left (its z is the first one's -x), 5 m ahead.
    np.testing.assert_allclose(made.truth[1].position, [[5.0 + 1.22, 21.7, -1.7 + 0.775]])
    np.testing.assert_allclose(made.truth[1].yaw, [1.55])
    np.testing.assert_allclose(made.detections[1].sensor_pose, [5.0, 0.0, math.pi / 2])
    np.testing.assert_allclose(made.detections[0].raw_score, [9.8])
    assert 0.99 < made.detections[0].score[0] < 1.0
    np.testing.assert_allclose([f.time for f in made.truth], [0.0, 0.1, 0.2])
    assert made.origin is None
    assert made.object_name == {0: "0"}


def test_a_changed_file_is_read_again(folder):
    """What has not changed is not; a line less tells, and so does a value of the same length."""
    path, made = folder / "label_02" / "0000.txt", dataset(folder)
    text, before = path.read_text(), made.objects("0000")
    assert made.objects("0000") is before
    path.write_text(text.replace(" 22.0", " 23.0", 1))
    assert made.objects("0000").bottom[0, 2] == before.bottom[0, 2] + 1
    path.write_text(text[: text.index("2 0 Car")])
    assert len(made.objects("0000")) == 2


def test_without_poses_the_camera_is_the_world(folder):
    made = dataset(folder, poses=None).recording("0000")
    np.testing.assert_allclose(made.truth[2].position, [[21.4, -1.24, -1.7 + 0.775]])
    np.testing.assert_allclose(made.detections[2].sensor_pose, [0, 0, 0])


def test_without_truth_no_label_is_read(folder):
    shutil.rmtree(folder / "label_02")
    made = dataset(folder).recording("0000", truth=False)
    assert [len(frame) for frame in made.truth] == [0, 0, 0]
    assert [len(frame) for frame in made.detections] == [1, 1, 1]


def test_poses_of_the_inertial_unit(folder):
    """The unit turns yaw = -1.2, -1.199, -1.198 rad on one spot, but for 0.11 m to the north."""
    made = dataset(folder, poses=folder / "oxts").recording("0000")
    poses = np.array([frame.sensor_pose for frame in made.detections])
    np.testing.assert_allclose(np.diff(poses[:, 2]), [0.001, 0.001], atol=1e-4)
    np.testing.assert_allclose(poses[:, 2], [-1.2, -1.199, -1.198], atol=1e-3)
    # The camera sits .81 + .27 m ahead of and .32 m left of the unit.
    cos, sin = math.cos(-1.2), math.sin(-1.2)
    ahead, left = 0.81 + 0.27, -0.32
    np.testing.assert_allclose(
        poses[0, :2], [cos * ahead - sin * left, sin * ahead + cos * left], atol=0.03
    )
    north = math.radians(1e-6) * 6378137.0
    assert abs(poses[1, 1] - poses[0, 1] - north) < 0.003


def quaternion_free_rotation(rng, tilt):
    """A camera's rotation: any turn about y, and a tilt of up to `tilt` about x and z."""
    a, b, c = rng.uniform(-math.pi, math.pi), *rng.uniform(-tilt, tilt, 2)
    ry = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    rx = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return ry @ rx @ rz


def write_random(root, rng, frames=6, tilt=0.0, decimals=15):
    """Labels, detections and poses drawn at random."""
    labels, detections, poses = [], [], []
    for k in range(frames):
        matrix = np.column_stack([quaternion_free_rotation(rng, tilt), rng.normal(0, 100, 3)])
        poses.append(" ".join(f"{v:.{decimals}f}" for v in matrix.ravel()))
        for i in range(5):
            h, w, length = rng.uniform(0.5, 5, 3)
            x, y, z = rng.uniform(-3, 3), rng.uniform(0, 2), rng.uniform(10, 60)
            ry = rng.uniform(-math.pi, math.pi)
            box = "100 100 200 200"
            numbers = " ".join(f"{v:.9f}" for v in (h, w, length, x, y, z, ry))
            kind = ("Car", "Pedestrian", "Cyclist")[i % 3]
            labels.append(f"{k} {i} {kind} 0 {i % 3} 0.1 {box} {numbers}")
            code = {"Car": 2, "Pedestrian": 1, "Cyclist": 3}[kind]
            numbers = numbers.replace(" ", ",")
            detections.append(f"{k},{code},{box.replace(' ', ',')},{i - 1.5},{numbers},0.1")
    (root / "label_02" / "0000.txt").write_text("\n".join(labels) + "\n")
    (root / "detections" / "0000.txt").write_text("\n".join(detections) + "\n")
    (root / "pose" / "0000.txt").write_text("\n".join(poses) + "\n")


def as_tracks(made):
    """The truth as a tracker would report it."""
    steps = [
        Tracks(
            time=frame.time,
            id=[int(made.object_name[i]) for i in frame.id.tolist()],
            position=frame.position,
            size=frame.size,
            yaw=frame.yaw,
            velocity=frame.velocity,
            score=np.full(len(frame), 0.25),
            label=frame.label,
        )
        for frame in made.truth
    ]
    return TrackSequence(steps=steps, frame=np.arange(len(steps)))


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(5))
def test_round_trip_dataset_world_dataset(folder, tmp_path, seed, tilt):
    rng = np.random.default_rng(seed)
    write_random(folder, rng, tilt=tilt, decimals=6)
    source = dataset(folder)
    made = source.recording("0000")
    path = source.write("0000", as_tracks(made), tmp_path / "out")
    labels, results = source.objects("0000"), source.results("0000", path.parent)
    assert len(results) == len(labels) == 30
    for name in ("frame", "id", "type"):
        assert list(getattr(results, name)) == list(getattr(labels, name))
    np.testing.assert_allclose(results.bottom, labels.bottom, rtol=0, atol=1e-9)
    np.testing.assert_allclose(results.size, labels.size, rtol=0, atol=1e-9)
    turn = np.angle(np.exp(1j * (results.rotation_y - labels.rotation_y)))
    np.testing.assert_allclose(turn, 0, atol=1e-9)
    assert results.score.tolist() == [0.25] * 30
    assert set(results.truncated.tolist()) | set(results.occluded.tolist()) == {-1}
    back = source.read("0000", path.parent)
    for before, after in zip(as_tracks(made), back, strict=True):
        assert after.id.tolist() == before.id.tolist()
        for name in ("position", "size", "yaw", "score", "velocity"):
            np.testing.assert_allclose(
                getattr(after, name), getattr(before, name), rtol=0, atol=2e-9
            )


@pytest.mark.parametrize("seed", range(3))
def test_corners_agree_with_the_matrices_written_out(folder, seed):
    """By another road: a label's corners in the camera, through the pose matrix, into our axes;
    exact when the camera only turns about its vertical."""
    rng = np.random.default_rng(seed)
    write_random(folder, rng, tilt=0.0)
    made = dataset(folder).recording("0000")
    poses = np.loadtxt(folder / "pose" / "0000.txt").reshape(-1, 3, 4)
    for line in (folder / "label_02" / "0000.txt").read_text().splitlines():
        tokens = line.split()
        k, i = int(tokens[0]), int(tokens[1])
        h, w, length, x, y, z, ry = map(float, tokens[10:])
        along = np.array([length, length, -length, -length]) / 2
        across = np.array([w, -w, -w, w]) / 2
        bottom = np.array(
            [
                x + along * np.cos(ry) + across * np.sin(ry),
                np.full(4, y),
                z - along * np.sin(ry) + across * np.cos(ry),
            ]
        )
        world = poses[k, :, :3] @ np.hstack([bottom, bottom - [[0], [h], [0]]]) + poses[k, :, 3:]
        world = np.array([world[2], -world[0], -world[1]]).T
        truth = made.truth[k]
        row = truth.id.tolist().index(i)
        c, s = np.cos(truth.yaw[row]), np.sin(truth.yaw[row])
        local = (world - truth.position[row]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        np.testing.assert_allclose(np.abs(local), np.tile(truth.size[row] / 2, (8, 1)), atol=1e-9)
        # The front is where ry points: the first two corners of bottom and top.
        assert (local[[0, 1, 4, 5], 0] > 0).all()
        assert (local[:4, 2] < 0).all()


def test_image_boxes_by_hand(folder):
    """f = 700, centre (600, 180); a unit cube 10 m ahead spans 700/9.5 pixels of its near face."""
    calibration = read_calibration(folder / "calib" / "0000.txt")
    cube = np.array([[(i & 1) - 0.5, (i >> 1 & 1) - 0.5, (i >> 2) - 0.5] for i in range(8)])
    half = 0.5 * 700 / 9.5
    (ahead,) = image_boxes((cube + np.array([0, 0, 10]))[None], calibration)
    np.testing.assert_allclose(ahead, [600 - half, 180 - half, 600 + half, 180 + half])
    behind, beside, above = image_boxes(
        np.stack([cube - [0, 0, 10], cube + np.array([60, 0, 10]), cube + np.array([0, -9, 10])]),
        calibration,
    )
    assert behind is None
    assert beside is None
    assert above is None
    (around,) = image_boxes((cube * 4)[None], calibration)
    assert around.tolist() == [0, 0, 1223, 369]
    (cut,) = image_boxes((cube + np.array([-8, 0, 10]))[None], calibration)
    np.testing.assert_allclose(cut[[0, 2]], [0, 600 - 7.5 * 700 / 10.5])
    # 10 m long, beside the camera from 2 to 3 m to the right: it leaves the image on that side.
    (passing,) = image_boxes((cube * [1, 1, 10] + np.array([2.5, 0, 0]))[None], calibration)
    np.testing.assert_allclose(passing, [600 + 2 * 700 / 5, 0, 1223, 369])


def test_image_boxes_are_of_the_colour_camera(folder):
    """It stands 0.06 m to the left of camera 0: 40 pixel metres to the right for each point."""
    path = folder / "calib" / "0000.txt"
    path.write_text(path.read_text().replace("P2: 700 0 600 0", "P2: 700 0 600 40"))
    cube = np.array([[(i & 1) - 0.5, (i >> 1 & 1) - 0.5, (i >> 2) - 0.5] for i in range(8)])
    (box,) = image_boxes((cube + np.array([0, 0, 10]))[None], read_calibration(path))
    np.testing.assert_allclose(box[[0, 2]], [600 - 310 / 9.5, 600 + 390 / 9.5])


def test_tracks_outside_the_image_are_left_out(folder, tmp_path):
    source = dataset(folder)
    tracks = Tracks(
        time=0.0,
        id=[1, 2],
        position=[[20.0, -20 * math.tan(0.1), 0], [-20.0, 0, 0]],
        size=np.ones((2, 3)),
        yaw=np.zeros(2),
        velocity=np.zeros((2, 2)),
        score=np.ones(2),
        label=[Label.CAR, Label.CAR],
    )
    path = source.write("0000", TrackSequence(steps=[tracks], frame=[0]), tmp_path / "out")
    (line,) = path.read_text().splitlines()
    tokens = line.split()
    assert len(tokens) == 18
    assert tokens[:5] == ["0", "1", "Car", "-1", "-1"]
    # Heading 0 in the world is straight ahead of the first camera: ry = -pi/2.  Seen 0.1 rad to
    # the right of its axis, alpha = ry - 0.1.
    np.testing.assert_allclose(float(tokens[16]), -math.pi / 2)
    np.testing.assert_allclose(float(tokens[5]), -math.pi / 2 - 0.1)


def test_what_the_rules_ignore_is_not_observable(folder):
    path = folder / "label_02" / "0000.txt"
    rows = [
        "0 1 Van 0 0 0 1 1 2 2 1 1 1 0 1 20 0",
        "0 2 Car 0 3 0 1 1 2 2 1 1 1 0 1 30 0",
        "0 3 Car 1 0 0 1 1 2 2 1 1 1 0 1 40 0",
        "0 4 Car 0 2 0 1 1 2 2 1 1 1 0 1 50 0",
        "0 5 Truck 0 0 0 1 1 2 2 1 1 1 0 1 60 0",
        "0 6 Person 0 0 0 1 1 2 2 1 1 1 0 1 70 0",
    ]
    path.write_text("\n".join(rows) + "\n")
    truth = dataset(folder).recording("0000").truth[0]
    assert truth.observable.tolist() == [False, False, False, True, False]
    assert truth.visibility.tolist() == [1.0, 0.0, 1.0, 0.25, 1.0]
    cyclists = dataset(folder, classes=["Cyclist"]).recording("0000")
    assert len(cyclists.truth[0]) == 0
    assert [len(frame) for frame in cyclists.detections] == [0, 0, 0]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda root: (root / "label_02" / "0000.txt").unlink(), "no such file.*0000.txt"),
        (lambda root: (root / "pose" / "0000.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n"),
         "frame without a pose.*pose/0000.txt, frame 2"),
        (lambda root: (root / "pose" / "0000.txt").write_text("2 0 0 0 0 1 0 0 0 0 1 0\n" * 3),
         "not a rotation.*frame 0"),
        (lambda root: (root / "calib" / "0000.txt").write_text("P1: 1 2 3\n"),
         "matrix is missing.*P2.*valid names: P1"),
    ],
)  # fmt: skip
def test_missing_things_fail_closed(folder, spoil, message):
    spoil(folder)
    with pytest.raises(InputError, match=message):
        dataset(folder).recording("0000")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0 1 Caar 0 0 0 1 1 2 2 1 1 1 0 1 20 0", "unknown class.*frame 0.*type.*mean 'Car'"),
        ("0 1 Car 0 0 0 1 1 2 2 0 1 1 0 1 20 0", "frame 0, object 1, field height.*above 0"),
        ("0 1 Car 0 0 0 1 1 2 2 1 1 1 0 1 nan 0", "frame 0, object 1, field z.*finite.*'nan'"),
        ("0 1 Car 0 0 0 1 1 2 2 1 1 1 0 1e308 20 0", "object 1, field y.*1e\\+08"),
        ("0 1 Car 0 0 0 3 1 2 2 1 1 1 0 1 20 0", "image box without inside"),
        ("0 1 Car 0 0 0 1 1 2 2 1 1 1 0 1 20", "wrong length.*rows 1.*expected 17, got 16"),
        ("0 -1 Car 0 0 0 1 1 2 2 1 1 1 0 1 20 0", "track_id.*at least 0"),
        ("0.5 1 Car 0 0 0 1 1 2 2 1 1 1 0 1 20 0", "not an integer.*frame"),
        ("1_0 1 Car 0 0 0 1 1 2 2 1 1 1 0 1 20 0", "not an integer.*frame"),
        ("\n".join(2 * ["2 7 Car 0 0 0 1 1 2 2 1 1 1 0 1 20 0"]), "same id.*frame 2, object 7"),
        ("9 1 Car 0 0 0 1 1 2 2 1 1 1 0 1 20 0", "without a pose.*frame 9"),
    ],
)
def test_bad_labels_are_named(folder, row, message):
    (folder / "label_02" / "0000.txt").write_text(row + "\n")
    with pytest.raises(InputError, match=message):
        dataset(folder).recording("0000")


def test_names_are_checked(folder):
    with pytest.raises(InputError, match=r"classes.*Pedestrian"):
        dataset(folder, classes=["Pedestrain"])
    for name in ("../0000", "1", "00000", "0000.txt"):
        with pytest.raises(InputError, match="sequence"):
            dataset(folder).recording(name)
    (folder / "detections" / "0000.txt").rename(folder / "detections" / "0001.txt")
    with pytest.raises(InputError, match=r"no such file.*0000.txt.*0001.txt"):
        dataset(folder).recording("0000")
    shutil.copytree(folder / "detections", folder / "of_Cyclist")
    (folder / "of_Cyclist" / "0001.txt").rename(folder / "of_Cyclist" / "0000.txt")
    cyclists = dataset(folder, detections=str(folder / "of_{class}"), classes=["Cyclist"])
    with pytest.raises(InputError, match="unexpected class"):
        cyclists.recording("0000")


@pytest.mark.skipif("PMBM_DATA" not in os.environ, reason="PMBM_DATA is unset: no real KITTI")
class TestRealFiles:
    def source(self):
        root = Path(os.environ["PMBM_DATA"]) / "kitti"
        pattern = str(root / "detections" / "pointrcnn_{class}")
        return Kitti(root=root, detections=pattern, poses=root / "pose")

    def test_every_truth_box_comes_back(self, tmp_path):
        source = self.source()
        made = source.recording("0017")
        path = source.write("0017", as_tracks(made), tmp_path)
        labels, results = source.objects("0017"), source.results("0017", path.parent)
        row = {
            key: i
            for i, key in enumerate(zip(labels.frame.tolist(), labels.id.tolist(), strict=True))
        }
        rows = [row[key] for key in zip(results.frame.tolist(), results.id.tolist(), strict=True)]
        assert len(rows) >= 0.99 * sum(len(frame) for frame in made.truth)
        np.testing.assert_allclose(results.bottom, labels.bottom[rows], atol=1e-9)
        np.testing.assert_allclose(results.rotation_y, labels.rotation_y[rows], atol=1e-9)
        whole = labels.truncated[rows] == 0
        apart = np.abs(results.box - labels.box[rows])[whole]
        assert np.median(apart) < 1.0

    def test_parked_cars_stand_still_in_the_world(self):
        """The poses do what they are for: of the slow half of the truth the world sees speeds that
        the moving camera does not."""
        source = self.source()
        world = source.recording("0011")
        moving = Kitti(root=source.root, detections=source.detections).recording("0011")
        speed = [
            np.median(np.concatenate([np.hypot(*f.velocity.T) for f in made.truth]))
            for made in (world, moving)
        ]
        assert speed[0] < 0.5
        assert speed[1] > 3.0

    def test_origins(self):
        made = with_origins(self.source().recording("0017"))
        found = sum(len(np.unique(o[o >= 0])) for o in made.origin)
        assert found > 0.5 * sum(frame.observable.sum() for frame in made.truth)

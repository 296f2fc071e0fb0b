"""Exports of DeepLabCut, SLEAP and OpenPose: a likelihood is no coordinate, a pixel no millimetre."""

import numpy as np
import pytest
from bench_rows import write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.likelihood import likelihood_of
from softmap_edge.logs.mapping import parse_mapping

FRAMES, NAMES = 80, ("low", "mid", "tip")
LOST = [k for k in range(FRAMES) if k % 13 == 5]  # frames in which the tip is hardly found


def pictures(frames=FRAMES):
    """Places (K, 3, 2) in pixels and their likelihoods (K, 3)."""
    noise = np.random.default_rng(0)
    along, bend = np.array([0.2, 0.6, 1.0]), 60 * np.sin(np.arange(frames) / 6.4)
    places = np.stack([320 + bend[:, None] * along**2, 100 + 200 * along + 0 * bend[:, None]], 2)
    likely = 0.97 + 0.02 * noise.random((frames, 3))
    likely[[k for k in LOST if k < frames], 2] = 0.3
    return places + 0.3 * noise.normal(size=places.shape), likely


def cells(k):
    places, likely = PICTURES
    return [f"{x:.4f}" for m in range(3) for x in (*places[k, m], likely[k, m])]


PICTURES = pictures()


def deeplabcut(folder, *above):
    head = [*above, "bodyparts," + ",".join(name for name in NAMES for _ in range(3))]
    head += ["coords," + ",".join(["x,y,likelihood"] * 3)]
    return write(folder / "log.csv", head, [",".join([str(k), *cells(k)]) for k in range(FRAMES)])


SCORER = "scorer," + ",".join(["DLC_resnet50_fingershuffle1_500000"] * 9)
PERSON = "individuals," + ",".join(["robot"] * 9)


def sleap(folder):
    head = "track,frame_idx,instance.score," + ",".join(f"{n}.x,{n}.y,{n}.score" for n in NAMES)
    lines = [",".join(["track_0", str(k), "0.95", *cells(k)]) for k in range(FRAMES)]
    return write(folder / "log.csv", head, lines)


def openpose(folder):
    head = "frame," + ",".join(f"{n}_x,{n}_y,{n}_c" for n in ("Nose", "Neck", "RWrist"))
    return write(folder / "log.csv", head, [",".join([str(k), *cells(k)]) for k in range(FRAMES)])


def numbered(folder):
    head = "time,cmd_1," + ",".join(f"x{m},y{m},confidence{m}" for m in range(3))
    lines = [
        ",".join([f"{k / 30:.4f}", f"{5 * np.sin(k / 6.4):.4f}", *cells(k)]) for k in range(FRAMES)
    ]
    return write(folder / "log.csv", head, lines)


MAKERS = [
    deeplabcut,
    lambda folder: deeplabcut(folder, SCORER),
    lambda folder: deeplabcut(folder, SCORER, PERSON),
    sleap,
    openpose,
    numbered,
]


def read(path, old="", new=""):
    text = guess_mapping([path]).text
    assert old in text
    return import_logs([path], parse_mapping(text.replace(old, new), path))


@pytest.mark.parametrize("make", MAKERS)
def test_a_likelihood_decides_what_was_seen(tmp_path, make):
    path = make(tmp_path)
    guess = guess_mapping([path])
    assert any("are likelihoods, not coordinates" in line for line in guess.assumed)
    assert any("the mm of one pixel" in line for line in guess.unknown)
    assert 'unit = "px", scale = 1.0' in guess.text and 'block = "' not in guess.text
    done = read(path)
    seen = np.isfinite(done.run.markers).all(axis=2)
    assert done.run.markers.shape == (FRAMES, 3, 3) and seen[:, :2].all()
    assert np.flatnonzero(~seen[:, 2]).tolist() == LOST
    assert any(f"{len(LOST)} of 240 places with a likelihood below 0.6" in n for n in done.notes)
    assert any("pixels, which are not mm" in doubt for doubt in done.doubts)


@pytest.mark.parametrize("make", MAKERS)
def test_the_mm_of_a_pixel_and_the_limit_are_the_users(tmp_path, make):
    path = make(tmp_path)
    raw = read(path).run.markers
    done = read(path, "scale = 1.0", "scale = 0.5")
    spans = [
        np.ptp(np.nan_to_num(run[:, 1] - run[0, 1]), axis=0) for run in (raw, done.run.markers)
    ]
    assert spans[1] == pytest.approx(0.5 * spans[0])
    assert not any("pixel" in doubt for doubt in done.doubts)
    done = read(path, "least_likelihood = 0.6", "least_likelihood = 0.25")
    assert np.isfinite(done.run.markers).all()
    with pytest.raises(RunError, match="no place has a likelihood of 1.2 or more .* is 0.99"):
        read(path, "least_likelihood = 0.6", "least_likelihood = 1.2")


@pytest.mark.parametrize("always", ["1.0", "0.99", "0.3"])
@pytest.mark.parametrize("make", [deeplabcut, sleap, numbered])
def test_a_marker_of_one_likelihood_does_not_hide_the_others(tmp_path, make, always):
    """A word names the likelihoods, so the first marker may have the same in every frame."""
    path = make(tmp_path)
    column = 2 + path.read_text().splitlines()[-1].split(",").index(cells(FRAMES - 1)[0])
    lines = [line.split(",") for line in path.read_text().splitlines()]
    for cell in lines:
        if cell[column].startswith("0."):
            cell[column] = always
    path.write_text("\n".join(map(",".join, lines)) + "\n")
    guess = guess_mapping([path])
    assert any("are likelihoods, not coordinates" in line for line in guess.assumed)
    assert 'unit = "px"' in guess.text
    done = read(path)
    seen = np.isfinite(done.run.markers).all(axis=2)
    assert np.flatnonzero(~seen[:, 2]).tolist() == LOST
    assert seen[:, 0].all() == (float(always) > 0.6)


@pytest.mark.parametrize("name", ["tip_{} [px]", "tip_{}_px", "tip_{} (pixels)"])
def test_places_in_pixels_without_a_likelihood(tmp_path, name):
    head = ",".join(["time", "cmd_1", name.format("x"), name.format("y")])
    lines = [
        ",".join([f"{k / 30:.4f}", f"{5 * np.sin(k / 6.4):.4f}", *cells(k)[6:8]])
        for k in range(FRAMES)
    ]
    path = write(tmp_path / "log.csv", head, lines)
    guess = guess_mapping([path])
    assert any("the mm of one pixel: the log states px" in line for line in guess.unknown)
    assert any("pixels, which are not mm" in doubt for doubt in read(path).doubts)


def test_a_pressure_is_no_likelihood(tmp_path):
    head = "time,cmd_1,tip_x,tip_y,tip_p"
    lines = [
        ",".join(
            [f"{k / 30:.4f}", f"{np.sin(k):.3f}", *cells(k)[6:8], f"{0.3 + 0.3 * np.sin(k):.3f}"]
        )
        for k in range(FRAMES)
    ]
    text = guess_mapping([write(tmp_path / "log.csv", head, lines)]).text
    assert "likelihood" not in text and 'unit = "px"' not in text


@pytest.mark.parametrize("letter", ["p", "c"])
@pytest.mark.parametrize(
    ("axes", "place"),
    [
        ("xyz", lambda k: (10 + 5 * np.sin(k / 9), 30 + 4 * np.cos(k / 9), 90.0 + np.sin(k / 9))),
        ("xyz", lambda k: (300 + 40 * np.sin(k / 9), 200 + 30 * np.cos(k / 9), 400.0)),
        ("xy", lambda k: (20 * np.sin(k / 9), 80 + 9 * np.cos(k / 9))),
    ],
)
@pytest.mark.parametrize("value", [lambda k: 0.8 + 0.15 * np.sin(k / 15), lambda k: k % 50 < 40])
def test_a_letter_of_places_that_are_no_pixels_is_no_likelihood(
    tmp_path, letter, axes, place, value
):
    names = [f"tip_{axis}" for axis in axes]
    head = ",".join(["time", "cmd_1", *names, f"tip_{letter}"])
    lines = [
        ",".join(f"{x:.3f}" for x in (k / 30, np.sin(k / 9), *place(k), value(k)))
        for k in range(FRAMES)
    ]
    path = write(tmp_path / "log.csv", head, lines)
    guess = guess_mapping([path])
    assert "likelihood" not in guess.text and 'unit = "px"' not in guess.text
    assert any(f"tip_{letter}" in line for line in guess.unknown)
    assert read(path).run.frames == FRAMES


def test_two_bodies_in_columns_and_in_rows(tmp_path):
    lines = [",".join([str(k), *cells(k)]) for k in range(FRAMES)]
    bodies = "individuals," + ",".join(["robot"] * 6 + ["rat"] * 3)
    parts = "bodyparts," + ",".join(n for n in ("mid", "tip", "mid") for _ in range(3))
    head = [SCORER, bodies, parts, "coords," + ",".join(["x,y,likelihood"] * 3)]
    text = guess_mapping([write(tmp_path / "log.csv", head, lines)]).text
    assert '["robot.mid.x", "robot.mid.y"]' in text and '["rat.mid.x", "rat.mid.y"]' in text
    path = sleap(tmp_path)
    rows = path.read_text().splitlines()
    both = [row for line in rows[1:] for row in (line, line.replace("track_0", "track_1"))]
    unknown = guess_mapping([write(tmp_path / "two.csv", rows[0], both)]).unknown
    assert any("which body is the robot" in line and "track_1" in line for line in unknown)


@pytest.mark.parametrize(
    ("place", "names", "found"),
    [
        (["tip_x", "tip_y"], ["tip_x", "tip_y", "tip_p"], "tip_p"),
        (["x1", "y1", "z1"], ["score2", "score1"], "score1"),
        (["tip.x", "tip.y"], ["mid.score", "tip.scores"], None),
        (["x", "y"], ["x", "y", "c"], None),
    ],
)
def test_the_likelihood_has_the_name_of_its_place(place, names, found):
    assert likelihood_of(place, names) == found


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("least_likelihood = 0.5", "least_likelihood without likelihood"),
        ('likelihood = ["a", "b"]', "expected 1 columns, one for each marker"),
        ("likelihood = [true]", "expected 1 columns"),
        ('likelihood = ["a"], least_likelihood = -1', "least_likelihood = -1, expected 0"),
    ],
)
def test_likelihoods_without_sense_are_one_error(tmp_path, keys, said):
    text = f"""schema = "softmap.mapping/1"
[[log]]
time = {{ column = "t" }}
markers = {{ columns = [["x", "y"]], {keys} }}
"""
    with pytest.raises(RunError) as fault:
        parse_mapping(text, tmp_path / "map.toml")
    assert said in str(fault.value)

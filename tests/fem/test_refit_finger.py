"""`softmap model refit --finger`: what the finger's own numbers are, as far as a run shows them."""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge.cli import main
from softmap_edge.errors import SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.fit import fit_finger, moved
from softmap_edge.fem.simulator import Simulator, tour
from softmap_edge.run.run import Run

HANGING, LEANING = [0.0, 0.0, 1.0], [0.7, 0.0, 0.714]
BOUNDS = (("young_mpa", (0.05, 1.0)), ("cable_stiffness_n_mm", (2.0, 100.0)))
FINGER = Finger.builtin().replace(core=2, layers=10, bounds=BOUNDS)
MOUNT = np.array([0.02, -0.03, 0.01, 0.5, -0.4, 0.3])  # rad, mm
PERIOD, MOVE, HOLD = 0.1, 20, 30  # s, samples


def record(
    true, orientations=(HANGING, LEANING), places=12, reach=9.0, seed=0, noise=0.2, load=None
):
    """A run of dwells on a simulated finger, seen in a frame that is turned and shifted."""
    rng = np.random.default_rng(seed)
    template = Simulator(FINGER).template
    solver = Simulator(true, template)
    command, gravity, seen, points, last = [], [], [], [], np.zeros(2)
    force = np.zeros(3)
    for g in orientations:
        if load is not None:
            force = load * 9.80665e-3 * np.array(g)
        u = rng.uniform(-reach, reach, (places, 2))
        order = tour(u)
        shapes = np.empty((places, *template.vertices.shape))
        shapes[order] = solver.path(u[order], gravity=g, load=force)
        for place, shape in zip(u, shapes):
            command += [last + (place - last) * i / MOVE for i in range(MOVE)] + [place] * HOLD
            gravity += [g] * (MOVE + HOLD)
            seen += [(len(command) + back) * PERIOD for back in (-12, -7, -2)]
            points += [moved(shape + noise * rng.normal(size=shape.shape), MOUNT) for _ in range(3)]
            last = place
    t = PERIOD * np.arange(len(command))
    loads = None if load is None else np.full(len(t), load)
    return Run(
        t,
        np.array(command),
        np.array(seen),
        vertices=np.array(points),
        gravity=np.array(gravity),
        load=loads,
    )


@pytest.mark.long
def test_modulus_cable_and_frame_are_found_within_their_deviations():
    true = {"young_mpa": 0.33, "cable_stiffness_n_mm": 9.0}
    found = fit_finger(FINGER, record(FINGER.replace(**true)))
    for name, value in true.items():
        number = found.numbers[name]
        assert number.value == pytest.approx(value, rel=0.03) and not number.at_bound
        assert abs(number.value - value) < 5 * number.sigma
    placed = np.array([n.value for n in found.mount.values()])
    assert np.allclose(placed, np.r_[np.degrees(MOUNT[:3]), MOUNT[3:]], atol=0.1)
    assert found.finger_fitted_mm < 0.15 < 0.4 < found.frame_fitted_mm < found.as_it_was_mm
    assert found.finger.young_mpa == found.numbers["young_mpa"].value


@pytest.mark.long
def test_pretension_and_slack_are_distinguished_from_stiffness():
    finger = FINGER.replace(bounds=(("young_mpa", (0.05, 1.0)), ("pretension_mm", (-2.0, 3.0))))
    for pretension in (1.2, -0.8):
        found = fit_finger(finger, record(finger.replace(young_mpa=0.3, pretension_mm=pretension)))
        assert found.numbers["pretension_mm"].value == pytest.approx(pretension, abs=0.05)
        assert found.numbers["young_mpa"].value == pytest.approx(0.3, rel=0.03)


def test_a_single_shape_fits_the_modulus_alone():
    """A block under its own weight: one shape does not separate the camera's frame from the
    stiffness, and says so.
    """
    text = """name = "beam"
        [block]
        size_mm = [30.0, 30.0, 100.0]
        cells = [3, 3, 10]
        [material]
        young_mpa = 0.25
        poisson = 0.47
        density_kg_m3 = 1070.0
        [mounting]
        gravity_g = [-1.0, 0.0, 0.0]
        [fit]
        young_mpa = [0.1, 0.6]"""
    beam = Finger.from_toml(text)
    template = Simulator(beam).template
    shape = Simulator(beam.replace(young_mpa=0.28), template).path(np.zeros((1, 0)))
    t = np.arange(0.0, 4.0, 0.1)
    seen = shape + 0.1 * np.random.default_rng(0).normal(size=(len(t), *shape.shape[1:]))
    run = Run(t, np.zeros((len(t), 0)), t, vertices=seen, gravity=[-1.0, 0.0, 0.0])
    found = fit_finger(beam, run)
    assert found.numbers["young_mpa"].value == pytest.approx(0.28, rel=0.02)
    assert not found.mount and found.finger_fitted_mm is None and "no dwell was left" in str(found)


@pytest.mark.long
def test_deviations_are_honest():
    """Over many draws the true modulus lies where the deviations say: not always inside one, hardly
    outside three.
    """
    true = FINGER.replace(young_mpa=0.3)
    finger = FINGER.replace(bounds=BOUNDS[:1])
    z = []
    for seed in range(6):
        number = fit_finger(finger, record(true, places=5, seed=seed, noise=0.5)).numbers[
            "young_mpa"
        ]
        z.append((number.value - 0.3) / number.sigma)
    assert np.sqrt(np.mean(np.square(z))) < 2.0
    assert np.max(np.abs(z)) > 0.1


def test_what_a_run_does_not_show_is_kept_and_reported():
    """A finger that hardly moves in one orientation says nothing about its stiffness."""
    still = fit_finger(
        FINGER, record(FINGER.replace(young_mpa=0.3), [HANGING], places=4, reach=0.1, noise=5.0)
    )
    for number in still.numbers.values():
        assert (
            number.sigma is None
            and number.value == number.start
            and "not identifiable" in number.note
        )
    assert still.finger == FINGER and "not identifiable" in str(still)


def test_one_orientation_shows_a_ratio():
    """Tendon shortening against the cable's own stretch: modulus and cable stiffness are seen only
    together.
    """
    true = FINGER.replace(young_mpa=0.33, cable_stiffness_n_mm=9.0)
    found = fit_finger(FINGER, record(true, [HANGING], places=20))
    assert found.together and set(found.together[0][:2]) == set(dict(BOUNDS))
    assert found.numbers["young_mpa"].value / found.numbers[
        "cable_stiffness_n_mm"
    ].value == pytest.approx(0.33 / 9, rel=0.05)


@pytest.mark.long
def test_markers_and_a_known_load(tmp_path, capsys):
    """Through the command, from markers on the surface and 20 g on the tip that the run
    declares.
    """
    run = record(FINGER.replace(young_mpa=0.33), places=8, load=20.0)
    some = np.arange(5, len(Simulator(FINGER).template.vertices), 17)
    rest = Simulator(FINGER).template.vertices[some]
    seen = run.vertices[:, some].copy()
    visible = np.ones(seen.shape[:2], bool)
    visible[::4, 3] = False
    seen[~visible] = np.nan
    run = replace(run, vertices=None, markers=seen, marker_rest=rest, visible=visible)
    run.save(tmp_path / "run.npz")
    (tmp_path / "finger.toml").write_text(FINGER.to_toml())
    new = tmp_path / "new.toml"
    assert (
        main(
            [
                "model",
                "refit",
                str(tmp_path / "run.npz"),
                "--finger",
                str(tmp_path / "finger.toml"),
                "--out",
                str(new),
            ]
        )
        == 0
    )
    assert "young_mpa" in capsys.readouterr().out
    assert Finger.load(new).young_mpa == pytest.approx(0.33, rel=0.05)
    assert Finger.load(new).bounds == BOUNDS
    template = ["--finger", str(tmp_path / "finger.toml"), "--out", str(tmp_path / "finger.toml")]
    # its comments would be lost
    assert main(["model", "refit", str(tmp_path / "run.npz"), *template]) == 2
    assert "stands there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda f, r: (f.replace(bounds=()), r), "no \\[fit\\] table"),
        (lambda f, r: (f, r.at(np.arange(0))), "never stands still"),
        (lambda f, r: (f, replace(r, vertices=r.vertices[:, :100])), "another template"),
        (lambda f, r: (f, replace(r, command=r.command[:, :1])), "1 commands a sample"),
        (lambda f, r: (f, replace(r, command_unit="deg")), "are in deg, .* takes mm"),
        (lambda f, r: (f, replace(r, vertices=None)), "neither"),
        (lambda f, r: (f, replace(r, vertices=None, markers=r.vertices[:, :5])), "marker_rest"),
    ],
)
def test_wrong_input_is_reported(spoil, match):
    with pytest.raises(SoftmapError, match=match):
        fit_finger(*spoil(FINGER, record(FINGER, [HANGING], places=2, reach=1.0)))

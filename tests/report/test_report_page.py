"""The page of a report: it is complete, loads nothing, trusts no input, and its pictures show what
they should.
"""

import copy
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from leaning_triangle import markers_of, record
from markupsafe import escape
from report_documents import DIAGNOSIS, compared, page

from softmap_edge.cli import main
from softmap_edge.comparison.comparison import compare
from softmap_edge.comparison.series import series
from softmap_edge.errors import ReportError
from softmap_edge.report.html import write_html

pair = pytest.fixture(scope="module")(compared)


@pytest.fixture
def without_pictures(monkeypatch):
    """Leave out the pictures, which take a second a page, where the words alone are tested."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)


def test_page_holds_pictures_and_loads_nothing(pair, tmp_path):
    run, worse, better, before, after = pair
    text = page(
        write_html(tmp_path / "page.html", [before, after], DIAGNOSIS, series(run, worse, better))
    )
    assert text.count("data:image/") == 7  # loop, sheet, where, ladder, time, body, tip
    outside = re.sub(r'src="data:image/[^"]*"', "", text)
    assert not re.search(r"https?://|<script|<link|<iframe|url\(|@import|\bon\w+=", outside)
    assert "default-src 'none'" in outside
    assert "held out" in outside and "3.46 mm" in outside and "0.621 ± 0.013 mm" in outside
    assert str(tmp_path) not in text


@pytest.mark.usefixtures("without_pictures")
def test_the_page_says_once_where_its_error_was_measured_and_shows_no_empty_column(pair, tmp_path):
    run, worse, _, before, _ = pair
    text = page(
        write_html(tmp_path / "page.html", before, DIAGNOSIS, series(run, worse, kind="measured"))
    )
    assert text.count("whether this run took part in a fit") == 1
    assert "1.82 / –" not in text and "fitted / held out" not in text
    judged = copy.deepcopy(DIAGNOSIS)
    judged["effects"][0]["displacement_mm"]["held_out"] = 1.5
    text = page(
        write_html(tmp_path / "page.html", before, judged, series(run, worse, kind="measured"))
    )
    assert "1.82 / 1.50" in text


@pytest.mark.usefixtures("without_pictures")
def test_a_diagnosis_has_one_error_before_and_after_at_the_top_and_one_floor(pair, tmp_path):
    """The error of all points is another number; its part says of which data, and why."""
    run, worse, better, before, after = pair
    on = copy.deepcopy(DIAGNOSIS)
    on["error"]["held_out_on"] = "blocks of the run that was fitted"
    for kind, title in (("fitted", "The fitted run"), ("held out", "Validation")):
        given = series(run, worse, better, kind=kind)
        text = page(write_html(tmp_path / "page.html", [before, after], on, given))
        cards = re.findall(r'<div class="card \w+"><b>([^<]*)</b><span>([^<]*)</span>', text)
        assert cards == [
            ("2.41 mm", "held-out error before"),
            ("0.930 mm", "held-out error after"),
            ("67 %", "of the removable error gone"),
            ("0.210 mm", "floor"),
        ]
        (part,) = re.findall(rf"<h2>{title}: all points[^<]*</h2>\s*<p[^>]*>([^<]*)</p>", text)
        assert "Error before 3.46 mm RMS, after 0.357 mm RMS" in part
        assert "The noise of one point is " in part
        assert "The numbers at the top are of blocks of the run that was fitted." in part
        assert "middles of the body&#39;s sections, which have less noise" in part
        assert "Noise floor" not in text and "is another limit" not in part


@pytest.mark.usefixtures("without_pictures")
def test_a_floor_that_is_known_stands_for_the_noise(pair, tmp_path):
    run, worse, better, before, after = pair
    floor = 0.5 * after.error["rms_mm"]
    given = series(run, worse, better)
    text = page(
        write_html(tmp_path / "page.html", [before, after], None, given, (floor, "the twin"))
    )
    old, new = before.error["rms_mm"], after.error["rms_mm"]
    assert f"<b>{100 * (old - new) / (old - floor):.0f} %</b>" in text and "<i>the twin</i>" in text


def test_a_floor_that_is_an_upper_bound_is_called_one(pair, tmp_path):
    from softmap_edge.report.figures import over_time

    run, worse, _, before, _ = pair
    t = np.arange(0, 30.0, 0.02)
    moving = record(
        t, np.column_stack([10 * np.sin(t), 8 * np.cos(0.7 * t)]), np.arange(0, 3, 0.1), noise=0.05
    )
    bare = markers_of(worse)
    for model, on, bound in ((worse, run, False), (bare, moving, True)):
        found, seen = compare(model, on), series(on, model)
        text = page(write_html(tmp_path / f"{bound}.html", found, None, seen))
        assert (
            ("the camera&#39;s noise is at most " in text)
            == (b"camera noise: at most" in over_time(seen))
            == bound
        )
        assert f"<i>noise, RMS; {escape(found.floor_kind)}</i>" in text
        assert ("upper bound" in text) == ("<b>≤ " in text) == bound


def test_no_label_of_a_condition_is_cut_off(monkeypatch):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from softmap_edge.report import figures

    drawn = []
    monkeypatch.setattr(figures, "svg", lambda figure: drawn.append(figure) or b"")
    labels = ("gravity +0.52 +0.24 +0.82", "gravity −0.52 −0.24 −0.82", "u1 −12.5 … −8.75 deg")
    rows = [{"label": label, "low": None, "high": None, "n": 5, "rms_mm": 1.0} for label in labels]
    figures.where_maps({"orientation": rows, "command": rows, "time": rows, "section": rows}, None)
    canvas = FigureCanvasAgg(drawn[0])
    canvas.draw()
    panels = drawn[0].axes
    for k, axes in enumerate(panels):
        shown = axes.get_yticklabels()
        assert [label.get_text() for label in shown] == list(labels)
        boxes = [label.get_window_extent(canvas.get_renderer()) for label in shown]
        assert min(box.x0 for box in boxes) >= 0
        for other in panels[:k]:  # nor runs into the bars of the panel to its left
            if abs(other.get_position().y0 - axes.get_position().y0) < 0.01:
                right = other.get_window_extent(canvas.get_renderer()).x1
                assert (
                    right <= axes.get_window_extent().x0 and min(box.x0 for box in boxes) >= right
                )


def test_a_narrow_page_scrolls_its_tables_and_breaks_no_word():
    """`anywhere` lets a column of a table shrink to one letter; `break-word` does not."""
    from softmap_edge.report.pages import TEMPLATES

    style = (TEMPLATES / "style.css").read_text(encoding="utf-8")
    for line in style.splitlines():
        assert "anywhere" not in line or line.startswith("pre "), line
    assert "section { overflow-x: auto;" in style and "minmax(min(420px, 100%), 1fr)" in style


def test_same_input_gives_the_same_page(pair, tmp_path):
    run, worse, _, before, _ = pair
    first = write_html(tmp_path / "a.html", before, None, series(run, worse))
    second = write_html(tmp_path / "b.html", before, None, series(run, worse))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.usefixtures("without_pictures")
def test_a_fitted_run_is_called_fitted(pair, tmp_path):
    run, worse, _, before, _ = pair
    assert "fitted: this run took part" in page(
        write_html(tmp_path / "p.html", before, series=series(run, worse, kind="fitted"))
    )


def test_markers_have_a_page_too(pair, tmp_path):
    run, worse, better, _, _ = pair
    one, two = markers_of(worse), markers_of(better)
    text = page(
        write_html(
            tmp_path / "m.html", [compare(one, run), compare(two, run)], None, series(run, one, two)
        )
    )
    assert text.count("data:image/png") == 2  # sheet and body


def test_hostile_names_stay_text(pair, tmp_path):
    run, worse, _, _, _ = pair
    evil = '<script>alert("x")</script>\ud800 $\\frac{1}{0}$ \x00 机器人'
    named = replace(worse, robot=evil)
    document = copy.deepcopy(DIAGNOSIS)
    document["sentence"] = document["effects"][0]["name"] = document["error"]["ladder"][0][
        "added"
    ] = evil
    document["where"]["before"]["speed"][0]["label"] = evil
    document["alternatives"][0]["why"] = document["error"]["kind"] = document["made_from"][
        "seed"
    ] = evil
    text = page(
        write_html(tmp_path / "evil.html", compare(named, run), document, series(run, named))
    )
    assert "<script" not in text and "&lt;script&gt;" in text
    text = page(write_html(tmp_path / "diagnosis.html", None, document))
    assert "<script" not in text


def test_what_a_page_needs(pair, tmp_path):
    before = pair[3]
    with pytest.raises(ReportError, match="nothing to show"):
        write_html(tmp_path / "p.html")
    with pytest.raises(ReportError, match="3 comparisons"):
        write_html(tmp_path / "p.html", [before] * 3)


def test_without_matplotlib_the_page_has_all_but_pictures_and_says_how_to_get_them(pair, tmp_path):
    code = (
        "import sys; sys.modules['matplotlib'] = None\nfrom report_documents import DIAGNOSIS, "
        "compared\nfrom softmap_edge.comparison.series import series\nfrom "
        "softmap_edge.report.html import write_html\nrun, worse, better, before, after = "
        f"compared()\nwrite_html({str(tmp_path / 'bare.html')!r}, [before, after], DIAGNOSIS, "
        "series(run, worse, better))\n"
    )
    here = Path(__file__).parents[1] / "support"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(here), str(here.parents[1])])}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    bare = page(tmp_path / "bare.html")
    assert (
        bare.count("pip install &#39;softmap-edge[report]&#39;") == 1 and "data:image" not in bare
    )
    run, worse, better, before, after = pair
    full = page(
        write_html(tmp_path / "full.html", [before, after], DIAGNOSIS, series(run, worse, better))
    )
    assert "pip install" not in full
    drawn = re.compile(
        r"<section><h2>[^<]*</h2>\s*<img .*?</section>|<section><h2>Pictures</h2>.*?</section>",
        re.S,
    )
    assert drawn.sub("", full).split() == drawn.sub("", bare).split()


@pytest.mark.parametrize(
    "argv",
    [
        ["track", "S", "--plan", "--picture", "{}"],
        ["track", "--workspace", "--picture", "{}"],
        ["model", "calibrate", "run.npz", "--out", "b", "--plot", "{}"],
    ],
)
def test_without_matplotlib_a_picture_is_refused_before_anything_is_done(
    argv, tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)
    assert main([word.format("p.svg") for word in argv]) == 2
    assert re.search(
        r"p\.svg: pictures need matplotlib; pip install .*, or leave --\w+ out",
        capsys.readouterr().err,
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("channels", [0, 1, 2, 3])
def test_sheet_draws_poses_and_commands(pair, channels):
    """Poses carry their own errors; the plane is that of the commands that move most, a line or
    none with fewer.
    """
    from softmap_edge.report.sheet import _plane_of, sheet

    run, worse, better, *_ = pair
    found = series(run, worse, better)
    assert 1 < len(found.poses) <= 5 and found.command.shape[0] == len(run.t_seen)
    for pose in found.poses:
        assert np.sqrt(np.mean(pose.before**2)) == pytest.approx(found.before[pose.frame])
        assert np.sqrt(np.mean(pose.after**2)) == pytest.approx(found.after[pose.frame])
    size = np.array([1.0, 0.001, 3.0])[:channels]
    drawn = replace(
        found, command=size * np.random.default_rng(0).normal(size=(len(run.t_seen), channels))
    )
    assert _plane_of(drawn.command) == {0: None, 1: (0, 0), 2: (0, 0), 3: (0, 2)}[channels]
    picture = sheet(drawn)
    assert picture.startswith(b"\x89PNG") and picture == sheet(drawn)
    assert picture != sheet(replace(drawn, before=drawn.before * 1.5))


def test_of_a_long_run_the_stretch_where_the_model_is_worst_is_drawn():
    from softmap_edge.report.figures import STRETCH, worst_stretch

    t = np.arange(0.0, 300.0, 0.5)
    before = np.where((t > 200) & (t < 215), 3.0, 1.0)
    before[7] = np.nan
    rows = worst_stretch(SimpleNamespace(t_seen=t, before=before))
    assert t[rows.start] <= 200.5 and 214.5 <= t[rows.stop - 1] <= t[rows.start] + STRETCH
    whole = worst_stretch(SimpleNamespace(t_seen=t[:60], before=before[:60]))
    assert (whole.start, whole.stop) == (0, 60)

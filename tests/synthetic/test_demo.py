"""The command demo: what it prints, what it writes, and what it refuses."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import builtin_model
from softmap_edge.cli import main
from softmap_edge.commands import demo
from softmap_edge.commands.progress import QUIET, Ticker
from softmap_edge.fem.finger import Finger
from softmap_edge.robot.emulated.laws import LAWS
from softmap_edge.robot.emulated.named_laws import NAMED
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run
from softmap_edge.synthetic.finger import WATCH, HiddenEffect, Truth, hide, surprise


class Quick(Truth):
    """A second finger with the body of the model: nothing is solved for it."""

    def shapes(self, protocol, every=1):
        def body(finger, modulus, gravity, force, u):
            t = np.arange(float(len(u)))
            return builtin_model().predict(Run(t=t, command=u, t_seen=t, gravity=np.array(gravity)))

        return self.shapes_by(body, protocol, every)

    def twin(self):
        return replace(self, hidden=())


@pytest.fixture(scope="module")
def measured():
    """Run the demo's trial on a quick finger; give it with the lines that it prints."""
    play = LAWS["backlash"].draw(np.random.default_rng(4), 2)
    truth, lines = Quick(4, (HiddenEffect(play, 2.0),)), []
    return demo.trial(builtin_model(), truth, lines.append), lines


@pytest.fixture
def short(measured, monkeypatch):
    """Let the command show this trial; test_readme.py runs the complete one for its page."""
    story, lines = measured

    def shown(model, truth, say):
        for line in lines:
            say(line)
        return story

    monkeypatch.setattr(demo, "hide", lambda names, seed: {("backlash", 4): None}[*names, seed])
    monkeypatch.setattr(demo, "trial", shown)


def test_demo_prints_the_story_and_reveals_at_the_end(short, tmp_path, capsys):
    assert main(["demo", "--hide", "backlash", "--seed", "4", "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    before, reveal = text.rsplit("Hidden:", 1)
    assert "half_width_mm" in reveal
    assert "half_width_mm" not in before  # not printed earlier
    assert "Held-out error" in text
    assert str(tmp_path / "report.html") in text
    page = (tmp_path / "report.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html")
    assert 'src="http' not in page
    gone = re.search(r"(\d+) % of the removable error is gone", text)[1]
    assert f"{gone} % of the removable error is gone (floor" in page  # as the terminal counts it
    assert "the same finger with nothing hidden" in page
    assert Run.load(tmp_path / "run.npz").vertices.shape[1:] == (548, 3)
    assert main(["check", str(tmp_path / "finger2")]) == 0


def test_demo_prints_one_document(short, tmp_path, capsys):
    assert (
        main(["demo", "--hide", "backlash", "--seed", "4", "--json", "--out", str(tmp_path)]) == 0
    )
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.demo/1"
    assert [hidden["name"] for hidden in document["hidden"]] == ["backlash"]
    assert all(
        hidden["displacement_mm"] == 2.0 and hidden["params"] for hidden in document["hidden"]
    )
    assert document["diagnosis"]["schema"] == "softmap.diagnosis/2"
    assert document["before_mm"] > document["after_mm"] > 0.9 * document["floor_mm"] > 0


@pytest.mark.parametrize("hide", ["wobble", "creep,wobble", ""])
def test_unknown_hidden_effect_lists_the_known(hide, capsys, tmp_path):
    assert main(["demo", "--hide", hide, "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert all(name in said for name in [*LAWS, *NAMED, "nothing", "random"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "argv",
    [["--seed", "-1"], ["--hide", "creep,creep"], ["--hide", "creep", "creep"], ["--seed", "x"]],
)
def test_wrong_use(argv, capsys, tmp_path):
    assert main(["demo", *argv, "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.strip()


def test_a_surprise_depends_on_the_seed_alone():
    drawn = [tuple(surprise(seed)) for seed in range(40)]
    assert drawn == [tuple(surprise(seed)) for seed in range(40)]
    assert {len(names) for names in drawn} == {1, 2}
    assert {name for names in drawn for name in names} == set(LAWS)


def test_the_same_seed_hides_the_same():
    coarse = Finger.builtin().replace(core=1, layers=10)
    one, again, other = (hide(["backlash"], seed, finger=coarse) for seed in (4, 4, 5))
    assert one == again != other
    assert all(1.0 <= truth.hidden[0].displacement_mm <= 4.0 for truth in (one, other))


def test_long_work_says_that_it_goes_on():
    now, said = [0.0], []
    ticker = Ticker(said.append, lambda: now[0])
    ticker.say("Measuring …")
    for share in (0.1, 0.2, 0.3, 0.4):
        now[0] += 0.6 * QUIET
        ticker(share)
    assert said == ["Measuring …", "  … solving, 20% of this part", "  … solving, 40% of this part"]
    heard = []
    before = WATCH.set(heard.append)
    try:
        hide([], 1).shapes(standard_protocol(), every=90)
    finally:
        WATCH.reset(before)
    assert heard == sorted(heard) and heard[-1] == pytest.approx(1.0)  # over both orientations
    assert max(np.diff(heard)) < 0.5

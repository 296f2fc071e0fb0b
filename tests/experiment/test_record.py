"""docs/do/record.md as written: its commands run, its quotes are printed, its times are those of
the protocol.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filmed_markers import BASE, CAMERA, SIDES, marked
from page import blocks, lines, misquoted
from played_blocks import LIMITS, played

from softmap_edge import Run, _core, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.experiment.blocks import BLOCKS as MOVES
from softmap_edge.experiment.blocks import chosen, plan
from softmap_edge.robot.drive.command_file import read_commands
from softmap_edge.robot.emulated.published_map import PUBLISHED
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.synthetic.virtual_protocol import virtual_protocol

WEIGHT = {"payload.mass": 9.0}
PAGE = (Path(__file__).parents[2] / "docs/do/record.md").read_text(encoding="utf-8")
BLOCKS = blocks(PAGE)
PROSE = re.sub(r"^```.*?^```$", "", PAGE, flags=re.MULTILINE | re.DOTALL)


def hasty():
    """Both channels follow one another at one speed for a minute and a half, hanging, never at
    rest.
    """
    model, t = builtin_model(), np.arange(0.0, 90.0, 0.02)
    wave = 8.0 * (2 * np.abs((t / 5.0 + 0.25) % 2 - 1) - 1)
    record = {
        "t": t, "command": np.column_stack([wave, wave]), "t_seen": t[10::25], "robot": model.robot,
        "gravity": np.array([0.0, 0, 1]),
    }  # fmt: skip
    blank = np.repeat(model.rest[None], len(t[10::25]), axis=0)
    seen = model.predict(Run(**record, vertices=blank))
    return Run(**record, vertices=seen + 0.25 * np.random.default_rng(0).normal(size=seen.shape))


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Run every block and line of the page in a folder with the reader's files; give what was
    printed.
    """
    there, printed = tmp_path_factory.mktemp("record"), {}
    hasty().save(there / "hasty.npz")
    marked(3, noise=0.05, play=0.05, rest=SIDES).save(there / "camera.npz")
    marked(4, noise=0.05, play=0.05, base=BASE[:3]).save(there / "markers.npz")
    held = played(virtual_protocol("grid", 0, LIMITS))
    replace(held, command=None, ticks=PUBLISHED.to_ticks(held.command)).save(there / "ticks.npz")
    hanging = plan(
        chosen(
            [
                "home revisits",
                "triangles of growing size",
                "diagonals",
                "staircase with long dwells",
            ]
        ),
        LIMITS,
    )
    played(hanging, WEIGHT).save(there / "hanging.npz")
    played(MOVES["another orientation"].plan(LIMITS), WEIGHT, seed=1).save(there / "leaning.npz")
    save_bundle(builtin_model(), there / "finger")
    inline = [
        line for text in re.findall(r"`(softmap run align [^`]*)`", PROSE) for line in lines(text)
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        patch.setattr(
            "builtins.print",
            lambda *a, **k: printed.setdefault(words, []).append(" ".join(map(str, a))),
        )
        for language, text in [*BLOCKS, ("", "\n".join(" ".join(words) for words in inline))]:
            if language == "python":
                exec(compile(text, "docs/do/record.md", "exec"), {})
            elif language == "":
                for argv in lines(text):
                    words = " ".join(argv[1:])
                    assert main(argv[1:]) == 0, words
    return there, {name: "\n".join(parts) for name, parts in printed.items()}


@pytest.mark.long
def test_what_the_page_quotes_is_what_is_printed(page):
    """Numbers may differ by 3 %, all else is as it stands."""
    _, printed = page
    quotes = [text for language, text in BLOCKS if language == "text"]
    commands = [
        "check hasty.npz",
        "check hasty.npz --bundle finger",
        "next diagnosis.json --run hanging.npz --bundle finger --out next.csv",
    ]
    for quote, command in zip(quotes, commands, strict=True):
        reported = printed[command]
        assert misquoted(quote, reported, worded) is None
        made, shown = reported.splitlines(), quote.splitlines()
        at = [worded(line) for line in made].index(worded(shown[0]))
        found, stated = (
            np.array(re.findall(r"\d[\d.]*", " ".join(text)), float)
            for text in (made[at : at + len(shown)], shown)
        )
        np.testing.assert_allclose(found, stated, rtol=0.03)


def worded(line):
    """Return a line without its numbers."""
    return re.sub(r"[\d.]+", "#", " ".join(line.split()))


@pytest.mark.long
def test_the_doubt_of_the_page_is_settled(page):
    there, printed = page
    reported = printed[
        "diagnose hanging.npz leaning.npz --bundle finger --out settled.json --since diagnosis.json"
    ]
    assert (
        "Now       payload (identified); alternatives: none" in reported
        and "Settled   gravity" in reported
    )
    assert read_commands(there / "next.csv")[0].gravity[:, 0].max() > 0.5
    assert set(Run.load(there / "circle.npz").block) == {"home", "circle"}
    named = re.search(r"`--block` writes those that you name:(.*?)\.\n", PAGE, re.DOTALL)[1]
    assert re.findall(r"`([^`]+)`", named) == list(MOVES)


@pytest.mark.long
def test_the_aligned_runs_are_in_the_frame_of_the_base(page):
    there, _ = page
    for name in ("run.npz", "run2.npz", "other.npz"):
        run = Run.load(there / name)
        np.testing.assert_allclose(run.frame[:, :3], CAMERA.rotation, atol=0.01)
        assert run.markers.shape[1] == len(SIDES)


@pytest.mark.long
def test_the_command_file_of_the_page_is_the_protocol(page):
    there, _ = page
    made, robot = read_commands(there / "commands.csv")
    wanted = standard_protocol(2, back=True)
    assert robot == builtin_model().robot
    np.testing.assert_allclose(made.command, wanted.command, atol=1e-3)
    assert made.frames == pytest.approx(470, abs=10) and made.minutes == pytest.approx(6.0, abs=0.5)


def test_the_times_of_the_page_are_those_of_the_protocol():
    plan = standard_protocol(2)
    first = plan.t_seen < plan.t[np.any(plan.gravity != plan.gravity[0], axis=1)][0]
    labels, t = np.array([label.split("[")[0] for label in plan.block[first]]), plan.t_seen[first]
    rows = {
        "triangles": "triangle",
        "small loops": "small loop",
        "diagonals": "diagonal",
        "staircase": "staircase",
    }
    for name, label in {**rows, "fast triangles": "fast"}.items():
        stated = float(re.search(rf"\| \*\*{name}\*\*[^|]*\| (\d+) s", PAGE)[1])
        assert np.ptp(t[labels == label]) == pytest.approx(stated, abs=2.0), name


def test_every_effect_has_its_part_of_the_protocol():
    for effect in _core.effects():
        assert f"`{effect['name']}`" in PAGE, (
            f"docs/do/record.md does not say what shows {effect['name']}"
        )

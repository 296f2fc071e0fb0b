"""docs/record.md as written: its commands run, what it quotes is printed, and its times are those of the protocol."""

import re
from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines
from test_align import BASE, CAMERA, SIDES, marked

from softmap_edge import Run, _core, builtin_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.protocol import standard_protocol

PAGE = (Path(__file__).parents[1] / "docs/record.md").read_text(encoding="utf-8")
BLOCKS = blocks(PAGE)
PROSE = re.sub(r"^```.*?^```$", "", PAGE, flags=re.MULTILINE | re.DOTALL)


def hasty():
    """Both channels follow one another at one speed for a minute and a half, hanging, never at rest."""
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
    """Run every block and line of the page in a folder with the reader's files; give what was printed."""
    there, printed = tmp_path_factory.mktemp("record"), {}
    hasty().save(there / "hasty.npz")
    marked(3, noise=0.05, play=0.05, rest=SIDES).save(there / "camera.npz")
    marked(4, noise=0.05, play=0.05, base=BASE[:3]).save(there / "markers.npz")
    save_bundle(builtin_model(), there / "finger")
    inline = [line for text in re.findall(r"`(softmap align [^`]*)`", PROSE) for line in lines(text)]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        patch.setattr("builtins.print", lambda *a, **k: printed.setdefault(words, []).append(" ".join(map(str, a))))
        for language, text in [*BLOCKS, ("", "\n".join(" ".join(words) for words in inline))]:
            if language == "python":
                exec(compile(text, "docs/record.md", "exec"), {})
            elif language == "":
                for argv in lines(text):
                    words = " ".join(argv[1:])
                    assert main(argv[1:]) == 0, words
    return there, {name: "\n".join(parts) for name, parts in printed.items()}


def test_what_the_page_quotes_is_what_is_printed(page):
    """Numbers of an effect may differ in their last figure; all else is as it stands."""
    _, printed = page
    poor, effects = (text.splitlines() for language, text in BLOCKS if language == "text")
    told = printed["check hasty.npz"].splitlines()
    start = told.index(poor[0])
    assert told[start : start + len(poor)] == poor
    named, remedy = effects
    found = printed["check hasty.npz --bundle finger"].splitlines()
    line = next(k for k, text in enumerate(found) if text.startswith("  + latency"))
    assert found[line + 1] == remedy
    assert re.sub(r"[\d.]+", "#", " ".join(found[line].split())) == re.sub(r"[\d.]+", "#", " ".join(named.split()))
    said, quoted = (np.array(re.findall(r"[\d.]+", text), float) for text in (found[line], named))
    np.testing.assert_allclose(said, quoted, rtol=0.03)


def test_the_aligned_runs_are_in_the_frame_of_the_base(page):
    there, _ = page
    for name in ("run.npz", "run2.npz", "other.npz"):
        run = Run.load(there / name)
        np.testing.assert_allclose(run.frame[:, :3], CAMERA.rotation, atol=0.01)
        assert run.markers.shape[1] == len(SIDES)


def test_the_table_of_commands_is_the_protocol(page):
    there, _ = page
    table = np.loadtxt(there / "commands.csv", delimiter=",", skiprows=1)
    plan = standard_protocol(2, reach=12.0)
    np.testing.assert_allclose(table, np.column_stack([plan.t, plan.command]), atol=1e-3)
    assert plan.frames == pytest.approx(360, abs=20) and plan.t[-1] / 60 == pytest.approx(4.0, abs=0.1)


def test_the_times_of_the_page_are_those_of_the_protocol():
    plan = standard_protocol(2)
    first = plan.t_seen < plan.t[np.any(plan.gravity != plan.gravity[0], axis=1)][0]
    labels, t = np.array([label.split("[")[0] for label in plan.block[first]]), plan.t_seen[first]
    rows = {"triangles": "triangle", "small loops": "small loop", "diagonals": "diagonal", "staircase": "staircase"}
    for name, label in {**rows, "fast triangles": "fast"}.items():
        stated = float(re.search(rf"\| \*\*{name}\*\*[^|]*\| (\d+) s", PAGE)[1])
        assert np.ptp(t[labels == label]) == pytest.approx(stated, abs=2.0), name


def test_every_effect_has_its_part_of_the_protocol():
    for effect in _core.effects():
        assert f"`{effect['name']}`" in PAGE, f"docs/record.md does not say what shows {effect['name']}"

"""A user's own effect in a bundle: its file goes along, is checked, and never runs unless somebody
says so.
"""

import io
import json

import numpy as np
import pytest
from own_effects import effect, entered, forgotten, record, written

from softmap_edge import Run, builtin_model, load_bundle, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import BundleError
from softmap_edge.model.user_effect import forget_effect, load_effect, loaded

nobody_elses_library = pytest.fixture(autouse=True)(forgotten)
here = pytest.fixture(entered)

EVIL = "with open('RAN', 'a') as file:\n    file.write('x')\n"


@pytest.fixture
def evil(here):
    """A bundle of another user, whose effect would write the file RAN; its own bytes."""
    load_effect(written(here, EVIL + effect("u * (1 + by)")))
    (here / "RAN").unlink()
    save_bundle(builtin_model().with_effects(["mine"], {"mine.by": 0.2}), here / "bundle")
    forget_effect("mine")
    t, u = record()
    blank = np.repeat(builtin_model().rest[None], 10, axis=0)
    Run(t=t, command=u, t_seen=t[:10], vertices=blank).save(here / "run.npz")
    return here / "bundle"


VERBS = [
    ["check", "bundle"],
    ["show", "bundle"],
    ["show", "bundle", "--json"],
    ["check", "run.npz", "--bundle", "bundle"],
    ["model", "predict", "1,1", "--bundle", "bundle"],
    ["compare", "run.npz", "--bundle", "bundle"],
    ["diagnose", "run.npz", "--bundle", "bundle"],
    ["model", "refit", "run.npz", "--bundle", "bundle", "--out", "out"],
    ["model", "remove", "mine", "--bundle", "bundle", "--out", "out"],
    ["run", "align", "run.npz", "--bundle", "bundle", "--out", "out.npz"],
    ["next", "--standard", "--bundle", "bundle", "--out", "out.csv"],
]


@pytest.mark.parametrize("argv", VERBS, ids=" ".join)
def test_code_in_a_bundle_is_not_run_unasked(evil, here, argv, capsys, monkeypatch):
    # no terminal: not a question, not an answer
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    code = main(argv)
    said = "".join(capsys.readouterr())
    assert not (here / "RAN").exists() and not loaded()
    assert code == (0 if argv[0] == "show" else 1 if argv[0] == "check" else 2)
    assert (
        "mine" in said
        if argv[-1] == "--json" or argv[0] == "show"
        else "--effects bundle/mine.py" in said
    )
    assert "read" in said or "--json" in argv


def test_an_allowed_bundle_predicts_as_before(evil, here, capsys):
    with pytest.raises(BundleError, match="not run unasked"):
        load_bundle(evil)
    assert (
        main(
            [
                "model",
                "predict",
                "5,0",
                "--bundle",
                "bundle",
                "--json",
                "--effects",
                "bundle/mine.py",
            ]
        )
        == 0
    )
    tip = json.loads(capsys.readouterr().out)["tip_mm"]
    assert main(["model", "predict", "6,0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tip_mm"] == tip  # 5 mm and a fifth
    assert (here / "RAN").read_text() == "x"
    again = save_bundle(load_bundle(evil), here / "again")
    for file in evil.iterdir():
        assert (again / file.name).read_bytes() == file.read_bytes(), file.name
    assert (here / "RAN").read_text() == "x"  # loaded once
    assert main(["check", "bundle"]) == 0 and main(["show", "bundle"]) == 0


@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("n\n", 2), ("\n", 2), ("", 2)])
def test_a_terminal_is_asked(evil, here, answer, code, capsys, monkeypatch):
    terminal = io.StringIO(answer)
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    assert main(["model", "predict", "5,0", "--bundle", "bundle"]) == code
    err = capsys.readouterr().err
    manifest = json.loads((evil / "manifest.json").read_text())
    assert manifest["own_effects"]["mine"] in err and "bundle/mine.py" in err and "[y/N]" in err
    assert (here / "RAN").exists() == (code == 0)


def test_a_changed_copy_is_refused(evil, here):
    trusted = []
    (evil / "mine.py").write_text((evil / "mine.py").read_text() + "\n")
    with pytest.raises(BundleError, match="mine.py is not the file that the manifest names"):
        load_bundle(evil, lambda file, digest: trusted.append(file) or True)
    (evil / "mine.py").unlink()
    with pytest.raises(BundleError, match="mine.py is missing"):
        load_bundle(evil, lambda file, digest: trusted.append(file) or True)
    assert not trusted and not (here / "RAN").exists()


def rewritten(bundle, change):
    manifest = json.loads((bundle / "manifest.json").read_text())
    change(manifest)
    (bundle / "manifest.json").write_text(json.dumps(manifest))


def test_another_file_of_that_name_is_refused(evil, here):
    load_effect(written(here, effect("u * (1 - by)"), "theirs.py"))
    with pytest.raises(BundleError, match="a name stands for one file"):
        load_bundle(evil)
    rewritten(evil, lambda manifest: manifest.pop("own_effects"))
    with pytest.raises(BundleError, match="code that its manifest does not name"):
        load_bundle(evil)
    assert not (here / "RAN").exists()


@pytest.mark.parametrize("name", ["../mine", "mine/../mine", "Mine", ""])
def test_a_manifest_names_no_file_outside(evil, here, name):
    def moved(manifest):
        manifest["own_effects"] = {name: manifest["own_effects"]["mine"]}

    rewritten(evil, moved)
    with pytest.raises(BundleError, match="own_effects"):
        load_bundle(evil, lambda file, digest: True)
    assert not (here / "RAN").exists()


def test_an_effect_of_another_name_than_the_manifest_says_is_refused(evil):
    (evil / "mine.py").rename(evil / "yours.py")

    def renamed(manifest):
        manifest["own_effects"] = {"yours": manifest["own_effects"]["mine"]}

    rewritten(evil, renamed)
    with pytest.raises(BundleError, match="'yours'"):
        load_bundle(evil, lambda file, digest: True)

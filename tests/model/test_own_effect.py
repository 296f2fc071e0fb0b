"""A user's own effect: its file is checked, joins chains and fits, and says where it fails."""

import json
from pathlib import Path

import numpy as np
import pytest
from own_effects import effect, entered, forgotten, number, record, written

from softmap_edge import Run, _core, builtin_model, diagnose, refit, save_bundle
from softmap_edge.cli import main
from softmap_edge.errors import EffectError, SoftmapError
from softmap_edge.model.user_effect import forget_effect, load_effect, loaded, template

EXAMPLE = Path(__file__).parents[2] / "examples/off_centre_pulley.py"


nobody_elses_library = pytest.fixture(autouse=True)(forgotten)
here = pytest.fixture(entered)


# --- the file -------------------------------------------------------------------------------


def test_the_template_runs_as_it_is(here, capsys):
    assert main(["model", "effects", "new", "wobble"]) == 0
    assert "--effects wobble.py" in capsys.readouterr().out
    assert len((here / "wobble.py").read_text().splitlines()) <= 25
    assert main(["model", "effects", "wobble", "--effects", "wobble.py"]) == 0
    out, err = capsys.readouterr()
    assert "wobble" in out and "wobble.py is code and runs with your rights" in err
    assert main(["model", "predict", "4,0", "--effects", "wobble.py"]) == 0
    model = builtin_model().with_effects(["wobble"], {"wobble.share": 0.3})
    t, u = record()
    np.testing.assert_allclose(
        model.chain.rollout(model.chain_params[None], u, t)[0],
        u * (1 + 0.3 * np.tanh(u / 5)),
        rtol=1e-14,
    )


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["model", "effects", "new"], "wobble"),
        (["model", "effects", "new", "gain"], "already"),
        (["model", "effects", "new", "../up"], "small letters"),
        (["model", "effects", "new", "there"], "stands here already"),
        (["model", "effects", "--effects", "none.py"], "no Python file"),
        (["model", "predict", "1,1", "--effects", "gain"], "softmap model effects new"),
    ],
)
def test_wrong_use_is_reported_in_one_line(here, capsys, argv, says):
    written(here, "", "there.py")
    assert main(argv) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def rollout(:", "line 1, does not run: SyntaxError"),
        ("import numpy\n\n1 / 0", "mine.py, line 3, does not run: ZeroDivisionError"),
        ("raise SystemExit", "SystemExit"),
        ("x = 1", "EFFECT is missing"),
        (effect("u").replace("def rollout", "def other"), "no function `rollout`"),
        (effect("u", name="Mine!"), "small letters"),
        (effect("u", name="gain"), "'gain' already"),
        (effect("u", stage="shape"), "command, transmission, material"),
        (effect("u", doc=""), "doc"),
        (effect("u", doc="two\nlines"), "printable line"),
        (effect("u", colour="red"), "'colour'"),
        (effect("u", needs=["wind"]), "gravity, load, temperature"),
        (effect("u", needs=5), "needs is int"),
        (effect("u", experiment="now"), "experiment"),
        (effect("u", parameters=[]), "1 to 32"),
        (effect("u", **number(high=-2.0)), "start must lie between"),
        (effect("u", **number(null="0")), "finite number"),
        (effect("u", **number(low=float("-inf"))).replace("-inf", "-1e999"), "finite number"),
        (effect("u", **number(start=10**400)), "finite number"),
        (effect("u", **number(per_channel="yes")), "True or False"),
        (effect("u", parameters=number()["parameters"] * 2), "names must differ"),
    ],
)
def test_a_file_that_is_no_effect_says_why(tmp_path, text, says, capsys):
    before = [e["name"] for e in _core.effects()]
    with pytest.raises(SoftmapError) as fault:
        load_effect(written(tmp_path, text))
    assert says in str(fault.value) and "\n" not in str(fault.value)
    assert [e["name"] for e in _core.effects()] == before and not loaded()


def test_a_name_stands_for_one_file(tmp_path, capsys):
    file = written(tmp_path, effect("u * (1 + by)"))
    first = load_effect(file)
    assert (
        load_effect(file) is first
        and load_effect(written(tmp_path, file.read_text(), "copy.py")) is first
    )
    # the same text is not run again
    assert capsys.readouterr().err.count("runs with your rights") == 1
    other = written(tmp_path, effect("u * (1 - by)"), "other.py")
    with pytest.raises(EffectError, match="one name stands for one file"):
        load_effect(other)
    chain = _core.Chain(["mine"], 2)
    forget_effect("mine")
    with pytest.raises(SoftmapError, match="no effect 'mine'"):
        _core.Chain(["mine"], 2)
    load_effect(other)
    t, u = record()
    params = np.array([[0.5]])
    np.testing.assert_array_equal(chain.rollout(params, u, t)[0], 1.5 * u)  # what is composed stays
    np.testing.assert_array_equal(_core.Chain(["mine"], 2).rollout(params, u, t)[0], 0.5 * u)
    with pytest.raises(SoftmapError, match="no effect that was registered"):
        forget_effect("gain")


def test_a_template_of_a_taken_name_is_refused(tmp_path):
    load_effect(written(tmp_path, template("mine")))
    with pytest.raises(EffectError, match="already"):
        template("mine")


# --- the law --------------------------------------------------------------------------------


def test_it_acts_in_its_stage_on_every_set_and_sees_the_world(tmp_path):
    world = (
        "u + by * (ctx.dt[:, None] + ctx.gravity[:, :1] + 10 * ctx.load[:, None] + 100 * "
        "ctx.temperature[:, None])"
    )
    load_effect(written(tmp_path, effect(world, stage="transmission")))
    chain = _core.Chain(["creep", "mine", "gain"], 2)
    assert chain.names == ["gain", "mine", "creep"]
    t, u = record()
    gravity = np.tile([0.6, 0.0, 0.8], (60, 1))
    load, temperature = np.linspace(0.0, 5.0, 60), np.linspace(20.0, 30.0, 60)
    params = np.stack([chain.null, chain.start, chain.high])
    out = chain.rollout(params, u, t, gravity, load, temperature)
    np.testing.assert_array_equal(out[0], u)
    for row, one in zip(params, out):
        dt = np.diff(t, prepend=t[0])
        middle = u * row[:2] + row[2] * (dt + 0.6 + 10 * load + 100 * temperature)[:, None]
        after = _core.Chain(["creep"], 2).rollout(row[None, 3:], middle, t)[0]
        np.testing.assert_allclose(one, after, rtol=1e-12)


def test_memory_behind_it_begins_in_equilibrium_with_what_it_gives(tmp_path):
    load_effect(written(tmp_path, effect("u * (1 + by)", stage="command")))
    chain = _core.Chain(["mine", "creep"], 1)
    t, held = np.linspace(0.0, 60.0, 100), np.full((100, 1), 4.0)
    params = np.array([[0.5, *chain.start[1:]]])
    out = chain.rollout(params, held, t)[0]
    np.testing.assert_allclose(out, np.full((100, 1), out[0]), rtol=1e-12)  # nothing drifts


def test_the_control_loop_refuses_it(tmp_path):
    load_effect(written(tmp_path, effect("u * (1 + by)")))
    chain, (t, u) = _core.Chain(["lag", "mine"], 2), record()
    sets, states = chain.start[None], np.zeros((1, chain.state_size))
    asked = [
        lambda: chain.init(chain.start, u[0]),
        lambda: chain.step(chain.start, states[0], u[0], 0.1, 0.1),
        lambda: chain.peek(chain.start, states[0], u[0], 0.1, 0.1),
        lambda: chain.advance(sets, u, t),
        lambda: chain.rollout(sets, u, t, state=states),
    ]
    for ask in asked:
        with pytest.raises(
            SoftmapError,
            match="'mine' is a Python effect.*not in the control loop; write it in Rust",
        ):
            ask()
    assert chain.rollout(sets, u, t).shape == (1, 60, 2)
    _core.Chain(["lag"], 2).init(np.array([0.1]), u[0])  # without it the same is done


@pytest.mark.parametrize(
    ("law", "says"),
    [
        ("u[:, :1]", r"array of shape \(1, 1, 2\)"),
        (
            "    if by[0, 0, 0]:\n        return u[0]\n    return u\n",
            r"\(60, 2\); rollout\(params \(1, 1\), u \(1, 60, 2\)",
        ),
        ("    if by[0, 0, 0]:\n        return None\n    return u\n", "returned NoneType"),
        ("u + by / (by - 0.1)", "returned (inf|-inf) at sample 0, channel 0, for params 0.1"),
        ("u + by * 1j", "an array of complex128"),
        ("u + by + 1", "changes the command by up to 1 at its null values"),
        ("    u += by\n    return u\n", "raised ValueError: .*read-only"),
        ("u + by * nothing", r"\(mine.py\), line 6, raised NameError"),
        ("    raise SystemExit(3)\n", "raised SystemExit: 3"),
        ("    raise RuntimeError('two\\nlines')\n", "RuntimeError: two lines"),
    ],
)
def test_a_law_that_fails_says_where(tmp_path, law, says):
    load_effect(written(tmp_path, effect(law)))
    t, u = record()
    chain = _core.Chain(["mine", "lag"], 2)
    run = Run(t=t, command=u, t_seen=t[::4])
    model = builtin_model().with_effects(["mine"], {"mine.by": 0.1})
    for ask in (
        lambda: chain.rollout(np.stack([chain.start] * 3), u, t),
        lambda: model.predict(run),
    ):
        with pytest.raises(SoftmapError, match=says) as fault:
            ask()
        assert str(fault.value).startswith("the effect 'mine' (mine.py)") and "\n" not in str(
            fault.value
        )


# --- fits -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def off_centre_run():
    """A run of the built-in finger behind the example's law, with noise."""
    from softmap_edge.run.protocol import standard_protocol

    protocol, model = standard_protocol(), builtin_model()
    bent = protocol.command + 0.8 * np.sin(protocol.command / 5.0)
    record = {
        "t": protocol.t,
        "gravity": protocol.gravity,
        "t_seen": protocol.t_seen,
        "robot": model.robot,
    }
    points = model.predict(Run(command=bent, **record))
    points += 0.2 * np.random.default_rng(3).normal(size=points.shape)
    return Run(command=protocol.command, vertices=points, **record)


def test_it_is_a_candidate_and_its_numbers_are_found(off_centre_run):
    without = diagnose(builtin_model(), off_centre_run, effects=["gain", "offset"])
    load_effect(EXAMPLE)
    found = diagnose(
        builtin_model(), off_centre_run, effects=["gain", "offset", "off_centre_pulley"]
    )
    assert "off_centre_pulley" not in [e.name for e in without.effects]
    assert [e.name for e in found.effects] == ["off_centre_pulley"]
    params = found.params_of("off_centre_pulley")
    assert params["off_centre_pulley.a[0]"] == pytest.approx(0.8, abs=0.03)
    assert params["off_centre_pulley.radius"] == pytest.approx(5.0, rel=0.03)
    assert found.made_from["python_effects"] == {
        "off_centre_pulley": loaded()["off_centre_pulley"].sha256
    }
    assert found.error.after < 0.6 * without.error.after
    weak = builtin_model().with_effects(["off_centre_pulley"], {"off_centre_pulley.a[0]": 0.2})
    assert refit(weak, off_centre_run)[0].params["off_centre_pulley.a[1]"] == pytest.approx(
        0.8, abs=0.03
    )


def test_the_commands_take_it_from_diagnosis_to_comparison(off_centre_run, here, capsys):
    off_centre_run.save(here / "run.npz")
    own = ["--effects", str(EXAMPLE)]
    assert main(["diagnose", "run.npz", "--effects", "gain", *own, "--out", "d.json"]) == 0
    found = json.loads((here / "d.json").read_text())
    for parameter in found["effects"][0]["params"].values():
        parameter["value"] *= 1.2
    (here / "d.json").write_text(json.dumps(found))
    assert main(["add", "off_centre_pulley", "--from", "d.json", "--out", "better", *own]) == 0
    assert main(["model", "refit", "run.npz", "--bundle", "better", "--out", "again", *own]) == 0
    save_bundle(builtin_model(), here / "plain")
    capsys.readouterr()
    assert (
        main(["compare", "run.npz", "--bundle", "plain", "--bundle", "again", "--json", *own]) == 0
    )
    before, after = json.loads(capsys.readouterr().out)
    assert after["error"]["rms_mm"] < 0.4 * before["error"]["rms_mm"]
    assert (
        main(["model", "remove", "off_centre_pulley", "--bundle", "again", "--out", "less", *own])
        == 0
    )
    assert not (here / "less/off_centre_pulley.py").exists()
    # Numbers that were fitted with one file are not taken for another.
    forget_effect("off_centre_pulley")
    changed = written(
        here, EXAMPLE.read_text().replace("np.cos(u / radius) - 1.0", "0.0 * u"), "other.py"
    )
    capsys.readouterr()
    add = ["add", "off_centre_pulley", "--from", "d.json", "--out", "worse", "--effects"]
    assert main([*add, str(changed)]) == 2
    assert "was fitted as a Python file of sha256" in capsys.readouterr().err

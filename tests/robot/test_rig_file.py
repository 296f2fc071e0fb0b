"""rig.toml: whatever a name or a port holds is read back, and what its user wrote there lives
through the commands.
"""

import random
import re
import tomllib
from dataclasses import replace

import pytest
from other_program import leave
from rigs import BAUD, HOME, MODEL, NUMBER, set_up

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import ServoError
from softmap_edge.files.toml import quoted
from softmap_edge.robot.servo.emergency import Beats, Emergency, Line
from softmap_edge.robot.servo.models import numbered, servo_model
from softmap_edge.robot.servo.rig import KEPT, Rig, RigServo, read_rig
from softmap_edge.robot.servo.rig_edit import edited

ODD = [
    *range(0x20),
    0x22,
    0x23,
    0x5C,
    0x7F,
    0x85,
    0xA0,
    0xAD,
    0x2028,
    0x202E,
    0xFEFF,
    0xFFFF,
    0x1F916,
    0xF0001,
    0x10FFFF,
]
EDITED = f"""# Bench 3, second floor.
schema = "softmap.rig/1"
port = "/dev/ttyUSB0"   # the left adapter, "#1"
baud = {BAUD}

[ceiling]  # measured in May
slew = 1500.0 # calm

# the bending pair
[[servo]]
id = 1
model = "{MODEL}" # new in June
home = 1 # where it hung
current_mA = 210.5
# ours

  [[servo]]   # the other pair
id = 2
model = '{MODEL}'

[made.homed]
how = "by eye, # two of us"  # in the morning
confirmed = "by --yes"
# the end
"""


def odd_text(rng):
    """Return some characters, many of which TOML must not hold as they are."""
    plain = [c for c in (rng.randrange(0x110000) for _ in range(6)) if not 0xD800 <= c < 0xE000]
    return "".join(map(chr, rng.sample(plain + rng.choices(ODD, k=8), k=len(plain) + 8)))


def test_every_character_is_read_back():
    for start in range(0, 0x110000, 4096):
        text = "".join(chr(c) for c in range(start, start + 4096) if not 0xD800 <= c < 0xE000)
        assert tomllib.loads(f"a = {quoted(text)}")["a"] == text
    assert tomllib.loads(f"a = {quoted('x' + chr(0xD800))}")["a"] == "x?", (
        "half a character has no form in a file"
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_rig_of_odd_names_is_read_as_it_was_written(tmp_path, seed):
    rng = random.Random(seed)
    port, chip, said, name = (odd_text(rng) for _ in range(4))
    stops = Emergency(
        Line(chip, 1), Beats(5006, str(tmp_path / "a\x7fb\U000f0001"), 0.2, odd_text(rng))
    )
    rig = Rig(
        port,
        BAUD,
        (RigServo(1, MODEL, HOME),),
        emergency=stops,
        made={name: {name: said, "all": [said, 1, 0.5]}},
    )
    rig.write(tmp_path / "rig.toml")
    assert read_rig(tmp_path / "rig.toml") == rig
    replace(rig, servos=(RigServo(1, MODEL, HOME + 1),)).note(tmp_path / "rig.toml")
    assert read_rig(tmp_path / "rig.toml") == replace(rig, servos=(RigServo(1, MODEL, HOME + 1),))


@pytest.fixture
def hanging(tmp_path):
    """Give a bus of two servos that hang at HOME, and the file that a user has edited."""
    bus = _core.EmulatedBus([(id, NUMBER, BAUD, float(HOME)) for id in (1, 2)], [[], []], seed=2)
    set_up(bus.path)
    file = tmp_path / "rig.toml"
    file.write_text(
        EDITED.replace("/dev/ttyUSB0", bus.path).replace("home = 1 #", f"home = {HOME - 4096} #")
    )
    yield bus, file
    bus.unplug()


def comments(text):
    return [line[line.index("#") :] for line in text.splitlines() if "#" in line]


def test_homing_changes_home_and_its_provenance_alone(hanging, capsys):
    bus, file = hanging
    before, rig = file.read_text(), read_rig(file)
    assert main(["servo", "home", "--rig", str(file), "--yes"]) == 0
    after = file.read_text()
    assert [c for c in comments(after) if "in the morning" not in c] == [
        c for c in comments(before) if "in the morning" not in c
    ]
    head, made = after.split("[made.homed]")
    assert head == before.split("[made.homed]")[0].replace(
        f"home = {HOME - 4096} #", f"home = {HOME} #"
    ).replace(f"model = '{MODEL}'\n", f"model = '{MODEL}'\nhome = {HOME}\n")
    assert "  # in the morning\n" in made and made.endswith("# the end\n")
    now = read_rig(file)
    assert [servo.home for servo in now.servos] == [HOME, HOME] and now.servos[
        0
    ].current_mA == 210.5
    assert now.made["homed"]["firmware"] == [46, 46] and now.ceiling == rig.ceiling
    assert main(["servo", "home", "--rig", str(file), "--yes"]) == 0
    assert file.read_text().split("[made.homed]")[0] == head, "homed where it is, nothing changes"


def test_setting_up_again_takes_what_was_found_says_so_and_leaves_what_was_written(hanging, capsys):
    bus, file = hanging
    leave(bus.path, BAUD, drive_mode=1)
    assert (
        main(
            [
                "servo",
                "setup",
                "--port",
                bus.path,
                "--baud",
                str(BAUD),
                "--id",
                "1",
                "--rig",
                str(file),
            ]
        )
        == 0
    )
    text = file.read_text()
    assert "home" not in text.split("[made.homed]")[0] and "current_mA" not in text
    assert (
        f"{file} held its home and measured current: taken out, because its drive mode changed"
        in capsys.readouterr().out
    )
    assert "# new in June" in text and "# measured in May" in text and "# ours\n" in text


def test_a_servo_and_provenance_are_added(tmp_path):
    (tmp_path / "rig.toml").write_text(EDITED)
    rig = read_rig(tmp_path / "rig.toml")
    more = replace(rig, port="/dev/ttyACM1", servos=(*rig.servos, RigServo(7, MODEL, 5)))
    more = replace(more, made={**more.made, "pulled": {"servo_1": "so", 'a "b"': [1, 2]}})
    more.note(tmp_path / "rig.toml")
    assert read_rig(tmp_path / "rig.toml") == more
    text = (tmp_path / "rig.toml").read_text()
    assert comments(text) == comments(EDITED) and text.index("id = 7") < text.index("[made.homed]")


SCHEMA = 'schema = "softmap.rig/1"\n'
MODEL_LINE = f'model = "{MODEL}"\n'
LAYOUTS = {
    "inline servos": f'{SCHEMA}port = "p"\nservo = [{{id = 1, model = "{MODEL}"}}] # x\n',
    "servos over lines": f'servo = [\n  {{id = 1, model = "{MODEL}"}}, # x\n]\nport = "p"\nbaud = {BAUD}\n{SCHEMA}',
    "text over lines": f'{SCHEMA}port = """\n[[servo]]\n"""\n[[servo]]\nid = 1\n{MODEL_LINE}home = 3 # x\n',
    "list over lines": f'{SCHEMA}port = "p"\n[[servo]]\nid = 1\n{MODEL_LINE}[made.homed]\nat = [\n1,\n2] # x\n',
    "inline provenance": f'{SCHEMA}port = "p"\nmade = {{homed = {{a = 1}}}} # x\n[[servo]]\nid = 1\n{MODEL_LINE}',
    "lines of Windows": f'{SCHEMA}port = "p" # x\n[[servo]]\nid = 1 # y\n{MODEL_LINE}'.replace(
        "\n", "\r\n"
    ),
}


@pytest.mark.parametrize("text", LAYOUTS.values(), ids=LAYOUTS)
def test_a_file_of_any_layout_keeps_it_and_its_comments(tmp_path, text):
    (tmp_path / "rig.toml").write_text(text, newline="")
    rig = read_rig(tmp_path / "rig.toml")
    changed = replace(rig, servos=(replace(rig.servos[0], home=9),), made={"homed": {"at": [3, 4]}})
    changed.note(tmp_path / "rig.toml")
    after = (tmp_path / "rig.toml").read_bytes().decode()
    assert read_rig(tmp_path / "rig.toml") == changed
    assert comments(after) == comments(text)
    assert [key for key in tomllib.loads(after) if key in tomllib.loads(text)] == list(
        tomllib.loads(text)
    )
    assert ("servo = [" in after, "made = {" in after) == ("servo = [" in text, "made = {" in text)


@pytest.mark.parametrize("seed", range(4))
def test_damaged_layouts_that_are_still_a_rig_take_findings(tmp_path, seed):
    """Lines repeated, moved or taken out: whatever is still read as a rig holds the findings
    afterwards.
    """
    rng, file, taken = random.Random(seed), tmp_path / "rig.toml", 0
    for _ in range(300):
        lines = EDITED.splitlines(keepends=True)
        for _ in range(rng.randint(1, 3)):
            k = rng.randrange(len(lines))
            lines[rng.randrange(len(lines) + 1) : 0] = rng.choice(
                [[lines[k]], [lines.pop(k)], ["[made.x]\n"]]
            )
        file.write_text("".join(lines))
        try:
            rig = read_rig(file)
        except ServoError:
            continue
        taken += 1
        servos = (*(replace(servo, home=9) for servo in rig.servos), RigServo(77, MODEL))
        more = replace(rig, servos=servos, made={**rig.made, "pulled": {"a b": [1, "c"]}})
        more.note(file)
        assert read_rig(file) == more
    assert taken > 20


def test_what_is_known_of_a_servo_is_looked_up_in_one_place(tmp_path, capsys):
    for model in _core.servo_models():
        assert servo_model(model["name"]) == model == numbered(model["number"])
    assert numbered(7) is None
    said = r"no servo 'X' is known; there are .*XL330-M288, .*"
    with pytest.raises(ServoError, match=f"servo 1: {said}"):
        Rig("p", BAUD, (RigServo(1, "X"),))
    for more in ([], ["--servos", "2"]):
        assert main(["servo", "emulate", "--model", "X", *more]) == 2
        assert re.match(f"softmap servo emulate: {said}", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            "[emergancy]\nudp = {port = 5006, key_file = 'stop.key'}",
            "rig.toml: no key 'emergancy'; there are .*emergency",
        ),
        ("[ceilling]\nslew = 3.0", "rig.toml: no key 'ceilling'; there are .*ceiling"),
        ("[ceiling]\nhigth = 3.0", "rig.toml: ceiling: no key 'higth'; there are .*high"),
        (
            "[[servo]]\nid = 3\nmodel = 'XL330-M288'\ncurent_mA = 3.0",
            "servo 2: no key 'curent_mA'; there are .*current_mA",
        ),
    ],
)
def test_a_mistyped_key_is_refused_and_none_is_overlooked(tmp_path, wrong, said):
    file = tmp_path / "rig.toml"
    file.write_text(
        f'schema = "softmap.rig/1"\nport = "p"\n[[servo]]\nid = 1\nmodel = "{MODEL}"\n{wrong}\n'
    )
    with pytest.raises(ServoError, match=said):
        read_rig(file)


def test_nothing_found_changes_nothing(tmp_path):
    (tmp_path / "rig.toml").write_text(EDITED)
    assert edited(EDITED, read_rig(tmp_path / "rig.toml").to_toml(), KEPT) == EDITED
    (tmp_path / "rig.toml").write_text("[")
    with pytest.raises(ServoError, match="no TOML"):
        Rig("p", BAUD, (RigServo(1, MODEL),)).note(tmp_path / "rig.toml")


def test_a_key_file_next_to_the_rig_is_found_however_often_it_is_written(tmp_path, monkeypatch):
    (tmp_path / "bench").mkdir()
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "bench/rig.toml"
    file.write_text(EDITED + '[emergency]\nudp = {port = 5006, key_file = "stop.key"}\n')
    for _ in range(2):
        rig = read_rig("bench/rig.toml")
        assert rig.emergency.udp.key_file == str(tmp_path / "bench/stop.key")
        rig.write("bench/rig.toml")

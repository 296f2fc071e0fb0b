"""The commands of `softmap`: one table; the module of a command is imported only when it runs.

Groups follow the questions of a user; `model`, `run` and `servo` hold actions, such as `softmap
model adapt`. The page docs/reference/cli.md lists them. Pinned by tests/commands/test_cli_words.py.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command: `module` has `NAME_arguments(parser)`, `NAME(options) -> int`, `NameOptions`.

    The last is a dataclass.

    Attributes:
        name: one word, or two for an action of a group, such as `model adapt`
        group: the question that it answers, a heading of the overview
        help: what it does, one line
        module: where its functions are; NAME there is the last word of `name`
        page: name of its page in the docs, without folder and ending
        examples: command lines without `softmap`, shown by `--help`
    """

    name: str
    group: str
    help: str
    module: str
    page: str = ""
    examples: tuple[str, ...] = ()

    @property
    def function(self) -> str:
        """The name of its functions in its module."""
        return self.name.split()[-1].replace("-", "_")

    @property
    def options(self) -> str:
        """The name in its module of the frozen dataclass of its options.

        Commands with actions have one for each.
        """
        return f"{self.function.title().replace('_', '')}Options"


_HERE = "softmap_edge.commands"
SEE, DATA, MODEL = "see it all", "prepare data", "make or change a model"
LOOK, UNDERSTAND, ROBOT = "look at a file", "understand what is missing", "drive a robot"

COMMANDS: list[Command] = [
    Command(
        "demo",
        SEE,
        "the complete workflow on a simulated finger",
        f"{_HERE}.demo",
        "demo",
        ("demo --out demo", "demo --hide backlash,payload --seed 3"),
    ),
    Command(
        "import",
        DATA,
        "logs + mapping file → run; --guess proposes one",
        f"{_HERE}.runs",
        "own_csv",
        ("import log.csv --guess --out map.toml", "import log.csv --map map.toml --out run.npz"),
    ),
    Command(
        "run",
        DATA,
        "cut, join and show runs",
        f"{_HERE}.run",
        "runs",
        ("run show run.npz", "run cut run.npz --from 0 --to 60 --out piece.npz"),
    ),
    Command(
        "run align",
        DATA,
        "camera or mocap frame → base frame",
        f"{_HERE}.align",
        "registration",
        ("run align run.npz --out aligned.npz",),
    ),
    Command(
        "run register",
        DATA,
        "point clouds → vertices of the template",
        f"{_HERE}.align",
        "registration",
        ("run register clouds.npz --out run.npz",),
    ),
    Command(
        "build",
        MODEL,
        "finger.toml or sweep → bundle",
        f"{_HERE}.make",
        "finger_toml",
        ("build finger.toml --out model", "build sweep.npz --out model"),
    ),
    Command(
        "learn",
        MODEL,
        "reference run → rod bundle",
        f"{_HERE}.make",
        "own_csv",
        ("learn run.npz --out model", "learn run.npz --robot robot.toml --out model"),
    ),
    Command(
        "model adapt",
        MODEL,
        "calibrate, add physics, learn the rest",
        f"{_HERE}.adapt",
        "residual",
        ("model adapt run.npz --held-out other.npz --out adapted",),
    ),
    Command(
        "model calibrate",
        MODEL,
        "servo ticks → commands of a model",
        f"{_HERE}.calibrate",
        "registration",
        ("model calibrate run.npz --bundle model --out calibrated",),
    ),
    Command(
        "model effects",
        MODEL,
        "list the effects of the library; `new` writes a template",
        f"{_HERE}.look",
        "effects",
        ("model effects", "model effects backlash", "model effects new mine"),
    ),
    Command(
        "model predict",
        MODEL,
        "shapes for commands",
        f"{_HERE}.look",
        "cli",
        ("model predict 8,-4", "model predict run.npz --bundle model --out points.npz"),
    ),
    Command(
        "model refit",
        MODEL,
        "refit the effects of a model, or the parameters of a finger",
        f"{_HERE}.understand",
        "report",
        ("model refit run.npz --bundle model --out refitted",),
    ),
    Command(
        "model remove",
        MODEL,
        "remove an effect from a model",
        f"{_HERE}.understand",
        "report",
        ("model remove backlash --bundle model --out plain",),
    ),
    Command(
        "model sweep",
        MODEL,
        "simulate a grid of commands",
        f"{_HERE}.make",
        "import_sweep",
        ("model sweep finger.toml --out sweep.npz",),
    ),
    Command(
        "check",
        LOOK,
        "check whether a run or bundle is valid",
        f"{_HERE}.runs",
        "own_csv",
        ("check run.npz", "check run.npz --bundle model", "check model"),
    ),
    Command(
        "show",
        LOOK,
        "show the content of a run or bundle",
        f"{_HERE}.runs",
        "runs",
        ("show run.npz", "show model"),
    ),
    Command(
        "compare",
        UNDERSTAND,
        "show the model error, and where it is",
        f"{_HERE}.understand",
        "report",
        ("compare run.npz --bundle model", "compare run.npz --bundle model --html page.html"),
    ),
    Command(
        "lab",
        UNDERSTAND,
        "a page: see where a model fails, add what is missing",
        f"{_HERE}.lab",
        "lab",
        ("lab", "lab run.npz other.npz --bundle model --folder session"),
    ),
    Command(
        "diagnose",
        UNDERSTAND,
        "identify the missing family of effects, and its law",
        f"{_HERE}.understand",
        "diagnose",
        (
            "diagnose run.npz --bundle model --out found.json",
            "diagnose run.npz --held-out other.npz",
        ),
    ),
    Command(
        "add",
        UNDERSTAND,
        "add an effect to a bundle",
        f"{_HERE}.understand",
        "diagnose",
        ("add backlash --from found.json --bundle model --out better",),
    ),
    Command(
        "next",
        UNDERSTAND,
        "find the experiment that answers the open questions",
        f"{_HERE}.experiment",
        "record",
        ("next found.json --out next.csv", "next --standard --out standard.csv"),
    ),
    Command(
        "record",
        ROBOT,
        "play a command file, on a robot or the simulated finger",
        f"{_HERE}.experiment",
        "record",
        (
            "record next.csv --sim --out run.npz",
            "record next.csv --rig rig.toml --camera udp://:5005 --out run.npz",
        ),
    ),
    Command(
        "track",
        ROBOT,
        "move the tip along a figure",
        f"{_HERE}.track",
        "track",
        ("track S --plan --picture s.svg", "track S --sim --hide backlash --record s.mcap"),
    ),
    Command(
        "teleop",
        ROBOT,
        "drive by hand: camera, keys or mouse",
        f"{_HERE}.teleop",
        "teleop",
        ("teleop --sim", "teleop --rig rig.toml"),
    ),
    Command(
        "servo",
        ROBOT,
        "find, read, set up, home, release or emulate servos",
        f"{_HERE}.servo.commands",
        "commission",
        ("servo scan", "servo setup --rig rig.toml", "servo home --rig rig.toml"),
    ),
    Command(
        "servo doctor",
        ROBOT,
        "check that the computer and the rig are ready",
        f"{_HERE}.servo.check",
        "commission",
        ("servo doctor", "servo doctor --rig rig.toml"),
    ),
    Command(
        "servo move",
        ROBOT,
        "jog a servo, or go to one command",
        f"{_HERE}.servo.move",
        "commission",
        ("servo move --rig rig.toml --servo 1 --by 50",),
    ),
    Command(
        "servo replay",
        ROBOT,
        "replay a recording of the loop through the guard",
        f"{_HERE}.servo.check",
        "safety",
        ("servo replay session.mcap",),
    ),
]

# Names before 0.1.0, removed after it. Each prints a line on stderr and runs.
RENAMED: dict[str, str] = {
    "adapt": "model adapt",
    "align": "run align",
    "calibrate": "model calibrate",
    "doctor": "servo doctor",
    "effects": "model effects",
    "move": "servo move",
    "predict": "model predict",
    "refit": "model refit",
    "register": "run register",
    "remove": "model remove",
    "replay": "servo replay",
    "sweep": "model sweep",
}

# Commands of distributions that may not be installed, and what to install for each.
ELSEWHERE: dict[str, str] = {
    "train": "pip install 'softmap-training[torch]'",
    "evaluate": "pip install softmap-training",
}

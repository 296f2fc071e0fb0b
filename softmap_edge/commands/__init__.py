"""The verbs of the `softmap` command: one table, each verb's module imported only when it runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Verb:
    """A verb: `module` holds the functions `NAME(args) -> int` and `NAME_arguments(parser)`."""

    name: str
    group: str
    help: str
    module: str


VERBS: list[Verb] = [
    Verb("demo", "see it all", "the complete workflow on a simulated finger", "softmap_edge.commands.demo"),
    Verb("build", "make a model", "finger.toml → bundle", "softmap_edge.commands.make"),
    Verb("learn", "make a model", "reference run → rod bundle", "softmap_edge.commands.make"),
    Verb("adapt", "make a model", "calibrate, add physics, learn the rest", "softmap_edge.commands.adapt"),
    Verb("export", "make a model", "finger.toml → scene of another simulator", "softmap_edge.commands.make"),
    Verb("sweep", "make a model", "simulate a grid of commands", "softmap_edge.commands.make"),
    Verb("import", "set up", "logs + mapping file → run; --guess proposes one", "softmap_edge.commands.runs"),
    Verb("align", "set up", "camera or mocap frame → base frame", "softmap_edge.commands.align"),
    Verb("register", "set up", "point clouds → vertices of the template", "softmap_edge.commands.register"),
    Verb("calibrate", "set up", "servo ticks → commands of a model", "softmap_edge.commands.calibrate"),
    Verb(
        "servo", "set up", "find, read, set up, home, release or emulate servos", "softmap_edge.commands.servo.commands"
    ),
    Verb("run", "set up", "cut runs, join them, show what they hold", "softmap_edge.commands.run"),
    Verb("doctor", "set up", "is everything here that a robot needs", "softmap_edge.commands.doctor"),
    Verb("check", "look", "is this run or bundle sound", "softmap_edge.commands.runs"),
    Verb("show", "look", "what is in a run or bundle", "softmap_edge.commands.runs"),
    Verb("predict", "look", "shapes for commands", "softmap_edge.commands.look"),
    Verb("effects", "look", "the effects that the library knows", "softmap_edge.commands.look"),
    Verb("compare", "understand", "how far off is the model, and where", "softmap_edge.commands.understand"),
    Verb(
        "diagnose", "understand", "which family of effects is missing, and its law", "softmap_edge.commands.understand"
    ),
    Verb("next", "understand", "which experiment settles what is open", "softmap_edge.commands.experiment"),
    Verb("add", "understand", "add an effect to a bundle", "softmap_edge.commands.understand"),
    Verb("remove", "understand", "remove an effect from a bundle", "softmap_edge.commands.understand"),
    Verb("refit", "understand", "fit the effects of a bundle again", "softmap_edge.commands.understand"),
    Verb("move", "move", "jog a servo, or go to one command", "softmap_edge.commands.move"),
    Verb("track", "move", "lead the tip along a figure", "softmap_edge.commands.track"),
    Verb("teleop", "move", "drive by hand: camera, keys or mouse", "softmap_edge.commands.teleop"),
    Verb(
        "record", "move", "play a command file, on a robot or the simulated finger", "softmap_edge.commands.experiment"
    ),
    Verb("replay", "move", "a recording of the loop, decided again", "softmap_edge.commands.servo.commands"),
]

# Verbs of distributions that may not be installed, and what to install for each.
ELSEWHERE: dict[str, str] = {
    "train": "pip install 'softmap-training[torch]'",
    "evaluate": "pip install softmap-training",
}

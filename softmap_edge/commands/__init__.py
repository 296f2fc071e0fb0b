"""The commands of `softmap`: one table; the module of a command is imported only when it runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A verb: `module` holds the functions `NAME(args) -> int` and `NAME_arguments(parser)`."""

    name: str
    group: str
    help: str
    module: str


VERBS: list[Command] = [
    Command("demo", "see it all", "the complete workflow on a simulated finger", "softmap_edge.commands.demo"),
    Command("build", "make a model", "finger.toml → bundle", "softmap_edge.commands.make"),
    Command("learn", "make a model", "reference run → rod bundle", "softmap_edge.commands.make"),
    Command("adapt", "make a model", "calibrate, add physics, learn the rest", "softmap_edge.commands.adapt"),
    Command("sweep", "make a model", "simulate a grid of commands", "softmap_edge.commands.make"),
    Command("import", "set up", "logs + mapping file → run; --guess proposes one", "softmap_edge.commands.runs"),
    Command("align", "set up", "camera or mocap frame → base frame", "softmap_edge.commands.align"),
    Command("register", "set up", "point clouds → vertices of the template", "softmap_edge.commands.register"),
    Command("calibrate", "set up", "servo ticks → commands of a model", "softmap_edge.commands.calibrate"),
    Command(
        "servo", "set up", "find, read, set up, home, release or emulate servos", "softmap_edge.commands.servo.commands"
    ),
    Command("run", "set up", "cut runs, join them, show what they hold", "softmap_edge.commands.run"),
    Command("doctor", "set up", "is everything here that a robot needs", "softmap_edge.commands.doctor"),
    Command("check", "look", "is this run or bundle sound", "softmap_edge.commands.runs"),
    Command("show", "look", "what is in a run or bundle", "softmap_edge.commands.runs"),
    Command("predict", "look", "shapes for commands", "softmap_edge.commands.look"),
    Command("effects", "look", "the effects that the library knows", "softmap_edge.commands.look"),
    Command("compare", "understand", "how far off is the model, and where", "softmap_edge.commands.understand"),
    Command(
        "diagnose", "understand", "which family of effects is missing, and its law", "softmap_edge.commands.understand"
    ),
    Command("next", "understand", "which experiment settles what is open", "softmap_edge.commands.experiment"),
    Command("add", "understand", "add an effect to a bundle", "softmap_edge.commands.understand"),
    Command("remove", "understand", "remove an effect from a bundle", "softmap_edge.commands.understand"),
    Command("refit", "understand", "fit the effects of a bundle again", "softmap_edge.commands.understand"),
    Command("move", "move", "jog a servo, or go to one command", "softmap_edge.commands.move"),
    Command("track", "move", "lead the tip along a figure", "softmap_edge.commands.track"),
    Command("teleop", "move", "drive by hand: camera, keys or mouse", "softmap_edge.commands.teleop"),
    Command(
        "record", "move", "play a command file, on a robot or the simulated finger", "softmap_edge.commands.experiment"
    ),
    Command("replay", "move", "a recording of the loop, decided again", "softmap_edge.commands.servo.commands"),
]

# Verbs of distributions that may not be installed, and what to install for each.
ELSEWHERE: dict[str, str] = {
    "train": "pip install 'softmap-training[torch]'",
    "evaluate": "pip install softmap-training",
}

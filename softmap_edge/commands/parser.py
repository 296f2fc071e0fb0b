"""The argument parser of every command: an error names the nearest valid option or choice."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from softmap_edge.errors import nearest


@dataclass(frozen=True)
class Action:
    """An action of a command, such as `servo scan`.

    Attributes:
        help: what it does, one line
        declare: declares its arguments
        run: runs it with its options, returns the exit code
        options: the dataclass of its options
    """

    help: str
    declare: Callable[[argparse.ArgumentParser], None]
    run: Callable[[Any], int]
    options: type[Any]


_CHOICE = re.compile(r"invalid choice: '?([^'\s]*)'? \(choose from (.*)\)")


class Parser(argparse.ArgumentParser):
    """A parser whose errors suggest the nearest valid name."""

    asked: Sequence[str] = ()
    more: Sequence[str] = ()  # actions that are commands of their own, such as `align` of `run`

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse `args`; print one line and exit with code 2 if they are not valid."""
        self._remember(list(args or ()))
        return super().parse_args(args, namespace)

    def _remember(self, asked: Sequence[str]) -> None:
        """Store the arguments, here and in the parsers of actions."""
        self.asked = asked
        for one in parsers_below(self):
            one.asked = asked

    def error(self, message: str) -> NoReturn:
        """Print usage, the fault and the nearest valid name; exit with code 2."""
        hints = [*self._options(), *_choice(message, self.more)]
        super().error("; ".join([message, *dict.fromkeys(hints)]))

    def _options(self) -> list[str]:
        """Return the nearest valid option for each unknown one."""
        known = options_of(self)
        given = [word.split("=")[0] for word in self.asked if re.match(r"--[^\d=]", word)]
        wrong = [word for word in given if not any(option.startswith(word) for option in known)]
        found = [(word, nearest(word, known, 2)) for word in wrong]
        return [
            f"there is no option {word}: did you mean {' or '.join(near)}?"
            for word, near in found
            if near
        ]


def add_actions(parser: argparse.ArgumentParser, actions: Mapping[str, Action]) -> None:
    """Declare a command's actions, such as `servo scan`: `args.what` is the chosen one."""
    what = parser.add_subparsers(dest="what", required=True, metavar="|".join(actions))
    for name, action in actions.items():
        one = what.add_parser(name, help=action.help)
        action.declare(one)
        # The command has --json too; a default of the action would override one given before it.
        one.add_argument(
            "--json", action="store_true", default=argparse.SUPPRESS, help="print one JSON document"
        )


def run_action(actions: Mapping[str, Action], args: argparse.Namespace) -> int:
    """Run the chosen action with its own options; return its exit code."""
    action = actions[args.what]
    return action.run(
        action.options(**{name: value for name, value in vars(args).items() if name != "what"})
    )


def parsers_below(parser: argparse.ArgumentParser) -> Iterator[Parser]:
    """Yield the parsers of a parser's actions, such as that of `servo scan`."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for one in action.choices.values():
                yield one
                yield from parsers_below(one)


def actions_of(parser: argparse.ArgumentParser) -> list[str]:
    """Return the names of a parser's actions, such as `scan` of `servo`."""
    found = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    return [name for one in found for name in one.choices]


def options_of(parser: argparse.ArgumentParser) -> list[str]:
    """Return the long options of a parser and its actions, without hidden old names."""
    actions = [action for one in (parser, *parsers_below(parser)) for action in one._actions]
    shown = [action for action in actions if action.help != argparse.SUPPRESS]
    found = {text for action in shown for text in action.option_strings}
    return sorted(text for text in found if text.startswith("--"))


def _choice(message: str, more: Sequence[str] = ()) -> list[str]:
    """Return the nearest choice, or other action, for one that does not exist."""
    found = _CHOICE.search(message)
    if found is None:
        return []
    near = nearest(found[1], [*(text.strip(" '\"") for text in found[2].split(",")), *more])
    return [f"did you mean {near[0]}?"] if near else []

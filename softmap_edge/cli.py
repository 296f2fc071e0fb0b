"""The `softmap` command: run a command, turn errors into one line and an exit code.

A command continues when the reader of its output ends: after `head` closes the pipe, it still
writes its files. Pinned by tests/commands/test_cli_words.py and tests/files/test_mcap_damage.py.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from importlib.metadata import entry_points
from typing import Any, TextIO, cast

from softmap_edge.commands import COMMANDS, ELSEWHERE, RENAMED, Command
from softmap_edge.commands.parser import Parser, actions_of
from softmap_edge.errors import RecordingWarning, SessionWarning, SoftmapError, no_name
from softmap_edge.files.printable import PrintableStream, one_line, plain_line
from softmap_edge.files.refusals import refusal
from softmap_edge.version import __version__

DONE, FAULT, WRONG_USE = 0, 1, 2
NEGATIVE = re.compile(r"-[\d.][^:]*,")
OUTPUT = "standard output"
HELP = "help"  # softmap help COMMAND
HUNG_UP, INTERRUPTED, TERMINATED = 129, 130, 143  # 128 + the signal, as a shell reports it
_STOPPED = {
    signal.SIGHUP: (HUNG_UP, "terminated"),
    signal.SIGINT: (INTERRUPTED, "interrupted"),
    signal.SIGTERM: (TERMINATED, "terminated"),
}


class Terminated(KeyboardInterrupt):
    """A signal other than that of Ctrl-C has ended the command."""

    def __init__(self, number: signal.Signals) -> None:
        super().__init__()
        self.number = number


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code.

    It is 0 on success, 1 for a fault or a worse error, 2 for wrong usage or a file that cannot be
    written, 130 when interrupted (Ctrl-C), 143 or 129 when terminated (SIGTERM, SIGHUP).
    """
    argv = sys.argv[1:] if argv is None else argv
    live = "--live" in argv  # a live command ends with its reader
    with _stopped_by_signals(), nullcontext() if live else outliving(), _printable():
        try:
            code = _main(argv)
            if not live and sys.stdout is not None:
                sys.stdout.flush()
            return code
        except OSError as error:  # standard output of a command that is not run, such as --help
            if live:
                raise
            print(one_line(f"softmap: {refusal(error)}"), file=sys.stderr)
            return WRONG_USE


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does, so that no partial file is left."""

    def stop(number: int, _: object) -> None:
        raise Terminated(signal.Signals(number))

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # a signal that is ignored (nohup) or handled stays so
    usual = [one for one in _STOPPED if signal.getsignal(one) is signal.SIG_DFL]
    for one in usual:
        signal.signal(one, stop)
    try:
        yield
    finally:
        for one in usual:
            signal.signal(one, signal.SIG_DFL)


class Outliving:
    """A stream that discards its output once the reader has closed the pipe.

    If it cannot be written for another reason, its output is discarded from then on. The error is
    raised with the stream's `name`, if it has one.
    """

    def __init__(self, stream: TextIO, name: str | None = None) -> None:
        self._stream, self._name = stream, name

    def write(self, text: str) -> int:
        """Write `text`; return the number of characters."""
        try:
            return int(self._stream.write(text))
        except OSError as fault:
            self._fail(fault)
            return len(text)

    def flush(self) -> None:
        """Write out the buffer."""
        try:
            self._stream.flush()
        except OSError as fault:
            self._fail(fault)

    def _fail(self, fault: OSError) -> None:
        self._give_up()
        if self._name is not None and not isinstance(fault, BrokenPipeError):
            raise type(fault)(fault.errno, fault.strerror, self._name) from fault

    def _give_up(self) -> None:
        """Redirect the stream, with its buffer, to the null device."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def outliving() -> Iterator[None]:
    """Keep running when the readers of standard output and standard error end."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        one and cast(TextIO, Outliving(one, name)) for one, name in zip(streams, (OUTPUT, None))
    )
    try:
        yield
    finally:
        for one in (sys.stdout, sys.stderr):
            if one is not None:
                one.flush()
        sys.stdout, sys.stderr = streams


@contextmanager
def _printable() -> Iterator[None]:
    """Escape control characters in all output inside the block; a closed stream stays None."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (s and cast(TextIO, PrintableStream(s)) for s in streams)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _main(argv: list[str]) -> int:
    """Find the command and run it."""
    # Small factorisations are ten times slower with BLAS threads; read when numpy is first loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    known = {command.name: command for command in commands_here()}
    if not argv or argv[0] in ("-h", "--help"):
        print(_overview(list(known.values())))
        return DONE if argv else WRONG_USE
    if argv[0] == "--version":
        print(f"softmap {__version__}")
        return DONE
    if argv[0] == HELP:  # `softmap help servo scan` is `softmap servo scan --help`
        return _main([*[word for word in argv[1:] if not word.startswith("-")], "--help"])
    if argv[0] in RENAMED:
        new = RENAMED[argv[0]]
        print(
            f"softmap: '{argv[0]}' is now '{new}'; the old name is gone after 0.1.0",
            file=sys.stderr,
        )
        argv = [*new.split(), *argv[1:]]
    name = " ".join(argv[:2]) if " ".join(argv[:2]) in known else argv[0]
    if name not in known:
        return _no_command(argv, known)
    try:
        return _run(known[name], argv[len(name.split()) :])
    except KeyboardInterrupt as stop:
        code, how = _STOPPED[stop.number if isinstance(stop, Terminated) else signal.SIGINT]
        print(f"softmap {name}: {how}", file=sys.stderr)
        return code


def _no_command(argv: list[str], known: Mapping[str, Command]) -> int:
    """Print the actions of a group given without an action, or that there is no such command."""
    actions = [
        command for name, command in known.items() if name.split()[0] == argv[0] and " " in name
    ]
    given = argv[1] if len(argv) > 1 else ""
    if actions and (not given or given in ("-h", "--help")):
        print("\n".join([f"usage: softmap {argv[0]} ACTION [options]", "", *map(_line, actions)]))
        return DONE if given else WRONG_USE
    if actions:
        fault = no_name(
            f"action of '{argv[0]}'", given, [command.name.split()[1] for command in actions]
        )
    elif argv[0] in ELSEWHERE:
        fault = f"'{argv[0]}' is in another package: {ELSEWHERE[argv[0]]}"
    else:
        words = dict.fromkeys([*(name.split()[0] for name in known), HELP])
        fault = no_name("command", argv[0], words, also=_names_below(known))
    print(one_line(f"softmap: {fault}"), file=sys.stderr)
    return WRONG_USE


def _names_below(known: Mapping[str, Command]) -> dict[str, str]:
    """Return the actions of groups and the old names of commands, each with its full name."""
    groups = {name.split()[0] for name in known if " " in name}
    below = [
        f"{group} {action}"
        for group in groups & set(known)
        for action in actions_of(parser_of(known[group]))
    ]
    full = {name.split()[1]: name for name in sorted([*below, *known]) if " " in name}
    return full | RENAMED


def parser_of(command: Command) -> Parser:
    """Return the argument parser of a command."""
    module = importlib.import_module(command.module)
    parser = Parser(
        prog=f"softmap {command.name}",
        description=command.help,
        epilog=_epilog(command),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    getattr(module, f"{command.function}_arguments")(parser)
    below = [one.name for one in commands_here() if one.name.startswith(f"{command.name} ")]
    parser.more = [name.split()[1] for name in below]
    parser.add_argument(
        "--json", action="store_true", help="print one JSON document instead of text"
    )
    return parser


def _epilog(command: Command) -> str:
    """Return the text below the options: examples, further actions, the page."""
    lines = (
        ["Examples:", *(f"  softmap {example}" for example in command.examples)]
        if command.examples
        else []
    )
    more = [one.name for one in commands_here() if one.name.startswith(f"{command.name} ")]
    lines += [f"More actions: {', '.join(more)} (softmap help ACTION)"] if more else []
    lines += [f"Page in the docs: {command.page}"] if command.page else []
    return "\n".join(lines)


def commands_here() -> list[Command]:
    """Return the commands of this installation."""
    return [*COMMANDS, *_plugged_in()]


def _run(command: Command, argv: list[str]) -> int:
    if broken := [word for word in argv if any(c in word for c in "\n\r\t")]:
        print(
            f"softmap {command.name}: '{one_line(broken[0])}' holds a line end or a tab; names "
            "must be one line: rename the file, then give its new name",
            file=sys.stderr,
        )
        return WRONG_USE
    module = importlib.import_module(command.module)
    function = command.function + ("_" if command.function == "import" else "")
    parser = parser_of(command)
    # -8,3 is not an option: argparse does not parse an argument with a space as one
    argv = [f" {word}" if NEGATIVE.match(word) else word for word in argv]
    try:
        namespace = parser.parse_args(argv)
    except SystemExit as stop:  # argparse has printed the reason
        return int(stop.code or 0)
    name = " ".join(filter(None, (command.name, vars(namespace).get("what"))))  # `servo scan`
    options = vars(module).get(command.options)  # none if the actions have their own options
    args = namespace if options is None else options(**vars(namespace))
    try:
        with _printing_warnings(name) as incomplete:
            code = int(getattr(module, function)(args))
        if sys.stdout is not None:  # closed by the parent process
            sys.stdout.flush()  # detect a closed pipe here, not when the interpreter exits
        return code or (FAULT if incomplete else DONE)
    except BrokenPipeError:  # the reader of a live output has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except SoftmapError as error:
        from softmap_edge.commands.output import with_files  # loads numpy

        print(one_line(f"softmap {name}: {with_files(str(error), args)}"), file=sys.stderr)
        return WRONG_USE
    except MemoryError:
        print(
            f"softmap {name}: more memory is needed than is free; take something smaller",
            file=sys.stderr,
        )
        return WRONG_USE
    except OSError as error:
        print(one_line(f"softmap {name}: {refusal(error)}"), file=sys.stderr)
        return WRONG_USE


@contextmanager
def _printing_warnings(name: str) -> Iterator[set[str]]:
    """Print each recording or session warning once on stderr; yield the set of recording warnings.

    A command works with the sound part of a damaged recording, and returns 1.
    """
    printed: set[str] = set()
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, RecordingWarning | SessionWarning):
                usual(message, category, filename, lineno, file, line)
            elif (text := str(message)) not in printed:
                print(plain_line(f"softmap {name}: {text}"), file=sys.stderr, flush=True)
                if issubclass(category, RecordingWarning):
                    printed.add(text)

        for category in (RecordingWarning, SessionWarning):
            warnings.filterwarnings("always", category=category)
        warnings.showwarning = show
        yield printed


def _plugged_in() -> list[Command]:
    return [
        command for point in entry_points(group="softmap.commands") for command in point.load()()
    ]


def _line(command: Command) -> str:
    return f"  {command.name:<16} {command.help}"


def _overview(commands: list[Command]) -> str:
    lines = ["usage: softmap COMMAND [options]   (softmap help COMMAND)", ""]
    for group in dict.fromkeys(command.group for command in commands):
        lines.append(f"{group}:")
        lines += [_line(command) for command in commands if command.group == group]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

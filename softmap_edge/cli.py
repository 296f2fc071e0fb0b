"""The `softmap` command: finds the verb, runs it, turns errors into one line and an exit code."""

from __future__ import annotations

import importlib
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from importlib.metadata import entry_points
from typing import TextIO, cast

from softmap_edge.commands import ELSEWHERE, VERBS, Command
from softmap_edge.commands.incomplete import printing_warnings
from softmap_edge.commands.parser import Parser
from softmap_edge.commands.pipe import outliving
from softmap_edge.errors import SoftmapError, no_name
from softmap_edge.files.printable import PrintableStream, one_line
from softmap_edge.robot.remedies import with_files
from softmap_edge.version import __version__

DONE, FAULT, WRONG_USE = 0, 1, 2
NEGATIVE = re.compile(r"-[\d.][^:]*,")
HELP = "help"  # softmap help COMMAND
INTERRUPTED = 130  # as a shell reports Ctrl-C


def main(argv: list[str] | None = None) -> int:
    """Run one verb; return 0 when done, 1 for a fault or a worse error, 2 for wrong use, 130 when interrupted."""
    argv = sys.argv[1:] if argv is None else argv
    live = "--live" in argv  # it ends with its reader
    with nullcontext() if live else outliving(), _printable():
        return _main(argv)


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
    verbs = {verb.name: verb for verb in commands_here()}
    if not argv or argv[0] in ("-h", "--help"):
        print(_overview(list(verbs.values())))
        return DONE if argv else WRONG_USE
    if argv[0] == "--version":
        print(f"softmap {__version__}")
        return DONE
    if argv[0] == HELP:  # `softmap help servo scan` is `softmap servo scan --help`
        return _main([*[word for word in argv[1:] if not word.startswith("-")], "--help"])
    if argv[0] not in verbs:
        if argv[0] in ELSEWHERE:
            print(f"softmap: '{argv[0]}' is in another package: {ELSEWHERE[argv[0]]}", file=sys.stderr)
        else:
            print(one_line(f"softmap: {no_name('command', argv[0], [*verbs, HELP])}"), file=sys.stderr)
        return WRONG_USE
    try:
        return _run(verbs[argv[0]], argv[1:])
    except KeyboardInterrupt:
        print(f"softmap {argv[0]}: interrupted", file=sys.stderr)
        return INTERRUPTED


def parser_of(verb: Command) -> Parser:
    """Return the argument parser of a command."""
    module = importlib.import_module(verb.module)
    parser = Parser(prog=f"softmap {verb.name}", description=verb.help)
    getattr(module, f"{verb.name.replace('-', '_')}_arguments")(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of text")
    return parser


def commands_here() -> list[Command]:
    """Return the commands of this installation."""
    return [*VERBS, *_plugged_in()]


def _run(verb: Command, argv: list[str]) -> int:
    module = importlib.import_module(verb.module)
    function = verb.name.replace("-", "_") + ("_" if verb.name == "import" else "")
    parser = parser_of(verb)
    # A command such as -8,3 is no option; argparse leaves alone what holds a space.
    argv = [f" {word}" if NEGATIVE.match(word) else word for word in argv]
    try:
        args = parser.parse_args(argv)
    except SystemExit as stop:  # argparse has printed why
        return int(stop.code or 0)
    try:
        with printing_warnings(verb.name) as incomplete:
            code = int(getattr(module, function)(args))
        if sys.stdout is not None:  # closed by whoever started it
            sys.stdout.flush()  # a closed pipe is noticed here, not when the interpreter ends
        return code or (FAULT if incomplete else DONE)
    except BrokenPipeError:  # the reader of a live output has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except SoftmapError as error:
        print(one_line(f"softmap {verb.name}: {with_files(str(error), args)}"), file=sys.stderr)
        return WRONG_USE
    except MemoryError:
        print(f"softmap {verb.name}: more memory is needed than is free; take something smaller", file=sys.stderr)
        return WRONG_USE
    except OSError as error:
        print(one_line(f"softmap {verb.name}: {_of_the_system(error)}"), file=sys.stderr)
        return WRONG_USE


def _of_the_system(error: OSError) -> str:
    """Return what the operating system refused, and what to do."""
    path = error.filename2 or error.filename
    if path is None or error.strerror is None:
        return str(error)
    return f"{path}: {error.strerror.lower()}; give a path that exists and may be used for this"


def _plugged_in() -> list[Command]:
    return [verb for point in entry_points(group="softmap.commands") for verb in point.load()()]


def _overview(verbs: list[Command]) -> str:
    lines = ["usage: softmap COMMAND [options]   (softmap help COMMAND)", ""]
    for group in dict.fromkeys(verb.group for verb in verbs):
        lines.append(f"{group}:")
        lines += [f"  {verb.name:<10} {verb.help}" for verb in verbs if verb.group == group]
    return "\n".join(lines)

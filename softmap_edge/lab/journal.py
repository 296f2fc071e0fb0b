"""The session folder of the lab: its journal, one JSON object per line, is only ever appended to.

The first line names the inputs. Each later line is a diagnosis, an accepted step, or an undo or
redo; reading them again gives the state. A line is on disk before its step counts, so a killed
server loses nothing. A last line without its end was never confirmed, and is cut off. Files are
checked as untrusted. Pinned by tests/lab/test_session.py.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from softmap_edge.errors import LabError
from softmap_edge.files.atomic import Document, finite
from softmap_edge.files.printable import one_line

SCHEMA = "softmap.lab/1"
JOURNAL = "journal.jsonl"
MODEL = "model"  # bundle with the accepted steps
OURS = re.compile(r"journal\.jsonl|model|\.model\..*|demo_run\.npz|diagnosis-[1-9]\d{0,5}\.json")
DIAGNOSIS = re.compile(r"diagnosis-[1-9]\d{0,5}\.json")
MOST = 16 << 20  # bytes of a journal
MOST_EFFECTS = 64
MOST_RUNS = 64
MOST_NUMBERS = 512
LONGEST_NAME = 200  # characters
LARGEST = 1e12  # of a number
HEX = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Source:
    """An input file: its path (None for the built-in finger) and its hash."""

    path: str | None
    sha256: str


@dataclass(frozen=True)
class Inputs:
    """The runs of a session, the first one fitted, and the bundle."""

    runs: tuple[Source, ...]
    bundle: Source


@dataclass(frozen=True)
class Step:
    """An accepted step: effects with all parameters of the chain, or those of a diagnosis.

    Attributes:
        effects: the complete chain after the step; of a diagnosis, the effects that it adds
        params: by label; empty for a diagnosis
        diagnosis: file of the diagnosis in the session folder, or None
        errors_mm: error on each run with the step, RMS mm
    """

    effects: tuple[str, ...]
    params: Mapping[str, float] = field(default_factory=dict)
    diagnosis: str | None = None
    errors_mm: tuple[float, ...] = ()


@dataclass(frozen=True)
class State:
    """The content of a journal: inputs, accepted steps, steps taken back, the newest diagnosis.

    `diagnosed` is its file, `diagnosed_for` the inputs that it is of (`Session.key`).
    """

    inputs: Inputs
    accepted: tuple[Step, ...] = ()
    undone: tuple[Step, ...] = ()
    diagnosed: str | None = None
    diagnosed_for: str | None = None
    diagnoses: int = 0

    def after(self, line: Document) -> State:
        """Return the state after a line of the journal.

        Raises:
            LabError: the line is not a step, or there is nothing to undo or redo.
        """
        do = line.get("do")
        if do == "diagnosed":
            file = _diagnosis_file(line.get("file"))
            key = line.get("inputs")
            if not isinstance(key, str) or not HEX.fullmatch(key):
                raise LabError("'inputs' of a diagnosis is not a hash")
            return replace(self, diagnosed=file, diagnosed_for=key, diagnoses=self.diagnoses + 1)
        if do == "accepted":
            return replace(self, accepted=(*self.accepted, _step(line)), undone=())
        if do == "undone":
            if not self.accepted:
                raise LabError("there is no accepted step to undo")
            return replace(
                self, accepted=self.accepted[:-1], undone=(*self.undone, self.accepted[-1])
            )
        if do == "redone":
            if not self.undone:
                raise LabError("there is no step to redo")
            return replace(
                self, accepted=(*self.accepted, self.undone[-1]), undone=self.undone[:-1]
            )
        raise LabError(f"unknown step {do!r:.40}")


class Journal:
    """The open journal of a session folder; one program at a time has it.

    Args:
        folder: the session folder; made if it does not exist.
        inputs: of a new session; None to open an existing one.

    Raises:
        LabError: the folder holds other files, a session of other inputs, a damaged journal, or
            another lab has it open.
    """

    def __init__(self, folder: str | Path, inputs: Inputs | None = None) -> None:
        self.folder = _folder(Path(folder), new=inputs is not None)
        file = self.folder / JOURNAL
        self._file = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            self._lock()
            self.state = self._read(inputs)
        except BaseException:
            os.close(self._file)
            raise

    def close(self) -> None:
        """Let another program open the folder."""
        os.close(self._file)

    def append(self, line: Document) -> State:
        """Write a step to disk, and return the state after it."""
        state = self.state.after(line)
        self._write(line)
        self.state = state
        return state

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise LabError(
                f"{_shown(self.folder)}: another lab has this session open; end it, or give "
                "another --folder"
            ) from None

    def _write(self, line: Document) -> None:
        """Append a complete line, or nothing: a part of it would damage the next one."""
        content = json.dumps(line, allow_nan=False).encode() + b"\n"
        before = os.lseek(self._file, 0, os.SEEK_END)
        try:
            written = os.write(self._file, content)
            if written < len(content):
                raise OSError("the disk is full")
            os.fsync(self._file)
        except OSError as fault:
            os.ftruncate(self._file, before)
            raise LabError(
                f"{_shown(self.folder)}: the step cannot be written ({fault.strerror or fault})"
            ) from None

    def _read(self, inputs: Inputs | None) -> State:
        size = os.fstat(self._file).st_size
        if size > MOST:
            raise self._damaged(1, f"{size >> 20} MB; journals of up to {MOST >> 20} MB are read")
        content = os.pread(self._file, size, 0)
        complete = content[: content.rfind(b"\n") + 1]
        lines = complete.splitlines()
        if not lines:
            if inputs is None:
                raise LabError(f"{_shown(self.folder)}: holds no session; give its runs")
            os.ftruncate(self._file, 0)
            self._write({"do": "open", "schema": SCHEMA, **asdict(inputs)})
            return State(inputs)
        os.ftruncate(self._file, len(complete))
        state = State(self._first(lines[0]))
        if inputs is not None and _hashes(inputs) != _hashes(state.inputs):
            raise LabError(
                f"{_shown(self.folder)}: a session of other runs or another bundle; give another "
                "--folder"
            )
        for number, line in enumerate(lines[1:], 2):
            try:
                state = state.after(_object(line))
            except LabError as fault:
                raise self._damaged(number, str(fault)) from None
        return state

    def _first(self, line: bytes) -> Inputs:
        try:
            first = _object(line)
            if first.get("do") != "open" or first.get("schema") != SCHEMA:
                raise LabError(f"schema {first.get('schema')!r:.40}, expected {SCHEMA!r}")
            runs = first.get("runs")
            if not isinstance(runs, list) or not 1 <= len(runs) <= MOST_RUNS:
                raise LabError("it names no runs")
            return Inputs(tuple(map(_source, runs)), _source(first.get("bundle")))
        except LabError as fault:
            raise self._damaged(1, str(fault)) from None

    def _damaged(self, line: int, why: str) -> LabError:
        return LabError(
            f"{_shown(self.folder / JOURNAL)}: damaged in line {line}: {one_line(why)}; give "
            "another --folder"
        )


def _shown(path: Path) -> str:
    return one_line(str(path))


def _folder(folder: Path, new: bool) -> Path:
    """Return the folder of a session; make a new one."""
    try:
        if new:
            folder.mkdir(parents=True, exist_ok=True)
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError as fault:
        raise LabError(
            f"--folder {_shown(folder)}: no folder for a session ({fault.strerror}); give another "
            "name"
        ) from None
    if names and JOURNAL not in names and (other := [n for n in names if not OURS.fullmatch(n)]):
        raise LabError(
            f"--folder {_shown(folder)}: holds {one_line(other[0])} and no session; give a new name"
        )
    return folder


def _object(line: bytes) -> Document:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        raise LabError("not a line of JSON") from None
    if not isinstance(found, dict):
        raise LabError("not an object")
    return found


def _source(entry: object) -> Source:
    if not isinstance(entry, dict):
        raise LabError("an input has no path or no hash")
    path = entry.get("path")
    digest = entry.get("sha256")
    if not (path is None or isinstance(path, str)) or not isinstance(digest, str):
        raise LabError("an input has no path or no hash")
    if not HEX.fullmatch(digest):
        raise LabError("an input has no hash")
    return Source(path, digest)


def _hashes(inputs: Inputs) -> tuple[str, ...]:
    return (*(run.sha256 for run in inputs.runs), inputs.bundle.sha256)


def _diagnosis_file(name: object) -> str:
    if not isinstance(name, str) or not DIAGNOSIS.fullmatch(name):
        raise LabError(f"{name!r:.40} is not a diagnosis of this folder")
    return name


def _step(line: Document) -> Step:
    file = line.get("diagnosis")
    errors = line.get("errors_mm", [])
    return Step(
        names_in(line.get("effects")),
        numbers_in(line.get("params", {})),
        None if file is None else _diagnosis_file(file),
        tuple(_number(error) for error in _list(errors)),
    )


def _list(value: object) -> list[Any]:
    if not isinstance(value, list) or len(value) > MOST_NUMBERS:
        raise LabError(f"{type(value).__name__}, expected a list of at most {MOST_NUMBERS}")
    return value


def _number(value: object) -> float:
    if not finite(value, LARGEST):
        raise LabError(f"{value!r:.40} is not a number within ±{LARGEST:g}")
    return float(value)


def names_in(value: object) -> tuple[str, ...]:
    """Return the names of effects in a message or a line.

    Raises:
        LabError: not a list of names, too many, or one twice.
    """
    names = _list(value)
    wrong = [n for n in names if not isinstance(n, str) or not 0 < len(n) <= LONGEST_NAME]
    if wrong or len(names) > MOST_EFFECTS or len(set(names)) < len(names):
        raise LabError(f"'effects' is not a list of at most {MOST_EFFECTS} different names")
    return tuple(names)


def numbers_in(value: object) -> dict[str, float]:
    """Return parameters by label.

    Raises:
        LabError: not an object of finite numbers, or too many.
    """
    if not isinstance(value, dict) or len(value) > MOST_NUMBERS:
        raise LabError(f"'params' is not an object of at most {MOST_NUMBERS} numbers")
    return {str(label)[:LONGEST_NAME]: _number(number) for label, number in value.items()}


def step_document(step: Step) -> Document:
    """Return a step as in a line of the journal, for JSON."""
    return {
        "effects": list(step.effects),
        "params": dict(step.params),
        "diagnosis": step.diagnosis,
        "errors_mm": list(step.errors_mm),
    }


def read_inputs(folder: str | Path) -> Inputs | None:
    """Return the inputs of the session in a folder; None if there is none.

    Raises:
        LabError: as `Journal`.
    """
    if not (Path(folder) / JOURNAL).is_file():
        return None
    journal = Journal(folder)
    journal.close()
    return journal.state.inputs


def as_inputs(runs: Sequence[tuple[str, str]], bundle: tuple[str | None, str]) -> Inputs:
    """Return inputs from pairs of path and hash."""
    return Inputs(tuple(Source(*run) for run in runs), Source(*bundle))

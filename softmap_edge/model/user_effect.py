"""A user-defined effect: a Python file that declares a law of the commands.

The file holds `EFFECT`, the declaration, and `rollout(params (B, P), u (B, T, C) mm, t (T,) s,
ctx)`, which returns the effective commands (B, T, C) mm. `template` writes a working example.
Loading executes the file with all rights of the process, so nothing here loads one unasked. The
effect joins the library of this process. A bundle carries a copy and its hash; its user decides. A
name stands for one file: another file of the same name is rejected until `forget_effect`. The law
is called for each record with B = 1, keeps no state between calls, and starts in equilibrium with
its first sample. For each number of channels one test checks that it changes nothing at its null
values. It has no step function, so control loops reject it. Pinned by
tests/model/test_own_effect.py and tests/model/test_own_effect_bundles.py.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import EffectError, brief
from softmap_edge.files.atomic import Document, finite
from softmap_edge.model.effect_info import registry
from softmap_edge.model.manifest import EFFECT_NAME, MAX_EFFECT_BYTES

Floats = NDArray[np.float64]

STAGES = ("command", "transmission", "material")
FIELDS = ("gravity", "load", "temperature")  # fields of a run that a law may need besides commands
LONGEST = 1000  # characters of a text
NULL_MM = 1e-9  # allowed change of a 1 mm command at null values: round-off

_TEXTS = ("stage", "formula", "doc", "signature")
_OPTIONAL = {
    "family": "own",
    "reference": "a user's own file",
    "experiment": ("what its signature asks for", 1.0),
    "needs": (),
}
_NUMBERS = ("null", "start", "low", "high")
_SWITCHES = {"per_channel": False, "shared": False, "integer": False}


@dataclass(frozen=True)
class Context:
    """The conditions of a record.

    They are dt (T,) s since the previous sample, gravity (T, 3) unit vectors in the base frame,
    load (T,) g and temperature (T,) °C (NaN where the run has none).
    """

    dt: Floats
    gravity: Floats
    load: Floats
    temperature: Floats


@dataclass(frozen=True)
class OwnEffect:
    """A loaded effect: its name, source file, text and hash."""

    name: str
    file: Path
    source: bytes
    sha256: str


_LOADED: dict[str, OwnEffect] = {}
_RUNNING: set[int] = set()  # threads that are running a law


def load_effect(path: str | Path, sha256: str | None = None) -> OwnEffect:
    """Execute the file at `path` (reported on stderr) and add its effect to those of this process.

    Args:
        path: the Python file; a file that is already loaded is not executed again.
        sha256: the required hash, if the file has been confirmed.

    Returns:
        OwnEffect: its name, file, source and hash.

    Raises:
        EffectError: an unreadable file, another hash, failing code, a wrong declaration, or a name
            that is taken.
    """
    file = Path(path)
    source = _read(file)
    digest = hashlib.sha256(source).hexdigest()
    if sha256 is not None and digest != sha256:
        raise EffectError(
            f"{file}: its sha256 is {digest[:12]}…, expected {sha256[:12]}…; it was changed, so "
            "it is not run"
        )
    for known in _LOADED.values():
        if known.sha256 == digest:
            return known
    print(f"softmap: {file.name} is code and runs with your rights", file=sys.stderr)
    module = _execute(file, source)
    declaration = _declaration(file.name, getattr(module, "EFFECT", None))
    rollout = getattr(module, "rollout", None)
    if not callable(rollout):
        raise EffectError(
            f"{file.name}: it has no function `rollout`; `softmap model effects new NAME` writes "
            "the form"
        )
    name = declaration["name"]
    if name in _LOADED:
        raise EffectError(
            f"{file}: another file of the effect '{name}' is loaded ({_LOADED[name].file}); one "
            f"name stands for one file: forget_effect('{name}') first, or start again"
        )
    _core.register(declaration, _Law(declaration, file, rollout))
    _LOADED[name] = OwnEffect(name, file, source, digest)
    return _LOADED[name]


def forget_effect(name: str) -> None:
    """Remove a user-defined effect from the library; models with it can no longer be evaluated.

    Raises:
        SoftmapError: no such effect was loaded.
    """
    _core.forget(name)
    del _LOADED[name]


def loaded() -> Mapping[str, OwnEffect]:
    """Return the user-defined effects of this process by name."""
    return dict(_LOADED)


def hashes(names: Sequence[str]) -> dict[str, str]:
    """Return the SHA-256 of the files of the user-defined effects among `names`."""
    return {name: _LOADED[name].sha256 for name in names if name in _LOADED}


def check_hashes(names: Sequence[str], fitted: object) -> None:
    """Reject numbers that were fitted with other effect files than those loaded.

    `fitted` holds the hashes of a document.

    Raises:
        EffectError: a file is not loaded, or differs.
    """
    for name, digest in (fitted if isinstance(fitted, dict) else {}).items():
        known = _LOADED.get(name)
        if name in names and (known is None or known.sha256 != digest):
            here = (
                "none of that name is loaded"
                if known is None
                else f"{known.file} is another ({known.sha256[:12]}…)"
            )
            raise EffectError(
                f"'{name}' was fitted as a Python file of sha256 {digest!s:.12}…, {here}; give "
                "that file with --effects"
            )


def template(name: str) -> str:
    """Return the text of a working effect file with this name.

    Raises:
        EffectError: the name is taken or invalid.
    """
    _check_name("effects new", name)
    if name in registry():
        raise EffectError(f"there is an effect '{name}' already; give yours another name")
    return _TEMPLATE.replace("NAME", name)


_TEMPLATE = '''"""NAME: what it is. `softmap diagnose RUN --effects NAME.py` tries it (docs/do/own_effect.md)."""

import numpy as np

EFFECT = {
    "name": "NAME",
    "stage": "transmission",  # command, transmission or material: where it acts
    "formula": "x = u · (1 + share · tanh(u / reach))",
    "doc": "What it is, in a sentence or two.",
    "signature": "What the error looks like while it is missing.",
    "parameters": [  # nothing changes at null; a fit begins at start and searches from low to high
        {"name": "share", "unit": "1", "null": 0.0, "start": 0.1, "low": -0.5, "high": 0.5,
         "doc": "how much"},
        {"name": "reach", "unit": "mm", "null": 5.0, "start": 5.0, "low": 1.0, "high": 20.0,
         "doc": "from where on"},
    ],
}


def rollout(params, u, t, ctx):
    """Return the effective commands (B, T, C) mm of u (B, T, C) mm, t (T,) s and params (B, P)."""
    # ctx has dt (T,), gravity (T, 3), load (T,) and temperature (T,)
    share, reach = params[:, 0, None, None], params[:, 1, None, None]  # (B, 1, 1)
    return u * (1.0 + share * np.tanh(u / reach))
'''


# --- reading and checking -----------------------------------------------------------------------


def _read(file: Path) -> bytes:
    if file.suffix != ".py" or not file.is_file():
        raise EffectError(f"{file}: no Python file; `softmap model effects new NAME` writes one")
    if file.stat().st_size > MAX_EFFECT_BYTES:
        raise EffectError(
            f"{file}: {file.stat().st_size} bytes, an effect has at most {MAX_EFFECT_BYTES}"
        )
    return file.read_bytes()


def _execute(file: Path, source: bytes) -> ModuleType:
    module = ModuleType(f"softmap_own_{file.stem}")
    module.__file__ = str(file)
    # its output must not enter a document
    module.__dict__["print"] = functools.partial(print, file=sys.stderr)
    sys.modules[module.__name__] = module  # dataclasses look up their module
    try:
        with contextlib.redirect_stdout(sys.stderr):
            exec(compile(source, str(file), "exec"), module.__dict__)
    except KeyboardInterrupt:
        raise
    except BaseException as fault:
        del sys.modules[module.__name__]
        raise EffectError(f"{file.name}{_line(fault, file)} does not run: {_said(fault)}") from None
    return module


def _declaration(where: str, given: object) -> Document:
    """Return the declaration of a file, complete and with correct types."""
    if not isinstance(given, dict):
        raise EffectError(
            f"{where}: EFFECT is missing or no table; `softmap model effects new NAME` writes the "
            "form"
        )
    known = ("name", *_TEXTS, "parameters", *_OPTIONAL)
    _keys(where, "EFFECT", given, ("name", *_TEXTS, "parameters"), known)
    found: Document = _OPTIONAL | given
    _check_name(where, found["name"])
    for key in (*_TEXTS, "family", "reference"):
        found[key] = _text(where, key, found[key])
    if found["stage"] not in STAGES:
        raise EffectError(
            f"{where}: the stage is '{found['stage']}'; {', '.join(STAGES)} are allowed"
        )
    if not isinstance(found["needs"], list | tuple):
        raise EffectError(
            f"{where}: needs is {type(found['needs']).__name__}; give a list of {', '.join(FIELDS)}"
        )
    found["needs"] = [str(field) for field in found["needs"]]
    wrong = [field for field in found["needs"] if field not in FIELDS]
    if wrong:
        raise EffectError(f"{where}: it needs '{wrong[0]}'; a law may need {', '.join(FIELDS)}")
    block, minutes = _pair(where, found["experiment"])
    found["experiment"] = (_text(where, "experiment", block), minutes)
    if not isinstance(found["parameters"], list | tuple) or not 1 <= len(found["parameters"]) <= 32:
        raise EffectError(f"{where}: `parameters` is a list of 1 to 32 tables")
    found["parameters"] = [_parameter(where, p) for p in found["parameters"]]
    names = [p["name"] for p in found["parameters"]]
    if len(set(names)) < len(names):
        raise EffectError(
            f"{where}: two parameters have one name among {', '.join(names)}; names must differ"
        )
    return found


def _parameter(where: str, given: object) -> Document:
    if not isinstance(given, dict):
        raise EffectError(
            f"{where}: a parameter is {type(given).__name__}, expected a table with name, unit, "
            "null, …"
        )
    required = ("name", "unit", *_NUMBERS, "doc")
    _keys(where, "a parameter", given, required, (*required, *_SWITCHES))
    found: Document = _SWITCHES | given
    _check_name(where, found["name"])
    label = f"parameter {found['name']}"
    found["unit"], found["doc"] = (
        _text(where, f"{key} of {label}", found[key]) for key in ("unit", "doc")
    )
    for key in _SWITCHES:
        if not isinstance(found[key], bool):
            raise EffectError(
                f"{where}: {label}: {key} is {found[key]!r:.40}, expected True or False"
            )
    found["per_channel"] |= found["shared"]  # one number per channel, shared in a fit or not
    for key in _NUMBERS:
        value = found[key]
        if not finite(value):
            raise EffectError(f"{where}: {label}: {key} is {value!r:.40}, expected a finite number")
        found[key] = float(value)
    if not (found["low"] < found["high"] and found["low"] <= found["start"] <= found["high"]):
        raise EffectError(
            f"{where}: {label}: low {found['low']:g}, start {found['start']:g}, high "
            f"{found['high']:g}; start must lie between low and high"
        )
    return found


def _keys(
    where: str,
    what: str,
    given: Mapping[object, object],
    required: tuple[str, ...],
    known: tuple[str, ...],
) -> None:
    missing = [key for key in required if key not in given]
    if missing:
        raise EffectError(f"{where}: {what} has no '{missing[0]}'; it takes {', '.join(known)}")
    odd = [key for key in given if key not in known]
    if odd:
        raise EffectError(f"{where}: {what} has '{odd[0]!s:.40}'; it takes {', '.join(known)}")


def _check_name(where: str, name: object) -> None:
    if not isinstance(name, str) or not EFFECT_NAME.fullmatch(name):
        raise EffectError(
            f"{where}: the name {name!r:.60}; small letters, digits and _ are allowed, a letter "
            "first, at most 40"
        )


def _text(where: str, key: str, value: object) -> str:
    if not isinstance(value, str) or not value.isprintable() or not 1 <= len(value) <= LONGEST:
        raise EffectError(
            f"{where}: {key} is {value!r:.60}, expected one printable line of at most {LONGEST} "
            "characters"
        )
    return value


def _pair(where: str, value: object) -> tuple[object, float]:
    if isinstance(value, list | tuple) and len(value) == 2:
        block, minutes = value
        if finite(minutes) and 0 < minutes < 1e4:
            return block, float(minutes)
    raise EffectError(
        f"{where}: experiment is {value!r:.60}, expected what to record and how many minutes that "
        "takes"
    )


# --- the law as the core asks it ----------------------------------------------------------------


class _Law:
    """Call a user's `rollout` for one record, and report failures and wrong results in one line."""

    def __init__(self, declaration: Document, file: Path, rollout: Callable[..., object]) -> None:
        self._declaration, self._file, self._rollout = declaration, file, rollout
        self._head = f"the effect '{declaration['name']}' ({file.name})"
        self._tried: set[int] = set()

    def __call__(
        self,
        params: Floats,
        u: Floats,
        t: Floats,
        gravity: Floats,
        load: Floats,
        temperature: Floats,
    ) -> Floats:
        """Return effective commands (T, C) for params (P,) on u (T, C); arguments are read-only."""
        context = Context(np.diff(t, prepend=t[:1]), gravity, load, temperature)
        for array in (params, u, t, context.dt, gravity, load, temperature):
            array.flags.writeable = False
        channels = u.shape[1]
        if channels not in self._tried:
            null = [
                p["null"]
                for p in self._declaration["parameters"]
                for _ in range(channels if p["per_channel"] else 1)
            ]
            away = float(np.abs(self._ask(np.array(null), u, t, context) - u).max())
            if away > NULL_MM * max(1.0, float(np.abs(u).max())):
                raise EffectError(
                    f"{self._head} changes the command by up to {away:.3g} at its null values; "
                    "there it must not"
                )
            self._tried.add(channels)
        return self._ask(params, u, t, context)

    def _ask(self, params: Floats, u: Floats, t: Floats, context: Context) -> Floats:
        shape = (1, *u.shape)
        required = (
            f"rollout(params (1, {params.size}), u {shape}, t ({t.size},), ctx) must return what "
            f"acts, {shape}"
        )
        me = threading.get_ident()
        _RUNNING.add(me)
        try:
            # non-finite results are reported below, with their parameters
            with np.errstate(all="ignore"):
                given = self._rollout(params[None], u[None], t, context)
        except BaseException as fault:
            if me not in _RUNNING:
                raise EffectError(f"{self._head} was interrupted") from None
            raise EffectError(
                f"{self._head}{_line(fault, self._file)} raised {_said(fault)}; {required}"
            ) from None
        finally:
            _RUNNING.discard(me)
        answer = (
            np.asarray(given)
            if isinstance(given, np.ndarray | list | tuple | float | int)
            else None
        )
        if answer is None or answer.dtype.kind not in "biuf":
            kind = type(given).__name__ if answer is None else f"an array of {answer.dtype}"
            raise EffectError(f"{self._head} returned {kind}; {required}")
        if answer.shape != shape:
            raise EffectError(f"{self._head} returned an array of shape {answer.shape}; {required}")
        if not np.isfinite(answer).all():
            sample, channel = np.argwhere(~np.isfinite(answer[0]))[0]
            numbers = ", ".join(f"{value:.4g}" for value in params[:8])
            raise EffectError(
                f"{self._head} returned {answer[0, sample, channel]} at sample {sample}, channel "
                f"{channel}, for params {numbers}; every parameter from low to high must give "
                "finite numbers"
            )
        return np.ascontiguousarray(answer[0], np.float64)


def interrupt() -> None:
    """Raise KeyboardInterrupt in threads that run laws, because they receive no signals."""
    for thread in list(_RUNNING):
        _RUNNING.discard(thread)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(thread), ctypes.py_object(KeyboardInterrupt)
        )


def _line(fault: BaseException, file: Path) -> str:
    """Return a text with the line of the user's file that failed."""
    if isinstance(fault, SyntaxError):
        return f", line {fault.lineno}," if fault.lineno else ""
    lines = [
        at.lineno for at in traceback.extract_tb(fault.__traceback__) if at.filename == str(file)
    ]
    return f", line {lines[-1]}," if lines else ""


def _said(fault: BaseException) -> str:
    return f"{type(fault).__name__}: {brief(fault)}" if str(fault) else type(fault).__name__

"""How the tests spoil a file and use it: in a child process with a memory and a time limit, from
fixed seeds.

The child is the test file itself, run as a program. Archives are spoiled inside and packed again
with right checksums, and a bundle's hashes are put right, so that the damage gets past the first
door.
"""

import faulthandler
import io
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import traceback
import warnings
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

MEMORY = 3 * 2**30  # bytes of address space: the interpreter, numpy and a sample take under 1 GiB
PATIENCE = 20.0  # s for one file
NUMBERS = [
    "nan",
    "-nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "0",
    "-0",
    "-1",
    "1e5",
    "2147483648",
]
NUMBERS += ["9223372036854775808", "0x10", "1_0"]
WORDS = [
    "true",
    '""',
    "''",
    "[]",
    "[[]]",
    "{}",
    '"\\u0000"',
    "é",
    "\ufeff",
    "\0",
    ",",
    ";",
    "\n",
    "\r",
    '"',
    "=",
    "#",
]
NASTY = [
    *NUMBERS,
    *WORDS,
    "1" * 400,
    "[" * 300,
    "[[log]]",
    "a = 1",
    "1979-05-27T07:32:00Z",
    "../../x",
]


@dataclass(frozen=True)
class Format:
    """A kind of file: how a sound sample is made, spoiled and used."""

    name: str
    sample: Callable[[Path], Path]
    spoil: Callable[[Path, Path, np.random.Generator], Path]
    use: Callable[[Path], object]
    some: int = 50  # spoiled by `make test`; `make test-long` spoils 500, `make prove` 10 000
    felt: float = 0.2  # the share that is refused at least: numbers of a log may be anything


# --- damage --------------------------------------------------------------------------------
def spoil_bytes(data, rng):
    """One to four local injuries: flipped, lost, doubled, swapped, overwritten or cut bytes."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        if not data:
            break
        at, length = int(rng.integers(len(data))), int(rng.integers(1, 1 + min(64, len(data))))
        match rng.integers(6):
            case 0:
                data[at] ^= 1 << int(rng.integers(8))
            case 1:
                del data[at : at + length]
            case 2:
                data[at:at] = data[at : at + length]
            case 3:
                data[at : at + length] = bytes([int(rng.integers(256))]) * length
            case 4:
                data[at : at + length] = rng.bytes(length)
            case _:
                del data[at:]
    return bytes(data)


def spoil_text(text, rng):
    """Replace, drop or double words and lines, put in what parsers dislike; now and then injure the
    bytes.
    """
    if rng.random() < 0.2:
        return spoil_bytes(text.encode(), rng)
    for _ in range(rng.integers(1, 4)):
        words = list(re.finditer(r"[\w.+-]+|[^\w\s]", text))
        word = words[int(rng.integers(len(words)))] if words else None
        lines = text.split("\n")
        line = int(rng.integers(len(lines)))
        kind = int(rng.integers(5))
        if kind <= 1 and word:
            text = text[: word.start()] + NASTY[int(rng.integers(len(NASTY)))] + text[word.end() :]
        elif kind == 2 and word:
            text = text[: word.start()] + text[word.end() :]
        elif kind == 3:
            text = "\n".join(lines[:line] + lines[line + 1 :])
        else:
            text = "\n".join([*lines[:line], lines[line], *lines[line:]])
    return text.encode("utf-8", "replace")


def spoil_npz(data, rng):
    """Injure the archive itself, or an array in it (its header, its type, its values), packed again
    soundly.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = [[entry.filename, archive.read(entry)] for entry in archive.infolist()]
    if rng.random() < 0.25 or not entries:
        return spoil_bytes(data, rng)
    entry = entries[int(rng.integers(len(entries)))]
    kind = int(rng.integers(6))
    if kind == 0:
        entry[1] = spoil_bytes(entry[1], rng)
    elif kind == 1:  # the header only
        cut = entry[1].index(b"\n") + 1
        entry[1] = spoil_text(entry[1][10:cut].decode("latin1"), rng).join(
            [entry[1][:10], entry[1][cut:]]
        )
    elif kind == 2:
        entries.remove(entry)
    elif kind == 3:  # another array under its name
        entry[1] = packed(odd_array(rng))
    elif kind == 4:  # some values are odd
        array = np.load(io.BytesIO(entry[1]))
        if array.dtype.kind in "iuf" and array.size:
            array = array.astype(float)
            where = rng.integers(array.size, size=3)
            array.reshape(-1)[where] = rng.choice(
                [np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1e-320, 2**53, 1e5], 3
            )
        entry[1] = packed(array.reshape(-1)[:-1] if rng.random() < 0.2 else array)
    else:
        entry[0] = entries[int(rng.integers(len(entries)))][0]
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # two entries of one name are meant
        for name, raw in entries:
            archive.writestr(name, raw)
    return stream.getvalue()


def odd_array(rng):
    shape = tuple(int(n) for n in rng.integers(0, 5, int(rng.integers(0, 5))))
    dtype = str(
        rng.choice(
            ["<f8", ">f4", "<i8", "|u1", "|b1", "<U3", "|S2", "<c16", "<M8[s]", "<f2", "<U0"]
        )
    )
    return np.zeros(shape, dtype)


def packed(array):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)
    return stream.getvalue()


def spoil_npz_file(sample, folder, rng):
    (folder / "bad.npz").write_bytes(spoil_npz(sample.read_bytes(), rng))
    return folder / "bad.npz"


def spoil_text_file(sample, folder, rng):
    (folder / sample.name).write_bytes(spoil_text(sample.read_text(encoding="utf-8"), rng))
    return folder / sample.name


def spoil_one_of(name):
    """Spoil one file of a folder and copy the others."""

    def spoil(sample, folder, rng):
        for path in sample.iterdir():
            data = spoil_text(path.read_text(), rng) if path.name == name else path.read_bytes()
            (folder / path.name).write_bytes(data)
        return folder

    return spoil


def spoil_bundle(sample, folder, rng):
    """Spoil one file of the bundle; mostly its hash in the manifest is put right again."""
    shutil.copytree(sample, folder / "bundle", dirs_exist_ok=True)
    files = sorted(path for path in (folder / "bundle").iterdir() if path.is_file())
    victim = files[int(rng.integers(len(files)))]
    data = victim.read_bytes()
    victim.write_bytes(
        spoil_npz(data, rng) if victim.suffix == ".npz" else spoil_text(data.decode(), rng)
    )
    manifest = folder / "bundle" / "manifest.json"
    if victim != manifest and rng.random() < 0.9:
        document = json.loads(manifest.read_text(encoding="utf-8"))
        hashes, key = (
            (document["own_effects"], victim.stem)
            if victim.suffix == ".py"
            else (document["sha256"], victim.name)
        )
        hashes[key] = sha256(victim.read_bytes()).hexdigest()
        manifest.write_text(json.dumps(document), encoding="utf-8")
    return folder / "bundle"


# --- the child -----------------------------------------------------------------------------
class Hang(BaseException):
    """One file took longer than PATIENCE."""


def _hang(*_):
    raise Hang


def child(forms, name, first, count, folder):
    """Spoil and use samples; print how many were refused and accepted, or the first that broke a
    promise.
    """
    from softmap_edge.errors import SoftmapError

    form = next(form for form in forms if form.name == name)
    (folder / "sound").mkdir()
    sample = form.sample(folder / "sound")
    form.use(sample)  # the sample itself is sound
    signal.signal(signal.SIGALRM, _hang)
    faulthandler.enable()  # a crash of the compiled core says where
    refused = accepted = 0
    for seed in range(first, first + count):
        (folder / "seed").write_text(str(seed))  # what a crash leaves behind
        place = folder / "place"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        spoilt = form.spoil(sample, place, np.random.default_rng([seed, len(name)]))
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)
        # compiled code does not hear the alarm
        faulthandler.dump_traceback_later(2 * PATIENCE, exit=True)
        try:
            form.use(spoilt)
            accepted += 1
        except SoftmapError as fault:
            refused += 1
            if "\n" in str(fault) or not str(fault).strip() or len(str(fault)) > 1000:
                print(f"seed {seed}: the message is not one line: {str(fault)[:2000]!r}")
                return 1
        except BaseException:
            print(f"seed {seed}: not an error of ours:\n{traceback.format_exc()}")
            return 1
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            faulthandler.cancel_dump_traceback_later()
    print(json.dumps({"refused": refused, "accepted": accepted}))
    return 0


def spoil_many(script, form, first, count, folder):
    """Run a child over the seeds `first` and on; a child that fails, dies or hangs is reported with its
    format and seed.
    """

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    folder.mkdir(exist_ok=True)
    argv = [sys.executable, "-W", "error", script, form.name, str(first), str(count), str(folder)]
    path = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {
        "OPENBLAS_NUM_THREADS": "1",
        "RAYON_NUM_THREADS": "1",
        "PYTHONPATH": path,
    }
    try:
        done = subprocess.run(
            argv,
            capture_output=True,
            text=True,
            timeout=120 + count,
            preexec_fn=limit,
            env=environment,
            check=False,
        )
        end, said = f"exit {done.returncode}", done.stdout[-3000:] + done.stderr[-3000:]
    except subprocess.TimeoutExpired as late:
        done, end, said = None, f"stopped after {late.timeout:.0f} s", ""
    seed = (folder / "seed").read_text() if (folder / "seed").exists() else "none"
    again = f"{Path(script).name} '{form.name}' {seed} 1 FOLDER"
    assert done is not None and done.returncode == 0, (
        f"{form.name}, seed {seed}: {end}; again: {again}\n{said}"
    )
    return json.loads(done.stdout)


def assert_some(script, form, folder, count=None):
    """Every one of `count` damaged files is refused by an error of ours or used to the end."""
    count = count or form.some
    result = spoil_many(script, form, 0, count, folder)
    assert result["refused"] + result["accepted"] == count
    # the damage is felt: an oracle that accepts everything fails here
    assert result["refused"] > count * form.felt


def assert_10000(script, form, folder):
    """The same for 10 000, several children at a time."""
    parts = range(0, 10_000, 2500)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(
            pool.map(
                lambda first: spoil_many(script, form, first, 2500, folder / str(first)), parts
            )
        )
    assert sum(result["refused"] + result["accepted"] for result in results) == 10_000
    assert sum(result["refused"] for result in results) > 10_000 * form.felt


def run_all(forms):
    """Be the child: `python FILE FORMAT SEED COUNT FOLDER`."""
    sys.exit(child(forms, sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])))

"""The file `hand_landmarker.task`, which mediapipe needs and does not ship.

It is built from an older mediapipe wheel, or copied. A task file is an uncompressed zip of two
TFLite networks. Google's mediapipe wheel 0.10.18 (Apache 2.0) contains them; the landmarks equal
those of the published task file. The source file is not trusted: sizes are bounded before anything
is read, nothing is unpacked to disk, and only valid networks are written. The checksum is stored
next to the file in `sha256sum` format and verified at each use. Pinned by
tests/robot/test_model_file.py.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.errors import TeleopError
from softmap_edge.files.atomic import replacement_of, sha256_of, write_atomically
from softmap_edge.files.refusals import refusal

DETECTOR, LANDMARKS = "hand_detector.tflite", "hand_landmarks_detector.tflite"
IN_WHEEL = {
    DETECTOR: "mediapipe/modules/palm_detection/palm_detection_full.tflite",
    LANDMARKS: "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
}
WHEEL = (
    "pip download mediapipe==0.10.18 --no-deps --python-version 3.11 "
    "--platform manylinux2014_x86_64 --only-binary :all:"
)
# SHA-256 of the task file built from wheel 0.10.18
KNOWN = {"ef3f184fa8d5e6905ea4770282627d6937975119af763054312d05985c059bda": "mediapipe 0.10.18"}
LARGEST_SOURCE = 256 << 20  # bytes; mediapipe wheels have about 40 MB
LARGEST_NETWORK = 32 << 20  # bytes; the larger network has 5.5 MB
MOST_MEMBERS = 20_000  # files of a wheel, which has about 700


@dataclass(frozen=True)
class HandModel:
    """A complete task file: its path, its SHA-256, and its known name (empty if unknown)."""

    path: Path
    sha256: str
    known_as: str

    def __str__(self) -> str:
        return (
            f"{self.path}: sha256 {self.sha256} ({self.known_as or 'not one that is known here'})"
        )


def default_path() -> Path:
    """Return the default path of the model, in the user's data folder."""
    home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share"
    return Path(home) / "softmap" / "hand_landmarker.task"


def fetch_model(
    source: str | Path, to: str | Path | None = None, *, force: bool = False
) -> HandModel:
    """Build the task file from a wheel of mediapipe 0.10.18, or copy a task file.

    Write its checksum next to it.

    Args:
        source: wheel or task file, distinguished by content, not by name
        to: file to write, by default `default_path()`; its folder is created
        force: replace an existing file

    Raises:
        TeleopError: the source is neither, is too large or damaged, or `to` exists.
    """
    target = default_path() if to is None else Path(to)
    networks, is_task = _networks(Path(source))
    if target.exists() and not force:
        raise TeleopError(f"{target}: is there already; --force replaces it, --model names another")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacement_of(target) as partial:
            if is_task:
                partial.write_bytes(Path(source).read_bytes())
            else:
                with zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as task:
                    for name, network in networks.items():
                        # without a date, so that the bytes are the same each time
                        task.writestr(zipfile.ZipInfo(name), network)
            sha256 = hashlib.sha256(partial.read_bytes()).hexdigest()
            # so that the old checksum never stands next to the new file
            _record(target).unlink(missing_ok=True)
        write_atomically(_record(target), f"{sha256}  {target.name}\n")
    except OSError as cause:
        raise TeleopError(refusal(cause, target)) from None
    return check_model(target)


def check_model(path: str | Path) -> HandModel:
    """Return the task file at `path` if it is complete and matches its checksum.

    Raises:
        TeleopError: it is missing, is not a task file, or does not match its checksum.
    """
    file = Path(path)
    if not file.exists():
        raise TeleopError(
            f"{file}: no model of hands; get the wheel with '{WHEEL}' and run softmap teleop "
            "--fetch-model FROM"
        )
    _networks(file)
    sha256 = sha256_of(file)
    record = _record(file)
    if record.is_file():
        with record.open("rb") as stream:
            recorded = stream.read(64).decode("ascii", "replace")
        if recorded != sha256:
            raise TeleopError(
                f"{file}: SHA-256 {sha256[:16]}…, but {record.name} states {recorded[:16]!r}…; fetch "
                "the model again"
            )
    return HandModel(file, sha256, KNOWN.get(sha256, ""))


def _record(file: Path) -> Path:
    return file.with_name(file.name + ".sha256")


def _networks(file: Path) -> tuple[dict[str, bytes], bool]:
    """Return the two networks of a wheel or task file by name, and whether it is a task file."""
    if not file.is_file():
        raise TeleopError(
            f"{file}: no such file; give a wheel of mediapipe 0.10.18, or a hand_landmarker.task"
        )
    size = file.stat().st_size
    if size > LARGEST_SOURCE:
        raise TeleopError(f"{file}: {size >> 20} MB, at most {LARGEST_SOURCE >> 20} MB are read")
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            names = [member.filename for member in members]
            if len(names) > MOST_MEMBERS or len(set(names)) < len(names):
                raise TeleopError(
                    f"{file}: {len(names)} entries, up to {MOST_MEMBERS} of different names are "
                    "read"
                )
            if set(names) == {DETECTOR, LANDMARKS}:
                if any(member.compress_type != zipfile.ZIP_STORED for member in members):
                    raise TeleopError(
                        f"{file}: its networks are compressed, which mediapipe cannot read; fetch "
                        "it again"
                    )
                places = {DETECTOR: DETECTOR, LANDMARKS: LANDMARKS}
            elif set(IN_WHEEL.values()) <= set(names):
                places = IN_WHEEL
            else:
                raise TeleopError(
                    f"{file}: holds no model of hands; give a wheel of mediapipe 0.10.18 "
                    f"('{WHEEL}'), or a task file of {DETECTOR} and {LANDMARKS}"
                )
            networks = {name: _network(file, archive, place) for name, place in places.items()}
            return networks, places is not IN_WHEEL
    except TeleopError:
        raise
    # zipfile, zlib, struct and codecs raise different errors on a damaged archive
    except Exception as fault:
        raise TeleopError(
            f"{file}: is not a zip archive, or a damaged one ({type(fault).__name__}: "
            f"{fault!s:.60}); get it again"
        ) from None


def _network(file: Path, archive: zipfile.ZipFile, place: str) -> bytes:
    with archive.open(place) as stream:
        content = stream.read(LARGEST_NETWORK + 1)  # bounded, whatever size the entry declares
    if len(content) > LARGEST_NETWORK:
        raise TeleopError(
            f"{file}: {place} has more than {LARGEST_NETWORK >> 20} MB; no network of hands does"
        )
    if content[4:8] != b"TFL3":
        raise TeleopError(f"{file}: {place} is not a network in TFLite's form; get it again")
    return content

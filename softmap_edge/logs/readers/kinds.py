"""Detect a log's format from its first bytes; report unsupported formats with a remedy.

The file name decides only if the bytes do not (.c3d, .trc, .mat of MATLAB 4). Pinned by
tests/logs/test_formats.py.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.files.npz import check_directory
from softmap_edge.logs.readers.encoding import encoding_of_start, is_wide
from softmap_edge.logs.readers.json_lines import WAY_OUT, is_json, is_json_lines
from softmap_edge.logs.readers.mcap_file import MAGIC
from softmap_edge.logs.readers.mocap import is_motive, is_trc
from softmap_edge.logs.readers.packed import GZIP, ZSTD, skipped_frames
from softmap_edge.logs.readers.rosbag_sqlite import MAGIC as SQLITE
from softmap_edge.logs.readers.typed_rows import is_typed
from softmap_edge.logs.readers.vendor_text import is_lvm, is_nexus, is_qtm

RECORDINGS = ("mcap", "db3")  # several topics, with the time of recording
ARRAYS = ("npz", "npy", "mat", "hdf5", "parquet")
PACKED = ("zstd", "gzip")
BINARY = (*RECORDINGS, *ARRAYS, "c3d")
HDF5 = b"\x89HDF\r\n\x1a\n"
_HEAD = 4096  # bytes of a file that are tested
_SURE = 8  # letters that text hardly begins with
_READ: tuple[tuple[bytes, str], ...] = (
    (MAGIC, "mcap"),
    (SQLITE, "db3"),
    (b"\x93NUMPY", "npy"),
    (HDF5, "hdf5"),
    (b"PAR1", "parquet"),
)
_READ += (
    (ZSTD, "zstd"),
    (GZIP, "gzip"),
    (b"MATLAB 5.0 MAT-file", "mat"),
    (b"MATLAB 7.3 MAT-file", "hdf5"),
)
_TEXTS = {
    "trc": is_trc,
    "motive": is_motive,
    "qtm": is_qtm,
    "nexus": is_nexus,
    "lvm": is_lvm,
    "typed": is_typed,
    "jsonl": is_json_lines,
}
_CONVERT_BAG = "`rosbags-convert --src {file} --dst FOLDER` (pip install rosbags)"
_BAG = f"a ROS 1 bag: convert it with {_CONVERT_BAG}"
_SHEET = "save the sheet as CSV"
_PACK = "unpack it and give the log inside"
_CONVERT = "export its signals as CSV or MCAP"
_PICTURE = "a picture or video, no log; give the log of the recording"
# unsupported formats: first bytes, name and remedy
_FOREIGN: tuple[tuple[bytes, str], ...] = (
    (b"#ROSBAG V", _BAG),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", f"an old spreadsheet or document (.xls): {_SHEET}"),
    (
        b"TDSm",
        "a LabVIEW TDMS file: open it in Excel with NI's TDM add-in and save it as CSV, or write "
        "LVM instead",
    ),
    (b"ULog\x01\x12\x35", "a PX4 ULog: convert it with `ulog2csv {file}`"),
    (b"RRF", f"a Rerun recording: {_CONVERT}"),
    (b"MDF     ", f"an ASAM MDF file: {_CONVERT}"),
    (b"LOGG", f"a CAN log (.blf): {_CONVERT}"),
    (
        b"ARROW1",
        "an Arrow or Feather file: write it as Parquet, with `pyarrow.parquet.write_table`",
    ),
    (b"FEA1", "an old Feather file: write it as Parquet, with `pyarrow.parquet.write_table`"),
    (b"Obj\x01", "an Avro file: write it as Parquet or CSV"),
    (b"7z\xbc\xaf\x27\x1c", f"a 7z archive: {_PACK}"),
    (b"Rar!\x1a\x07", f"a RAR archive: {_PACK}"),
    (b"\xfd7zXZ", f"packed by xz: {_PACK} (`xz -dk {{file}}`)"),
    (b"BZh", f"packed by bzip2: {_PACK} (`bzip2 -dk {{file}}`)"),
    (b"\x04\x22\x4d\x18", f"packed by lz4: {_PACK} (`lz4 -d {{file}}`)"),
    (b"%PDF-1.", "a PDF document; give the log of the recording"),
    (b"\x89PNG", _PICTURE),
    (b"\xff\xd8\xff", _PICTURE),
    (b"\x1aE\xdf\xa3", _PICTURE),
    (b"\x7fELF", "a program; give the log of the recording"),
    (b"HIERARCHY", "a BVH motion file: export the positions of the markers as C3D, TRC or CSV"),
    (b"Kaydara FBX", "an FBX file: export the positions of the markers as C3D, TRC or CSV"),
    (b"# Created by Octave", "Octave's text format: save it with `save -v7 FILE.mat`, or as CSV"),
)


def kind_of(path: Path) -> str:
    """Return the format of a log.

    Returns:
        One of c3d, mcap, db3, npz, npy, mat, hdf5, parquet, zstd, gzip, trc, motive, qtm, nexus,
        lvm, typed, jsonl and csv.

    Raises:
        RunError: it cannot be read, or has an unsupported format.
    """
    if path.exists() and not path.is_file():  # opening a pipe would block
        raise RunError(
            f"{path}: {'a folder' if path.is_dir() else 'no file'}; give the path of a log"
        )
    try:
        with path.open("rb") as file:
            start = file.read(_HEAD)
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log"
        ) from cause
    for magic, kind in _READ:
        if start.startswith(magic) and not _like_text(magic, start):
            return _checked_mcap(path, start) if kind == "mcap" else kind
    if start[skipped_frames(start) :].startswith(ZSTD):
        return "zstd"
    if start[512:520] == HDF5 or start[1024:1032] == HDF5 or start[2048:2056] == HDF5:
        return "hdf5"
    if start.startswith(b"PK\x03\x04") or start.startswith(b"PK\x05\x06"):
        return _of_zip(path)
    _refuse_foreign(path, start)
    ending = path.suffix.lower()[1:]
    if ending in ("c3d", "trc", "mat", "mcap"):
        return ending
    text = _decoded(start)
    _refuse_calibration(path, text)
    kind = next((kind for kind, begins in _TEXTS.items() if begins(text)), "csv")
    if kind == "csv" and is_json(text):
        raise _not_read(path, f"a JSON document: {WAY_OUT}")
    return kind


def _decoded(start: bytes) -> str:
    """Return the first bytes of a file as text."""
    encoding = encoding_of_start(start)
    if is_wide(encoding):
        return start.decode(encoding, "ignore")
    return start.removeprefix(b"\xef\xbb\xbf").decode("latin-1")


def _refuse_foreign(path: Path, start: bytes) -> None:
    """Raise RunError with the name of an unsupported format."""
    for magic, what in _FOREIGN:
        if start.startswith(magic) and not _like_text(magic, start):
            raise _not_read(path, what)
    if start[4:8] == b"ftyp" or (start.startswith(b"RIFF") and start[8:12] in (b"AVI ", b"WAVE")):
        raise _not_read(path, _PICTURE)
    if start[257:262] == b"ustar":
        raise _not_read(path, f"a tar archive: {_PACK}")
    if len(start) > 2 and start[0] == 0x80 and start[1] in (2, 3, 4, 5):
        raise _not_read(
            path,
            "a Python pickle, which could run code and is never read: save the arrays with "
            "numpy.savez",
        )


def _like_text(magic: bytes, start: bytes) -> bool:
    """Return whether a file that starts with a format's magic word may be text.

    A column may be called `PAR1` or `LOGGED`.
    """
    return len(magic) < _SURE and magic.isalnum() and b"\0" not in start


def _not_read(path: Path, what: str) -> RunError:
    return RunError(f"{path}: is {what.format(file=path.name)}")


def _checked_mcap(path: Path, start: bytes) -> str:
    """Return `mcap`; raise RunError if its header declares ROS 1 messages."""
    length = int.from_bytes(start[17:21], "little")
    if start[8:9] == b"\x01" and start[21 : 21 + min(length, 16)] == b"ros1":
        bag = _CONVERT_BAG.format(file="FILE.bag")
        raise _not_read(
            path, f"an MCAP file of ROS 1 messages: convert the bag that it was made of with {bag}"
        )
    return "mcap"


def _of_zip(path: Path) -> str:
    """Return `npz`; raise RunError for any other zip archive."""
    try:
        check_directory(path, RunError)
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()[:1000]
    except RunError:
        raise
    except Exception as fault:  # damaged files raise a dozen kinds in zipfile
        if path.suffix.lower() == ".npz":
            return "npz"
        raise RunError(
            f"{path}: is a damaged archive ({type(fault).__name__}); copy it again"
        ) from None
    if any(name.startswith("xl/") for name in names):
        raise _not_read(path, f"a spreadsheet (.xlsx): {_SHEET}")
    if "content.xml" in names:
        raise _not_read(path, f"an OpenDocument file (.ods): {_SHEET}")
    if names and all(name.endswith(".npy") for name in names):
        return "npz"
    if path.suffix.lower() == ".npz":
        return "npz"
    raise _not_read(path, f"a zip archive: {_PACK}")


def _refuse_calibration(path: Path, text: str) -> None:
    """Raise RunError with an explanation if the text is a LeRobot calibration, not a log."""
    if not text.lstrip().startswith("{") or '"homing_offset"' not in text:
        return
    from softmap_edge.logs.lerobot import explained

    try:
        document = (
            json.loads(path.read_text(encoding="utf-8")) if path.stat().st_size < 2**20 else None
        )
    except (OSError, ValueError, RecursionError):
        return
    if explanation := explained(document):
        raise RunError(f"{path}: {explanation}")

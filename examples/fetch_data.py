"""Fetch the public measurements of examples and tests: `python examples/fetch_data.py data`.

They are taken from `../shared/data` where that folder exists, else from the public commits below,
and never trusted: every file must have the SHA-256 written here. Nothing of it belongs to this
project; each set keeps its own licence, which is copied next to it. A set can be chosen by name:
`python examples/fetch_data.py data trunk`.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass
from pathlib import Path

BASE_URL = "https://raw.githubusercontent.com"
NEARBY = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
TIMEOUT = 60.0  # s without a byte
LARGEST = 64 * 2**20  # bytes: ten times the largest file below


class FetchError(Exception):
    """A file could not be brought; the message says which, and what to do."""


@dataclass(frozen=True)
class Source:
    """One set of files of one public commit: name here → (path there, SHA-256)."""

    name: str
    what: str
    repository: str
    commit: str
    licence: str
    files: dict[str, tuple[str, str]]

    def url(self, name: str, base: str) -> str:
        """Return the address of one file."""
        path = urllib.parse.quote(self.files[name][0])
        return f"{base.rstrip('/')}/{self.repository}/{self.commit}/{path}"


_TRUNK = "stack/main/data/trajectories/dynamic/servo_motor_archive"
_TDCR = "data/sysid/ftdcr_v4/tdcr_sysid_20260511-183002_analysis/tdcr_sysid_20260511-183002"
_BEAM = "python/realbeam_experiments/Measurement_data"
_MOE = "envs/MOE/sim_scripts/SIM_SCENE_MESH"

SOURCES = [
    Source(
        "trunk",
        "ASL Trunk, six motors: commands, encoders and three tracked bodies at 100 Hz, unloaded "
        "and with 100 g",
        "StanfordASL/trunk-stack",
        "8b4b9234b287a0403d1844821bfad79e36e1f66f",
        "MIT",
        {
            "LICENSE": (
                "LICENSE",
                "5f5be48a7cc2bf2b583446059d9f0dac0851191f03375de4a4b54cfb56042bb0",
            ),
            "control_inputs_controlled_1.csv": (
                f"{_TRUNK}/control_inputs_controlled_1.csv",
                "3ad99980da3ad5182f2ff694fad10b2a23d680b90606b665229b2b20cb56ed43",
            ),
            "observations_controlled_1.csv": (
                f"{_TRUNK}/observations_controlled_1.csv",
                "bc4c951556c971d8849e556f067bf041c6de359b630a88d70760738abb836541",
            ),
            "observations_controlled_1_100g.csv": (
                f"{_TRUNK}/observations_controlled_1_100g.csv",
                "790953bd1c715a8d6ddafa3e8dbe5e7781727a164119311a0fec99c6e6e2ffc0",
            ),
        },
    ),
    Source(
        "tdcr",
        "OpenCR, three segments and nine tendons: servo positions and tip",
        "ContinuumRoboticsLab/opencr-mujoco",
        "17fff8b125dbb702c8688e1d8ffd723050c284c1",
        "MIT",
        {
            "LICENSE": (
                "LICENSE",
                "66bb402ecef5c4982dffee51187722cae4fac50d75a71ad4457b1684ccf2a203",
            ),
            "keypoints.csv": (
                f"{_TDCR}_keypoints.csv",
                "80a4b16c32ea20c13bc2952039188b642db59633df10fe3e54a85ac7b270a38c",
            ),
            "tendon_pull.csv": (
                f"{_TDCR}_tendon_pull.csv",
                "5931b7e466acf0569debd89011879dee6aee7a816cb75a9721aa0f236e79a3c8",
            ),
            "train.csv": (
                f"{_TDCR}_train.csv",
                "1eddfda64b3cf51a7f6cdf3e88f088cbb70baa944be4e5ebb30ef397f76590af",
            ),
            "val.csv": (
                f"{_TDCR}_val.csv",
                "a69fd0e11c7e8ddbeb6828d7ca604f01e6c6bc45ea92311ae632e88302a751fe",
            ),
        },
    ),
    Source(
        "beam",
        "SRL silicone beam under gravity, 52 g and 101 g: markers at 100 Hz (C3D)",
        "srl-ethz/diffPD_sim2real",
        "825e7b7c4638d18f0b35707eb192bedf955a7157",
        "MIT",
        {
            "LICENSE": (
                "LICENSE",
                "37bbcf94b41e1a91a01b6f6baa1067e4bba0d582f26be36176d7e8dc6bb5a167",
            ),
            "beam_gravity_V2_a.c3d": (
                f"{_BEAM}/beam_gravity_V2_a.c3d",
                "c457a77b67925b9a9d66bbdbd4424a2b8a27e7dfeea2355d75cdc80b1b2e4361",
            ),
            "beam_gravity_V2_b.c3d": (
                f"{_BEAM}/beam_gravity_V2_b.c3d",
                "cb720b7911214e9a055a5f374cd6979923aa8f1f55afbe98ac5ae0422d6f669e",
            ),
            "beam_load101_V2_a.c3d": (
                f"{_BEAM}/beam_load101_V2_a.c3d",
                "4fbc73464e67a8edbae316e50253c0a2d5c32047e00320460796aa2ddfaf8e34",
            ),
            "beam_load52_V2_a.c3d": (
                f"{_BEAM}/beam_load52_V2_a.c3d",
                "bbaeb9ed77cfa38485e5f6b60da25c49876a5ee6f7f1c7cb08dd1962740e52dc",
            ),
        },
    ),
    Source(
        "moe_finger",
        "the MOE soft finger: tetrahedra and cable routes",
        "uksangyoo/sofagym_moe",
        "e23a9a4ff375c0943aded93505095dc7508d107b",
        "MIT by its setup.py; the repository has no licence file",
        {
            "Finger_with_Tip.vtk": (
                f"{_MOE}/MOE_MESH/Finger_with_Tip.vtk",
                "d293383b80f823f61f2746c70355d51d0b718a1f950bcb0253a2b7251883e245",
            ),
            "cable1.json": (
                f"{_MOE}/OBJECTS/cable1copy.json",
                "cf57de23664826e24a0a7b5f43e6c2af74a2e52f09845716016748b80f9e6c12",
            ),
            "cable2.json": (
                f"{_MOE}/OBJECTS/cable2copy.json",
                "b4aa5d016b1a1ef697771858af530a99525a11a5e3b78fc406be0dc411dcb572",
            ),
            "cable3.json": (
                f"{_MOE}/OBJECTS/cable3copy.json",
                "9c78cac947e9b2d02517be740d431945c0c3e3fd99ce1c57aef28fe541156f55",
            ),
            "cable4.json": (
                f"{_MOE}/OBJECTS/cable4copy.json",
                "27dd6cb38b166f20eb01628c521db69503eaa68aa22ffdff84a1aa3d0f165e2e",
            ),
        },
    ),
    Source(
        "hand",
        "621 frames of one hand and forearm",
        "dexsuite/dex-retargeting",
        "3f56141bc8bd2760d5e452e382937269554ebb21",
        "MIT",
        {
            "LICENSE": (
                "LICENSE",
                "9fe9a2d1a06b91db137b5f50ee4e3914b0b8c1df523b81bdd0a9d930e1ce6106",
            ),
            "hand.mp4": (
                "example/vector_retargeting/data/human_hand_video.mp4",
                "d306af128862940fc6e3c737a42ec6b00a137fff1c37b10805fe2c143c62ddb8",
            ),
        },
    ),
]


def fetch(
    folder: Path, sources: list[Source], base_url: str = BASE_URL, nearby: Path | None = NEARBY
) -> list[str]:
    """Fetch all files of `sources` into `folder/SET/`; those with the right checksum stay.

    Args:
        folder: where to; made if absent.
        sources: which sets.
        base_url: stands for raw.githubusercontent.com: repository, commit and path follow it.
        nearby: a folder laid out like `folder` that is asked first; None asks the net alone.

    Returns:
        One line a set: how many files were there already, copied and downloaded.

    Raises:
        FetchError: a file cannot be had or is not the one published.
    """
    report = []
    for source in sources:
        count = {"already there": 0, "copied": 0, "downloaded": 0}
        (folder / source.name).mkdir(parents=True, exist_ok=True)
        for name, (_, sha256) in source.files.items():
            target = folder / source.name / name
            near = None if nearby is None else nearby / source.name / name
            if target.is_file() and _sha256(target) == sha256:
                count["already there"] += 1
            elif near is not None and near.is_file() and _sha256(near) == sha256:
                _place(near.read_bytes(), target)
                count["copied"] += 1
            else:
                _place(_download(source.url(name, base_url), sha256), target)
                count["downloaded"] += 1
        done = ", ".join(f"{number} {how}" for how, number in count.items() if number)
        report.append(
            f"{source.name:<11} {done}; licence {source.licence}; {source.repository} at "
            f"{source.commit[:7]}"
        )
    return report


def _download(url: str, sha256: str) -> bytes:
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT) as answer:
            content: bytes = answer.read(LARGEST + 1)
    except (urllib.error.URLError, OSError, ValueError) as cause:
        raise FetchError(
            f"{url}: cannot be had ({cause}); try again, or copy the file there by hand"
        ) from cause
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        raise FetchError(
            f"{url}: SHA-256 {found[:16]}… of {len(content)} bytes, expected {sha256[:16]}…; "
            "nothing was kept"
        )
    return content


def _place(content: bytes, target: Path) -> None:
    """Write a file atomically: complete or not at all."""
    part = target.with_name(target.name + ".part")
    part.write_bytes(content)
    part.replace(target)


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def main(argv: list[str] | None = None) -> int:
    """Run the command; 0 when every file is there, 1 when one could not be had, 2 for wrong use."""
    parser = argparse.ArgumentParser(description="Bring the public measurements into a folder.")
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "sets", nargs="*", help=f"which sets (default: all): {', '.join(s.name for s in SOURCES)}"
    )
    parser.add_argument(
        "--base-url", default=BASE_URL, help="a mirror of raw.githubusercontent.com"
    )
    parser.add_argument("--no-nearby", action="store_true", help="do not look into ../shared/data")
    args = parser.parse_args(argv)
    unknown = [name for name in args.sets if name not in {source.name for source in SOURCES}]
    if unknown:
        print(
            f"fetch_data: no set '{unknown[0]}'; there are {', '.join(s.name for s in SOURCES)}",
            file=sys.stderr,
        )
        return 2
    chosen = [source for source in SOURCES if not args.sets or source.name in args.sets]
    try:
        print(
            "\n".join(fetch(args.folder, chosen, args.base_url, None if args.no_nearby else NEARBY))
        )
    except (FetchError, OSError) as fault:
        print(f"fetch_data: {fault}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

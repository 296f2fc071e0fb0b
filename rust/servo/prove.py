"""Prove guard and codec: every line and region is run by the tests, and the tests catch their
mutants (`make prove`).

    python rust/servo/prove.py coverage | mutants [--jobs N] [--of FILE.rs ...]

Needs cargo-llvm-cov and cargo-mutants, which the Makefile installs. A mutant that survives must
stand in survivors.toml with the reason why no test can distinguish it. Standard library
only.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
CODEC = ["crc.rs", "packet.rs", "decoder.rs", "registers.rs"]
GUARD = [
    f"guard/{name}.rs"
    for name in ("limits", "machine", "mod", "path", "reversals", "servo", "time")
]
DRIVE = [
    "drive.rs",
    "bus.rs",
    "control.rs",
]  # reported, not required: they wait for ports, clocks and faults of the system
SCORE = 0.95
FUZZ = "400000"  # periods of the guard's fuzz a mutant: a second instead of ten
# times what the tests took without a mutant, and MINUTE: a mutant that loops for ever is ended
SLOWEST = 10
MINUTE = 60  # s at least, on a machine however quick
# of the mutants may end by time-out: the loops of the codec; more, and it was the machine that was
# slow
LATE = 0.05
FOUND = (0, 2, 3)  # how cargo-mutants ends when all are caught, some survive, some ran out of time


def cargo(*words: str, **environment: str) -> int:
    """Run cargo at the root of the workspace; its exit code."""
    return subprocess.run(["cargo", *words], cwd=ROOT, env=os.environ | environment).returncode


def coverage() -> int:
    """Count lines and regions that no test runs; 0 if guard and codec have none."""
    report = ROOT / "target" / "coverage.json"
    report.parent.mkdir(exist_ok=True)
    if cargo(
        "llvm-cov",
        "-p",
        "softmap-servo",
        "--locked",
        "--lib",
        "--json",
        "--output-path",
        str(report),
    ):
        return 1
    found = {
        entry["filename"]: entry["summary"]
        for entry in json.loads(report.read_text())["data"][0]["files"]
    }
    missing = 0
    for name in CODEC + GUARD + DRIVE:
        summary = found[str(HERE / name)]
        parts = []
        for what in ("lines", "regions"):
            count, covered = summary[what]["count"], summary[what]["covered"]
            missing += (count - covered) * (name not in DRIVE)
            parts.append(f"{covered} of {count} {what}")
        print(f"{name}: {', '.join(parts)}{' (not asked for)' * (name in DRIVE)}")
    print(
        "of guard and codec every line and region is run"
        if not missing
        else f"{missing} lines and regions are not run; 0 are allowed"
    )
    return int(missing > 0)


def assess(outcomes: list[dict[str, str]], explained: Counter[str]) -> int:
    """Print the score and every survivor without a reason; 0 if the score is high enough and there
    is none.

    Args:
        outcomes: of each mutant `name` ("file: what is changed in which function") and `summary`,
            as it is called.
        explained: how many mutants of each name are known to survive.
    """
    kinds = Counter(outcome["summary"] for outcome in outcomes)
    viable = sum(kinds.values()) - kinds["Unviable"]
    caught, late = kinds["CaughtMutant"] + kinds["Timeout"], kinds["Timeout"]
    survivors = Counter(
        outcome["name"] for outcome in outcomes if outcome["summary"] == "MissedMutant"
    )
    unexplained = survivors - explained
    score = caught / viable if viable else 0.0
    print(
        f"{caught} of {viable} mutants are caught ({100 * score:.1f} %), {caught - late} by a "
        f"test that fails and {late} by time-out; {100 * SCORE:.0f} % are required"
    )
    print(f"{survivors.total()} survive, {unexplained.total()} of them unexplained")
    for outcome in outcomes:
        if outcome["summary"] == "Timeout":
            print(f"ran out of time: {outcome['name']}")
    if late > LATE * viable:
        print(
            f"{late} ran out of time, {100 * LATE:.0f} % are allowed: that says nothing of the "
            "tests; run it on a machine at rest"
        )
    for name in unexplained:
        print(f"no reason in survivors.toml: {name}")
    return int(score < SCORE or late > LATE * viable or bool(unexplained))


def names(document: dict[str, object]) -> list[dict[str, str]]:
    """Return of each mutant of cargo-mutants' outcomes its name without places in the file, and
    what came of it.
    """
    found = []
    for outcome in document["outcomes"]:
        if outcome["scenario"] == "Baseline":
            continue
        mutant = outcome["scenario"]["Mutant"]
        said = mutant["name"].split(": ", 1)[1]
        found.append(
            {"name": f"{Path(mutant['file']).name}: {said}", "summary": outcome["summary"]}
        )
    return found


def mutants(jobs: int, only: list[str]) -> int:
    """Run the tests on each mutant of guard and codec."""
    files = [part for name in only or CODEC + GUARD for part in ("-f", f"rust/servo/{name}")]
    out = ROOT / "target" / "mutants"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    code = cargo(
        "mutants",
        "-p",
        "softmap-servo",
        *files,
        "--jobs",
        str(jobs),
        "--output",
        str(out),
        "--timeout-multiplier",
        str(SLOWEST),
        "--minimum-test-timeout",
        str(MINUTE),
        "--colors",
        "never",
        "--",
        "--lib",
        "--locked",
        SOFTMAP_FUZZ_PERIODS=FUZZ,
    )
    if code not in FOUND:
        print(
            f"cargo-mutants ended with {code} and checked nothing: the tests fail without a "
            "mutant, or it cannot run"
        )
        return 1
    document = json.loads((out / "mutants.out" / "outcomes.json").read_text())
    listed = tomllib.loads((HERE / "survivors.toml").read_text(encoding="utf-8"))["survivor"]
    explained = Counter(
        {entry["mutant"]: entry.get("times", 1) for entry in listed if entry["why"].strip()}
    )
    return assess(names(document), explained)


def main() -> int:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description="coverage and mutants of guard and codec")
    parser.add_argument("what", choices=["coverage", "mutants"])
    parser.add_argument(
        "--jobs", type=int, default=max(1, (os.cpu_count() or 2) // 2), help="mutants side by side"
    )
    parser.add_argument(
        "--of", nargs="*", default=[], metavar="FILE.rs", help="these alone, within rust/servo"
    )
    args = parser.parse_args()
    return coverage() if args.what == "coverage" else mutants(args.jobs, args.of)


if __name__ == "__main__":
    sys.exit(main())

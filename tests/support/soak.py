"""Repeat the tests that depend on time, every second run alongside busy processes.

    python tests/support/soak.py RECORD.jsonl [--runs 20] [--busy 4]

Each run adds a line to RECORD.jsonl. A second call continues with the runs that are still missing.
The exit code is 1 if any recorded run failed. A test file depends on time if it uses one of the
helpers that wait, type or drive in real time.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
HELPERS = re.compile(r"^from (waiting|typist|page_client|loops|driving) import", re.MULTILINE)
BUSY = "while True: pass"


def files_that_depend_on_time():
    """Return the test files that use a helper of real time."""
    found = sorted((ROOT / "tests").glob("*/test_*.py"))
    return [file for file in found if HELPERS.search(file.read_text(encoding="utf-8"))]


def one_run(files, busy):
    """Run the files once alongside `busy` processes; return counts, failures and seconds."""
    loads = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(busy)]
    start = time.monotonic()
    try:
        argv = [sys.executable, "-m", "pytest", "-q", "-n", "3", "--dist", "loadfile", "--tb=short"]
        argv += ["-m", "not long and not prove", *map(str, files)]
        done = subprocess.run(argv, capture_output=True, text=True, cwd=ROOT, check=False)
    finally:
        for load in loads:
            load.kill()
    counts = re.findall(r"(\d+) (passed|failed|skipped|errors?)", done.stdout.splitlines()[-1])
    return {
        "busy": busy,
        "code": done.returncode,
        **{word: int(number) for number, word in counts},
        "failures": re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE),
        "seconds": round(time.monotonic() - start),
        "text": "" if done.returncode == 0 else done.stdout[-20_000:],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("record", type=Path)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--busy", type=int, default=4, help="processes in every second run")
    args = parser.parse_args()
    files = files_that_depend_on_time()
    done = args.record.read_text().splitlines() if args.record.exists() else []
    for number in range(len(done), args.runs):
        row = {"run": number, **one_run(files, args.busy if number % 2 else 0)}
        with args.record.open("a", encoding="utf-8") as record:
            record.write(json.dumps(row) + "\n")
        print({key: value for key, value in row.items() if key != "text"}, flush=True)
    rows = [json.loads(line) for line in args.record.read_text().splitlines()]
    failed = [row["run"] for row in rows if row["code"] != 0]
    print(f"{len(rows)} runs of {len(files)} files, failed: {failed or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

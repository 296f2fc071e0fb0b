"""Make the pictures of the README: a simulated second finger with hidden backlash, found, added and compared.

`python docs/figures.py` writes them beside this file; `--out` names another folder, `--seed` another finger.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from softmap_edge import builtin_model, diagnose, series
from softmap_edge.figures import body, ladder_bars, over_time
from softmap_edge.protocol import other_protocol, standard_protocol
from softmap_edge.truth import hide

SEED = 1  # of the second finger; any other tells the same story with other numbers


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, diagnose, and draw the run of another kind that was never fitted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder for the pictures")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the second finger ({SEED})")
    args = parser.parse_args(argv)
    model, truth = builtin_model(), hide(["backlash"], args.seed)
    found = diagnose(model, truth.measure(standard_protocol(model.channels)))
    seen = series(truth.measure(other_protocol(model.channels), seed=1), model, found.model)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "error_over_time.svg").write_bytes(over_time(seen))
    (args.out / "error_on_the_body.png").write_bytes(body(seen))
    (args.out / "error_ladder.svg").write_bytes(ladder_bars(found.error))
    print(found.sentence)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

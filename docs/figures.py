"""Make the pictures of the README: a simulated second finger with hidden backlash, found, added and compared."""

from pathlib import Path

from softmap_edge.bundle import builtin_model
from softmap_edge.comparison import series
from softmap_edge.diagnosis import diagnose
from softmap_edge.figures import body, ladder_bars, over_time
from softmap_edge.protocol import other_protocol, standard_protocol
from softmap_edge.truth import hide

SEED = 1  # of the second finger; any other tells the same story with other numbers


def main() -> None:
    """Measure, diagnose, and draw the run of another kind that was never fitted."""
    model, truth = builtin_model(), hide(["backlash"], SEED)
    found = diagnose(model, truth.measure(standard_protocol(model.channels)))
    seen = series(truth.measure(other_protocol(model.channels), seed=1), model, found.model)
    here = Path(__file__).parent
    (here / "error_over_time.svg").write_bytes(over_time(seen))
    (here / "error_on_the_body.png").write_bytes(body(seen))
    (here / "error_ladder.svg").write_bytes(ladder_bars(found.error))
    print(found.sentence)


if __name__ == "__main__":
    main()

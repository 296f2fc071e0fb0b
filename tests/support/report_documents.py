"""A document of a diagnosis, and the page made of it."""

from leaning_triangle import lean, triangle

from softmap_edge.comparison.comparison import compare

DIAGNOSIS = {
    "schema": "softmap.diagnosis/2",
    "verdict": "partly_explained",
    "sentence": "Backlash of 0.62 mm is missing; 0.21 mm are left.",
    "effects": [
        {
            "name": "backlash",
            "family": "reversal hysteresis",
            "stage": "transmission",
            "probability": 0.97,
            "share": 0.71,
            "displacement_mm": {"fitted": 1.82, "held_out": None},
            "params": {
                "backlash.gap": {"value": 0.6213, "sigma": 0.013, "unit": "mm", "at_bound": True}
            },
        }
    ],
    "faults": [],
    "families": [
        {
            "name": "memory",
            "kind": "memory",
            "law": "identified",
            "effects": ["backlash"],
            "share": 0.93,
            "moved_mm": 1.84,
            "law_share": 0.98,
        }
    ],
    "alternatives": [{"effects": ["friction"], "why": "within two standard errors"}],
    "not_testable": [
        {"name": "thermal_softening", "why": "no temperature", "experiment": "a warm-up"}
    ],
    "where": {
        "before": {
            "speed": [{"label": "still", "low": None, "high": None, "n": 9, "rms_mm": 1.0}] * 2
        },
        "after": {
            "speed": [{"label": "still", "low": None, "high": None, "n": 9, "rms_mm": 0.2}] * 2
        },
    },
    "error": {
        "kind": "held-out rms",
        "unit": "mm",
        "model": 2.41,
        "static_residual": 1.98,
        "ladder": [{"added": "backlash", "value": 0.93}],
        "with_static_residual": 0.27,
        "noise_floor": 0.1,
        "model_floor": 0.19,
        "floor": 0.21,
        "floor_kind": "nothing hidden",
    },
    "unexplained": {"rms_mm": 0.21, "chi2_per_n": 1.8, "blocked_r2": 0.22, "predicted_by": "dwell"},
    "next": [{"block": "staircase", "minutes": 2.5, "settles": ["creep"], "separation": 42.0}],
    "made_from": {"seed": 1},
}


def compared():
    run = triangle(noise=0.05)
    worse, better = lean(lambda run, p: 2.0), lean(lambda run, p: 0.2)
    return run, worse, better, compare(worse, run), compare(better, run)


def page(path):
    return path.read_text(encoding="utf-8")

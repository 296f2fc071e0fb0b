//! Clock shift: the clocks of cameras and drive differ; a measurement fault, not physics of the
//! robot.
//!
//! A frame stamped t shows the state at `t − late`, commands and loads included. Either sign is
//! possible. A late stamp looks like `latency`, and the data of a run cannot distinguish them; an
//! early one cannot be latency. s. Frames before the first sample show the first command. Limit:
//! one shift for the complete run, without clock drift.

use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "clock_shift",
        family: "delay",
        stage: Stage::Sensing,
        kind: Kind::Fault,
        formula: "seen(t) = shown(t − late)",
        doc: "Frames are stamped when they arrive instead of when they are taken, or two computers \
              differ in their clocks.",
        signature: "Error in proportion to speed, with the sign of the motion; none at rest; \
            corners keep their shape.",
        reference: "Furgale, Rehder and Siegwart, Unified temporal and spatial calibration for \
              multi-sensor systems, IROS 2013.",
        experiment: ("one sharp step that both clocks see", 0.5),
        alike: &[("latency", "never")],
        needs: &[],
        parameters: &[Parameter::new(
            "late",
            "s",
            0.0,
            0.1,
            -0.5,
            0.5,
            "stamp of a frame minus the time that it shows",
        )],
    },
    law: Law::Sensing(&ClockShift),
};

struct ClockShift;

impl SensingEffect for ClockShift {
    fn late(&self, params: &[f64]) -> f64 {
        params[0]
    }
}

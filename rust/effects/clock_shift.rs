//! Clock shift: the clock of the cameras is not that of the drive; a fault of the measurement, not
//! of the robot.
//!
//! A frame that is stamped t shows what was at `t − late`: commands, loads and all. Either sign; a
//! late stamp looks like `latency`, and no data of a run can distinguish them, while an
//! early one is no latency. s. Frames before the first sample show the first command. Limit: one
//! shift for the complete run; clocks that drift apart are none.

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

//! Scale: all measurements are too large or too small; a measurement fault, not physics of the
//! robot.
//!
//! `p = factor·p` about the origin of the base; sizes and directions scale with it. Exact.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "scale",
        family: "sensor frame",
        stage: Stage::Sensing,
        kind: Kind::Fault,
        formula: "p = factor · p  about the origin of the base",
        doc: "A wrong length in the calibration of the cameras: a board printed too large, a wrong \
              distance between two views.",
        signature: "Static and radial: points are too far from the base or too near, in proportion \
              to their distance, at home too.",
        reference: "Similarity transform: Umeyama, IEEE Trans. Pattern Analysis 13 (1991) 376.",
        experiment: ("a known length in view", 0.5),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "factor",
            "1",
            1.0,
            1.02,
            0.9,
            1.1,
            "size seen over size",
        )],
    },
    law: Law::Sensing(&Scale),
};

struct Scale;

impl SensingEffect for Scale {
    fn apply(
        &self,
        params: &[f64],
        _positions: &[bool],
        points: &mut [f64],
        _context: &Context,
        _cameras: &[Camera],
    ) {
        points.iter_mut().for_each(|p| *p *= params[0]);
    }
}

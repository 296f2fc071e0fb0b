//! Camera drift: the frame of the cameras drifts during the run; a measurement fault, not physics
//! of the robot.
//!
//! `p = R(turn·m)·p + shift·m` about the origin of the base, `m` the minutes since the first frame,
//! where the drift is zero; `R` as in `mount.rs`. Directions only turn. Limit: steady drift; after
//! a knock, the camera has another mount.

use super::conditions::Context;
use super::declaration::*;
use super::mount::move_rigidly;

const fn turn(name: &'static str, doc: &'static str) -> Parameter {
    Parameter::new(name, "deg/min", 0.0, 0.2, -2.0, 2.0, doc)
}

const fn shift(name: &'static str, doc: &'static str) -> Parameter {
    Parameter::new(name, "mm/min", 0.0, 0.2, -2.0, 2.0, doc)
}

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "camera_drift",
        family: "slow drift",
        stage: Stage::Sensing,
        kind: Kind::Fault,
        formula: "p = R(turn · m) · p + shift · m,  m minutes since the first frame seen",
        doc: "A camera or the clamp of the robot sags or is pulled by its cable: the measured \
            frame moves slowly.",
        signature: "Rigid error that grows with time from nothing, whatever is commanded: even the \
            clamped base moves.",
        reference: "Rotation vector by Rodrigues’ formula, linear in time.",
        experiment: (
            "home and points near the base at the start, in between and at the end",
            0.5,
        ),
        alike: &[],
        needs: &[],
        parameters: &[
            turn("turn_x", "x component of the rotation vector, per minute"),
            turn("turn_y", "y component of the rotation vector, per minute"),
            turn("turn_z", "z component of the rotation vector, per minute"),
            shift("shift_x", "shift along x, per minute"),
            shift("shift_y", "shift along y, per minute"),
            shift("shift_z", "shift along z, per minute"),
        ],
    },
    law: Law::Sensing(&CameraDrift),
};

struct CameraDrift;

impl SensingEffect for CameraDrift {
    fn apply(
        &self,
        params: &[f64],
        positions: &[bool],
        points: &mut [f64],
        context: &Context,
        _cameras: &[Camera],
    ) {
        let minutes = context.seen_for / 60.0;
        let moved = [0, 1, 2, 3, 4, 5].map(|i| params[i] * minutes);
        move_rigidly(&moved, positions, points);
    }
}

//! Contact: the body touches an obstacle, a wall or a ball.
//!
//! The obstacle's foremost point is q = (distance·cos heading, distance·sin heading, height), its
//! normal there n = −(cos heading·cos tilt, sin heading·cos tilt, sin tilt) and its curvature that
//! of a sphere (0: a plane, for which `height` only matters when it is tilted). Four stations of
//! the body stay outside it, pushed without friction by the unit-force fields
//! (`rust/response/contact.rs`). At distance 0 there is no obstacle. Limit: linear; if the obstacle
//! displaces the body by many mm, the displacement is too large.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "contact",
        family: "contact",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "gap_i ≥ 0,  force_i ≥ 0,  gap_i · force_i = 0  at four stations, on push_0 … \
            push_2 and tip_force",
        doc: "Something stands in the way: a wall, the table, a cable, another finger.",
        signature: "One region of commands, one-sided: nothing before the body touches, then all \
            of it stays behind.",
        reference: "Signorini's problem without friction: Wriggers, Computational Contact \
            Mechanics, 2006.",
        experiment: (
            "past the obstacle and back, at two speeds, and all around",
            2.0,
        ),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "distance",
                "mm",
                0.0,
                25.0,
                5.0,
                80.0,
                "of the foremost point from the axis of the base; 0: no obstacle",
            ),
            Parameter::new(
                "heading",
                "deg",
                0.0,
                0.0,
                -180.0,
                180.0,
                "in which direction about the axis it stands, from x to y",
            ),
            Parameter::new(
                "height",
                "mm",
                60.0,
                80.0,
                0.0,
                120.0,
                "of the foremost point above the base",
            ),
            Parameter::new(
                "tilt",
                "deg",
                0.0,
                0.0,
                -30.0,
                30.0,
                "by which the normal points down instead of straight at the axis",
            ),
            Parameter::new(
                "curvature",
                "1/mm",
                0.0,
                0.0,
                0.0,
                0.05,
                "of a sphere; 0 is a plane",
            ),
        ],
    },
    law: Law::Shape(&Contact),
};

struct Contact;

impl ShapeEffect for Contact {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        (TIP_FORCE..TIP_FORCE + 3)
            .chain(PUSH..TENDON)
            .chain([CONTACT])
            .collect()
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        let [distance, heading, height, tilt, curvature] = [0, 1, 2, 3, 4].map(|i| params[i]);
        if distance <= 0.0 {
            return;
        }
        let (sin, cos) = heading.to_radians().sin_cos();
        let (down, level) = tilt.to_radians().sin_cos();
        out[CONTACT..].copy_from_slice(&[
            1.0,
            distance * cos,
            distance * sin,
            height,
            -cos * level,
            -sin * level,
            -down,
            curvature.max(0.0),
        ]);
    }
}

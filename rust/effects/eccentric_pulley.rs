//! Eccentric pulley: a spool off its axis winds unevenly over a turn.
//!
//! `x = u + A·(sin(u/radius + φ) − sin φ)`, mm, without memory. With `sine = A·cos φ` and `cosine =
//! A·sin φ` it is linear in both, `x = u + sine·sin(u/radius) + cosine·(cos(u/radius) − 1)`. So a
//! fit needs no start for the phase, and the amplitude, the root of the sum of their squares, is
//! zero at null. One radius for all pulleys, sine and cosine per channel. Limit: the first harmonic
//! only, of the command instead of the length wound (second order in A/radius).

use super::conditions::Context;
use super::declaration::*;
use crate::error::{Result, invalid};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "eccentric_pulley",
        family: "actuation map",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "x = u + sine · sin(u/radius) + cosine · (cos(u/radius) − 1)",
        doc: "The spool turns about a point off its centre: each turn winds more on one half and \
            less on the other.",
        signature: "Static and periodic in the command, with the period of a turn of the spool; \
            zero at home.",
        reference: "First harmonic of a circle that turns about a point off its centre.",
        experiment: ("full range in fine steps, one channel at a time", 2.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "sine",
                "mm",
                0.0,
                0.4,
                -2.0,
                2.0,
                "amplitude of the part that is odd in the command",
            )
            .per_channel(),
            Parameter::new(
                "cosine",
                "mm",
                0.0,
                0.4,
                -2.0,
                2.0,
                "amplitude of the part that is even in the command",
            )
            .per_channel(),
            Parameter::new(
                "radius",
                "mm",
                6.0,
                6.0,
                1.5,
                20.0,
                "radius of the spools: a turn winds 2π of it",
            ),
        ],
    },
    law: Law::Channel(&EccentricPulley),
};

struct EccentricPulley;

impl ChannelEffect for EccentricPulley {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        let (sine, rest) = params.split_at(x.len());
        let (cosine, radius) = rest.split_at(x.len());
        for ((x, sine), cosine) in x.iter_mut().zip(sine).zip(cosine) {
            let half = 0.5 * *x / radius[0];
            // cos a − 1 = −2 sin²(a/2) is accurate near zero, and sin a = 2 sin(a/2) cos(a/2) comes
            // with it.
            let (s, c) = half.sin_cos();
            *x += 2.0 * s * (sine * c - cosine * s);
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }

    fn check(&self, params: &[f64]) -> Result<()> {
        match params.last() {
            Some(radius) if *radius < 1e-3 => Err(invalid(format!(
                "eccentric_pulley.radius is {radius} mm; a spool has at least 0.001 mm"
            ))),
            _ => Ok(()),
        }
    }
}

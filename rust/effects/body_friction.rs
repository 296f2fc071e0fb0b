//! Body friction: cables that rub along the body, so that its shape depends on the direction of
//! motion.
//!
//! Friction reduces the tension of a cable towards the tip while it is drawn in, and raises it
//! while it is paid out. So the same command gives more bend near the base while the finger is
//! loaded, and more near the tip while it is unloaded: `ln E(s) = ln E₀ + amount·l·(s − ½)`, `l = Σ
//! z_c·u_c/|u|`, a stiffness gradient that changes with the direction. `z_c` is a relay of each
//! effective command, smoothed by a stop operator: `s_c ← clamp(s_c + Δu_c, ±width)`, `z_c =
//! s_c/width`. It is 1 while the channel is loaded, and −1 after a reversal of twice `width`.
//! Memory starts relaxed, `z_c = 0`. Units: mm. A delay or a play of the command cannot express
//! this effect, because it acts along the body, not in time. The relay belongs to the shape:
//! inverse kinematics ignores it (z = 0), so the control loop does not compensate this effect.
//! Limit: one gradient along the body explains 58 % of the effect of capstan friction on a rod.
//! Source of the relay: M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "body_friction",
        family: "reversal hysteresis",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "ln E(s) = ln E₀ + amount · Σ z_c u_c/|u| · (s − 1/2),  z = s/width,  s = clamp(s \
            + Δu, ±width)  on stiff_0 … stiff_6",
        doc: "Cables rub along the body: while they are drawn in, the tension falls towards the \
              tip; while they are paid out, the tip keeps it.",
        signature: "A loop between loading and unloading in the shape, not in the command: more \
                    bend at the base while loading, more at the tip while unloading.",
        reference: "Tendon friction along a body: Kato and others, IEEE/ASME Trans. Mechatronics \
            21 (2016) 2209; play and stop: Krasnosel'skii and Pokrovskii 1989.",
        experiment: ("full range up and back, points all along the body", 1.5),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "amount",
                "1",
                0.0,
                0.2,
                0.02,
                2.4,
                "logarithm of the apparent modulus at the tip over that at the base, while loaded",
            ),
            Parameter::new(
                "width",
                "mm",
                1.0,
                1.0,
                0.1,
                8.0,
                "motion of a command that takes its relay halfway from one side to the other",
            ),
        ],
    },
    law: Law::Remembering(&BodyFriction),
};

struct BodyFriction;

/// Narrowest relay, mm: a width of zero is then a step and not a division by zero.
const NARROW: f64 = 1e-6;

impl RememberingEffect for BodyFriction {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        (STIFF..STIFF + HATS).collect()
    }

    fn memory(&self, channels: usize) -> usize {
        channels
    }

    fn remember(&self, params: &[f64], samples: &[f64], channels: usize, out: &mut [f64]) {
        let width = params[1].max(NARROW);
        let mut stops = vec![0.0; channels];
        let before = samples.chunks_exact(channels);
        let before = samples[..channels].chunks_exact(channels).chain(before);
        let rows = samples.chunks_exact(channels).zip(before);
        for (out, (u, before)) in out.chunks_exact_mut(channels).zip(rows) {
            for ((out, stop), (u, before)) in
                out.iter_mut().zip(&mut stops).zip(u.iter().zip(before))
            {
                *stop = (*stop + (u - before)).clamp(-width, width);
                *out = *stop / width;
            }
        }
    }

    fn add(
        &self,
        params: &[f64],
        u: &[f64],
        remembered: &[f64],
        _context: &Context,
        out: &mut Coefficients,
    ) {
        let size = u.iter().map(|u| u * u).sum::<f64>().sqrt();
        if size == 0.0 {
            return;
        }
        let loading: f64 = u.iter().zip(remembered).map(|(u, z)| u * z / size).sum();
        for (hat, out) in out[STIFF..STIFF + HATS].iter_mut().enumerate() {
            *out += params[0] * loading * (middle(hat) - 0.5);
        }
    }
}

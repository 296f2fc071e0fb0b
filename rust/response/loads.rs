//! Names of the causes that move a body besides its commands: dead loads and changes of design.
//!
//! Every prior responds by *fields*: displacement per unit of each cause at constant cable
//! tensions. The simulator computes them, a rod has its own, and shape effects give their
//! coefficients. All use the order and units defined here: gravity on the full body (per 1 g) and a
//! force on its tip (per 1 N), along the axes of the base; then, per unit, the logarithm of the
//! modulus in each of [`HATS`] sections of the body, and its rise from the axis to the +x and the
//! +y side; the deflection of the tip at rest towards x and y (1 mm, uniform curvature); the twist
//! of body and tendons (1° at the tip, uniform); the phase about z of the tendons of each command
//! (1°); a force on a section (1 N) at some stations along the body.

use std::f64::consts::{FRAC_PI_2, PI};

/// Names of the fields.
pub const FIELDS: [&str; 30] = [
    "gravity_x",
    "gravity_y",
    "gravity_z",
    "tip_force_x",
    "tip_force_y",
    "tip_force_z",
    "stiff_0",
    "stiff_1",
    "stiff_2",
    "stiff_3",
    "stiff_4",
    "stiff_5",
    "stiff_6",
    "stiff_x",
    "stiff_y",
    "curve_x",
    "curve_y",
    "twist",
    "routing_0",
    "routing_1",
    "routing_2",
    "push_0_x",
    "push_0_y",
    "push_0_z",
    "push_1_x",
    "push_1_y",
    "push_1_z",
    "push_2_x",
    "push_2_y",
    "push_2_z",
];

/// Where each kind begins in [`FIELDS`].
pub const GRAVITY: usize = 0;
pub const TIP_FORCE: usize = 3;
pub const STIFF: usize = 6;
pub const ACROSS: usize = STIFF + HATS;
pub const CURVE: usize = ACROSS + 2;
pub const TWIST: usize = CURVE + 2;
pub const ROUTING: usize = TWIST + 1;
pub const PUSH: usize = ROUTING + PHASES;

/// Fields that are dead loads; those up to [`PUSH`] are changes of design, the rest pushes.
pub const LOADS: usize = STIFF;
/// Sections of the body with their own modulus.
pub const HATS: usize = 7;
/// Fields of the modulus, from [`STIFF`] on.
pub const MODULI: usize = CURVE - STIFF;
/// Commands whose tendons have a phase.
pub const PHASES: usize = 3;
/// Stations where an obstacle can push the body, as shares of its height; the last one uses the
/// force on the tip.
pub const STATIONS: [f64; 4] = [0.4, 0.6, 0.8, 1.0];

/// Most commands that pull cables.
pub const PULLING: usize = PHASES;
/// Indices of coefficients that are not fields: the additional compliance (mm/N) of the cables that
/// +u and −u of each command pull; and an obstacle: 1 if present, its foremost point (mm), the
/// normal there and its curvature (1/mm).
pub const TENDON: usize = FIELDS.len();
pub const CONTACT: usize = TENDON + 2 * PULLING;

/// Coefficients of [`FIELDS`] in their units, then [`TENDON`] and [`CONTACT`].
pub type Coefficients = [f64; CONTACT + 8];

/// The name of a coefficient.
pub fn name(coefficient: usize) -> &'static str {
    match coefficient {
        field if field < TENDON => FIELDS[field],
        cable if cable < CONTACT => "tendon_compliance",
        _ => "contact",
    }
}

/// Standard gravity, m/s² = N/kg (exact by convention).
pub const STANDARD_GRAVITY: f64 = 9.80665;

/// The force (N) of a mass (g) at rest along gravity (a unit vector, or in multiples of g).
pub fn weight(mass: f64, gravity: [f64; 3]) -> [f64; 3] {
    gravity.map(|g| mass * 1e-3 * STANDARD_GRAVITY * g)
}

/// Middle of a section, as a share of the body's height.
pub fn middle(hat: usize) -> f64 {
    hat as f64 / (HATS - 1) as f64
}

/// Weight of a section at a share of the height: cos² around its middle; all sections sum to 1
/// everywhere.
pub fn hat(hat: usize, share: f64) -> f64 {
    let away = (share.clamp(0.0, 1.0) - middle(hat)) * (HATS - 1) as f64;
    if away.abs() < 1.0 {
        (FRAC_PI_2 * away).cos().powi(2)
    } else {
        0.0
    }
}

/// The length of a section, as a share of the body's.
pub fn width(hat: usize) -> f64 {
    let ends = hat == 0 || hat == HATS - 1;
    (if ends { 0.5 } else { 1.0 }) / (HATS - 1) as f64
}

/// The part of a section between two shares of the height, 0 to 1.
pub fn covered(hat: usize, low: f64, high: f64) -> f64 {
    let count = (HATS - 1) as f64;
    // ∫ cos²(π t/2) dt = t/2 + sin(π t)/2π, and no section reaches beyond the body.
    let upto = |share: f64| {
        let t = ((share.clamp(0.0, 1.0) - middle(hat)) * count).clamp(-1.0, 1.0);
        0.5 * t + (PI * t).sin() / (2.0 * PI)
    };
    (upto(high) - upto(low)) / (upto(1.0) - upto(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_share_the_body_and_are_covered_by_their_integral() {
        for k in 0..=100 {
            let share = k as f64 / 100.0;
            let sum: f64 = (0..HATS).map(|h| hat(h, share)).sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
        for h in 0..HATS {
            let steps = 20_000;
            let part = |low: f64, high: f64| -> f64 {
                let at = |k: usize| low + (high - low) * (k as f64 + 0.5) / steps as f64;
                (0..steps).map(|k| hat(h, at(k))).sum::<f64>() * (high - low) / steps as f64
            };
            let (some, all) = (part(0.2, 0.55), part(0.0, 1.0));
            assert!((width(h) - all).abs() < 1e-6);
            assert!((covered(h, 0.2, 0.55) - some / all).abs() < 1e-6);
            assert_eq!(covered(h, -1.0, 2.0), 1.0);
        }
    }
}

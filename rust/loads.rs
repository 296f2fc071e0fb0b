//! Dead loads and what they are called: gravity on the whole body, and a force on its tip, along the axes of the base.
//!
//! Every prior answers them by *fields*: displacement per 1 g of gravity, and per 1 N on the tip. The simulator computes
//! fields, a rod has its own, shape effects give their coefficients; all of them mean the order that stands here.

/// Names of the fields.
pub const FIELDS: [&str; 6] = [
    "gravity_x",
    "gravity_y",
    "gravity_z",
    "tip_force_x",
    "tip_force_y",
    "tip_force_z",
];

/// Where the gravity triple and the tip force triple begin in [`FIELDS`].
pub const GRAVITY: usize = 0;
pub const TIP_FORCE: usize = 3;

/// Coefficients of [`FIELDS`], in g and N.
pub type Coefficients = [f64; FIELDS.len()];

/// Standard gravity, m/s² = N/kg (exact by convention).
pub const STANDARD_GRAVITY: f64 = 9.80665;

/// The force (N) of a mass (g) at rest along gravity (a unit vector, or in multiples of g).
pub fn weight(mass: f64, gravity: [f64; 3]) -> [f64; 3] {
    gravity.map(|g| mass * 1e-3 * STANDARD_GRAVITY * g)
}

//! The rotation nearest to a 3×3 matrix A: R that maximises tr(RᵀA), the rotation of its polar decomposition.
//!
//! From the rotation of the step before it is followed: with columns r_c of R and a_c of A, R is turned by
//!   ω = Σ r_c × a_c / (|Σ r_c·a_c| + ε)
//! until ω vanishes (Müller, Bender, Chentanez & Macklin 2016, doi:10.1145/2994258.2994269). A few rounds from a near guess, ten times
//! cheaper than a singular value decomposition, and a rotation also where A is flat or turned inside out. Limit: it climbs to the
//! maximum of its own slope; from half a turn away that is one of several.

use crate::vector::{Vec3, cross, dot, norm, scaled};

/// A unit quaternion (w, x, y, z).
pub type Quaternion = [f64; 4];

pub const NO_TURN: Quaternion = [1.0, 0.0, 0.0, 0.0];
/// Turns smaller than this (rad) are none.
const STILL: f64 = 1e-13;
/// What keeps a vanishing matrix from turning anything.
const NOTHING: f64 = 1e-12;

/// The columns of a rotation.
pub fn columns(q: Quaternion) -> [Vec3; 3] {
    let [w, x, y, z] = q;
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + w * z),
            2.0 * (x * z - w * y),
        ],
        [
            2.0 * (x * y - w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + w * x),
        ],
        [
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}

/// R v, from the columns of R.
pub fn turned(columns: &[Vec3; 3], v: Vec3) -> Vec3 {
    std::array::from_fn(|i| columns[0][i] * v[0] + columns[1][i] * v[1] + columns[2][i] * v[2])
}

/// Follow the rotation nearest to the matrix with the columns `a`, from `q`, for at most so many `rounds`.
pub fn follow(a: &[Vec3; 3], mut q: Quaternion, rounds: usize) -> Quaternion {
    for _ in 0..rounds {
        let r = columns(q);
        let along: f64 = (0..3).map(|c| dot(r[c], a[c])).sum();
        let mut omega = [0.0; 3];
        for c in 0..3 {
            let part = cross(r[c], a[c]);
            (0..3).for_each(|i| omega[i] += part[i]);
        }
        let omega = scaled(omega, 1.0 / (along.abs() + NOTHING));
        let angle = norm(omega);
        if angle < STILL {
            break;
        }
        q = product(turn(omega, angle), q);
    }
    q
}

fn turn(omega: Vec3, angle: f64) -> Quaternion {
    let (sine, cosine) = (0.5 * angle).sin_cos();
    let [x, y, z] = scaled(omega, sine / angle);
    [cosine, x, y, z]
}

/// First `b`, then `a`; kept at unit length.
fn product(a: Quaternion, b: Quaternion) -> Quaternion {
    let q = [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ];
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_rotation_of_a_stretched_one_is_found(
            axis in [-1.0..1.0f64, -1.0..1.0, -1.0..1.0], angle in 0.0..2.5f64, stretch in [0.5..2.0f64, 0.5..2.0, 0.5..2.0],
        ) {
            prop_assume!(norm(axis) > 0.1);
            let q = product(turn(scaled(axis, angle / norm(axis)), angle.max(1e-12)), NO_TURN);
            let r = columns(q);
            // A = R S with S = diag(stretch): its polar rotation is R.
            let a: [Vec3; 3] = std::array::from_fn(|c| scaled(r[c], stretch[c]));
            let found = columns(follow(&a, NO_TURN, 200));
            for c in 0..3 {
                for i in 0..3 {
                    prop_assert!((found[c][i] - r[c][i]).abs() < 1e-8);
                }
            }
        }
    }

    #[test]
    fn nothing_turns_nothing() {
        assert_eq!(follow(&[[0.0; 3]; 3], NO_TURN, 10), NO_TURN);
        assert_eq!(turned(&columns(NO_TURN), [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
    }
}

//! The rotation nearest to a 3×3 matrix A: R that maximises tr(RᵀA), the rotation of its polar
//! decomposition.
//!
//! Newton's method follows it from the rotation of the previous step, ten times cheaper than a
//! singular value decomposition. With P = A Rᵀ, v the axis of its skew part and M = tr(P) I −
//! sym(P), a turn of R by φ about the unit axis n gives tr(P) − nᵀMn (1 − cos φ) + n·v sin φ. So
//! for the axis of M⁻¹v the best angle has a closed form, φ = atan2(n·v, nᵀMn), and no turn lowers
//! the trace. Near the maximum each round cubes the error. If M is not positive definite, the axis
//! is v or that of M's lowest eigenvalue λ, about which half a turn gains −2λ: the one with the
//! larger gain. So a saddle is left immediately. tr(RᵀA) has one maximum; its other stationary
//! points are saddles and its minimum, so every start converges to the maximum.

use crate::algebra::{Mat3, Vec3};
use crate::shape::modes::wide;
use faer::{Mat, Side};
use std::ops::{Add, Mul, Sub};

/// A unit quaternion (w, x, y, z).
pub type Quaternion = [f64; 4];

pub const NO_TURN: Quaternion = [1.0, 0.0, 0.0, 0.0];
/// Matrices processed together.
pub const LANES: usize = 4;
/// Squared sine of the last turn: cubed, it is round-off.
const NEAR: f64 = 1e-10;
/// Share of the highest eigenvalue of M below which a lowest one is round-off.
const FLAT: f64 = 1e-12;

/// One number of each of `LANES` matrices; the loops over them become wide vectors.
#[derive(Clone, Copy)]
struct Lanes([f64; LANES]);

impl Lanes {
    #[inline(always)]
    fn map(self, of: impl Fn(f64) -> f64) -> Lanes {
        Lanes(self.0.map(of))
    }

    /// This value where the mask is set, else the other.
    #[inline(always)]
    fn or(self, other: Lanes, so: [bool; LANES]) -> Lanes {
        Lanes(std::array::from_fn(|k| {
            if so[k] { self.0[k] } else { other.0[k] }
        }))
    }
}

impl From<f64> for Lanes {
    #[inline(always)]
    fn from(value: f64) -> Lanes {
        Lanes([value; LANES])
    }
}

macro_rules! by_lane {
    ($($trait:ident $name:ident $sign:tt),*) => {$(
        impl $trait for Lanes {
            type Output = Lanes;
            #[inline(always)]
            fn $name(self, other: Lanes) -> Lanes {
                Lanes(std::array::from_fn(|k| self.0[k] $sign other.0[k]))
            }
        }
    )*};
}
by_lane!(Add add +, Sub sub -, Mul mul *);

/// The columns of a rotation, or of several side by side.
#[inline(always)]
pub fn columns<T>(q: [T; 4]) -> [[T; 3]; 3]
where
    T: Copy + From<f64> + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    let ([w, x, y, z], one, two) = (q, T::from(1.0), T::from(2.0));
    [
        [
            one - two * (y * y + z * z),
            two * (x * y + w * z),
            two * (x * z - w * y),
        ],
        [
            two * (x * y - w * z),
            one - two * (x * x + z * z),
            two * (y * z + w * x),
        ],
        [
            two * (x * z + w * y),
            two * (y * z - w * x),
            one - two * (x * x + y * y),
        ],
    ]
}

/// The matrix of one rotation.
pub fn rotation(q: Quaternion) -> Mat3 {
    Mat3::from_cols_array_2d(&columns(q))
}

/// Nine numbers of each of `LANES` matrices: `a[c][i]` is row i of column c.
pub type Matrices = [[[f64; LANES]; 3]; 3];

/// Follow the rotations nearest to the matrices `a`, from `turns`, for at most so many `rounds`.
pub fn follow(a: &Matrices, turns: &mut [Quaternion; LANES], rounds: usize) {
    wide(
        #[inline(always)]
        || {
            let a = a.map(|column| column.map(Lanes));
            let mut q = std::array::from_fn(|i| Lanes(turns.map(|turn| turn[i])));
            for _ in 0..rounds {
                let (nearer, by) = nearer(&a, q);
                q = nearer;
                if by.0.iter().all(|by| *by < NEAR) {
                    break;
                }
            }
            for (k, turn) in turns.iter_mut().enumerate() {
                *turn = q.map(|part| part.0[k]);
            }
        },
    );
}

/// One round: the rotations, and the squared sines of half the turns that led to them.
#[inline(always)]
fn nearer(a: &[[Lanes; 3]; 3], q: [Lanes; 4]) -> ([Lanes; 4], Lanes) {
    let r = columns(q);
    let p = |i: usize, j: usize| a[0][i] * r[0][j] + a[1][i] * r[1][j] + a[2][i] * r[2][j];
    let (xx, yy, zz) = (p(0, 0), p(1, 1), p(2, 2));
    let (xy, yx, yz, zy, zx, xz) = (p(0, 1), p(1, 0), p(1, 2), p(2, 1), p(2, 0), p(0, 2));
    let v = [zy - yz, xz - zx, yx - xy];
    let half = Lanes::from(-0.5);
    let (f, g, h) = (half * (xy + yx), half * (yz + zy), half * (zx + xz));
    let (mx, my, mz) = (yy + zz, zz + xx, xx + yy);
    // The adjugate of M, which is M⁻¹ up to the determinant.
    let (ax, ay, az) = (my * mz - g * g, mx * mz - h * h, mx * my - f * f);
    let (af, ag, ah) = (h * g - f * mz, f * h - g * mx, f * g - h * my);
    let determinant = mx * ax + f * af + h * ah;
    let newton = [
        ax * v[0] + af * v[1] + ah * v[2],
        af * v[0] + ay * v[1] + ag * v[2],
        ah * v[0] + ag * v[1] + az * v[2],
    ];
    let definite =
        std::array::from_fn(|k| (mx.0[k] > 0.0) & (az.0[k] > 0.0) & (determinant.0[k] > 0.0));
    let mut axis: [Lanes; 3] = std::array::from_fn(|i| newton[i].or(v[i], definite));
    for k in (0..LANES).filter(|k| !definite[*k]) {
        let m = [[mx, f, h], [f, my, g], [h, g, mz]].map(|column| column.map(|of| of.0[k]));
        let uphill = off_saddle(Mat3::from_cols_array_2d(&m), v.map(|of| of.0[k]).into());
        (0..3).for_each(|i| axis[i].0[k] = uphill[i]);
    }
    let [x, y, z] = axis;
    // With d the axis: nᵀMn = dᵀMd/|d|², n·v = d·v/|d|.
    let along =
        x * (mx * x + f * y + h * z) + y * (f * x + my * y + g * z) + z * (h * x + g * y + mz * z);
    let slope = x * v[0] + y * v[1] + z * v[2];
    let dd = x * x + y * y + z * z;
    let root = (along * along + slope * slope * dd).map(f64::sqrt);
    // The tangent of half the angle is slope·|d| / (along + root) = (root − along) / (slope·|d|);
    // use the form without cancellation.
    let ahead = along.0.map(|along| along >= 0.0);
    let (whole, part) = (
        (along + root).or(slope * dd, ahead),
        slope.or(root - along, ahead),
    );
    let some = (whole * whole + part * part * dd)
        .0
        .map(|size| size > f64::MIN_POSITIVE);
    let (whole, part) = (
        whole.or(Lanes::from(1.0), some),
        part.or(Lanes::from(0.0), some),
    );
    let next = product([whole, part * x, part * y, part * z], q);
    let [a, b, c, d] = next.map(|part| part * part);
    let size = (a + b + c + d).map(|square| 1.0 / square.sqrt());
    (next.map(|part| part * size), part * part * dd * size * size)
}

/// The rotation axis if `m` is not positive definite: `v`, or that of its lowest eigenvalue. Rare:
/// inverted cells.
#[cold]
#[inline(never)]
fn off_saddle(m: Mat3, v: Vec3) -> Vec3 {
    let Ok(eigen) = Mat::from_fn(3, 3, |i, j| m.col(j)[i]).self_adjoint_eigen(Side::Lower) else {
        return v;
    };
    let lowest = eigen.S()[0];
    let slope = v.length();
    let bend = v.dot(m * v) / (slope * slope);
    if slope.hypot(bend) - bend > -2.0 * lowest {
        v
    } else if lowest < -FLAT * eigen.S()[2].abs() {
        Vec3::from(std::array::from_fn(|i| eigen.U()[(i, 0)]))
    } else {
        Vec3::ZERO
    }
}

/// First `b`, then `a`.
#[inline(always)]
fn product<T>(a: [T; 4], b: [T; 4]) -> [T; 4]
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn turn(axis: Vec3, angle: f64) -> Quaternion {
        let Vec3 { x, y, z } = (0.5 * angle).sin() / axis.length() * axis;
        [(0.5 * angle).cos(), x, y, z]
    }

    /// Follow the rotation of one matrix, whose columns are `a`, from `q`.
    fn follow_one(a: &[[f64; 3]; 3], q: Quaternion, rounds: usize) -> Quaternion {
        let mut turns = [q; LANES];
        follow(
            &a.map(|column| column.map(|v| [v; LANES])),
            &mut turns,
            rounds,
        );
        assert!(turns.iter().all(|other| *other == turns[0]));
        turns[0]
    }

    /// tr(RᵀA)
    fn likeness(a: &[[f64; 3]; 3], q: Quaternion) -> f64 {
        let r = columns(q);
        (0..3)
            .map(|c| (0..3).map(|i| r[c][i] * a[c][i]).sum::<f64>())
            .sum()
    }

    /// The upper bound of tr(RᵀA): the sum of the singular values, the least of them with the sign
    /// of the determinant.
    fn highest(a: &[[f64; 3]; 3]) -> f64 {
        let values = Mat::from_fn(3, 3, |i, c| a[c][i])
            .singular_values()
            .unwrap();
        values[0] + values[1] + values[2].copysign(Mat3::from_cols_array_2d(a).determinant())
    }

    fn numbers(within: f64) -> impl Strategy<Value = [f64; 3]> {
        [-within..within, -within..within, -within..within]
    }

    proptest! {
        #[test]
        fn the_rotation_of_a_stretched_one_is_found(
            axis in numbers(1.0).prop_map(Vec3::from), angle in 0.0..2.5f64, stretch in [0.5..2.0f64, 0.5..2.0, 0.5..2.0],
        ) {
            prop_assume!(axis.length() > 0.1);
            let r = columns(turn(axis, angle));
            // A = R S with S = diag(stretch): its polar rotation is R.
            let a: [[f64; 3]; 3] = std::array::from_fn(|c| r[c].map(|v| stretch[c] * v));
            let found = columns(follow_one(&a, NO_TURN, 200));
            for c in 0..3 {
                for i in 0..3 {
                    prop_assert!((found[c][i] - r[c][i]).abs() < 1e-8);
                }
            }
            // From a near start, two rounds reach double precision.
            let near = columns(follow_one(&a, product(turn(Vec3::new(0.3, -0.5, 0.8), 0.01), turn(axis, angle)), 2));
            for c in 0..3 {
                for i in 0..3 {
                    prop_assert!((near[c][i] - r[c][i]).abs() < 1e-13);
                }
            }
        }

        #[test]
        fn no_round_makes_it_worse_and_every_start_leads_to_the_maximum(
            a in [numbers(1.0), numbers(1.0), numbers(1.0)], axis in numbers(1.0).prop_map(Vec3::from), angle in 0.0..3.1f64, flat in 0..3usize,
        ) {
            prop_assume!(axis.length() > 0.1);
            let mut a = a;
            // Of any kind, of rank two, of rank one.
            (3 - flat..3).for_each(|c| a[c] = a[0]);
            let mut q = turn(axis, angle);
            for _ in 0..20 {
                let next = follow_one(&a, q, 1);
                prop_assert!(likeness(&a, next) >= likeness(&a, q) - 1e-12);
                q = next;
            }
            prop_assert!((likeness(&a, q) - highest(&a)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_saddle_is_left() {
        // A first-order method takes 236 rounds next to this one.
        let a = [
            [
                -0.4621942037270377,
                0.041877052019668445,
                -0.4115447162982399,
            ],
            [-0.9999680695509392, 0.8432637521114641, -0.7379555243440264],
            [0.658837131867861, -0.7570598958487585, 0.979943001070668],
        ];
        let q = turn(
            Vec3::new(0.9596464054530129, 0.6923970990015571, 0.3094135991388589),
            1.8170538299717645,
        );
        assert!((likeness(&a, follow_one(&a, q, 8)) - highest(&a)).abs() < 1e-12);
        // Half a turn from the maximum, the gradient is zero.
        let stretched = [[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]];
        for axis in Vec3::AXES {
            let q = turn(axis, std::f64::consts::PI);
            assert!((likeness(&stretched, follow_one(&stretched, q, 8)) - 6.0).abs() < 1e-12);
        }
    }

    #[test]
    fn nothing_turns_nothing() {
        assert_eq!(follow_one(&[[0.0; 3]; 3], NO_TURN, 10), NO_TURN);
        assert_eq!(rotation(NO_TURN), Mat3::IDENTITY);
    }
}

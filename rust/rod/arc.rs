//! A chain of segments of constant curvature: positions of its points, and their slopes over
//! bending and length.
//!
//! A segment of length L with bending vector v = (v_x, v_y) (rad; it bends towards v by β = |v|)
//! carries the frame at its start to its end by
//!   p' = p + R · L · (c·v, s),   R' = R · exp[φ]ₓ,   φ = (−v_y, v_x, 0),   c = (1 − cos β)/β²,   s
//!     = sin β/β,
//! without twist. A point at the share f of it is the end of a segment of length f·L bent by f·v.
//! Units: mm and rad. All quotients have series near the straight pose, so they are accurate at β =
//! 0.

use crate::algebra::{Mat3, Vec3};

/// The quotients of one bending angle β and, primed, their slopes divided by β.
struct Quotients {
    c: f64,
    s: f64,
    dc: f64,
    ds: f64,
    /// (β − sin β)/β³
    t: f64,
}

impl Quotients {
    fn new(square: f64) -> Self {
        // Below 0.03 rad the series are exact to 1e-15 and the quotients lose digits.
        if square < 9e-4 {
            return Self {
                c: 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)),
                s: 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)),
                dc: -1.0 / 12.0 + square / 180.0 * (1.0 - square / 37.333_333_333_333_336),
                ds: -1.0 / 3.0 + square / 30.0 * (1.0 - square / 28.0),
                t: 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0),
            };
        }
        let beta = square.sqrt();
        let (sin, cos) = beta.sin_cos();
        let half = (0.5 * beta).sin();
        let (c, s) = (2.0 * half * half / square, sin / beta); // 1 − cos β would cancel
        Self {
            c,
            s,
            dc: (s - 2.0 * c) / square,
            ds: (cos - s) / square,
            t: (1.0 - s) / square,
        }
    }
}

/// End of a segment of length 1 bent by `v`, in the frame of its start.
fn chord(v: [f64; 2]) -> Vec3 {
    let q = Quotients::new(v[0] * v[0] + v[1] * v[1]);
    Vec3::new(q.c * v[0], q.c * v[1], q.s)
}

/// Slopes of `chord` over v_x and v_y.
fn chord_slopes(v: [f64; 2]) -> [Vec3; 2] {
    let q = Quotients::new(v[0] * v[0] + v[1] * v[1]);
    [0, 1].map(|axis| {
        let mut slope = Vec3::new(q.dc * v[axis] * v[0], q.dc * v[axis] * v[1], q.ds * v[axis]);
        slope[axis] += q.c;
        slope
    })
}

/// exp[φ]ₓ and the turning of the end, in the frame of the start, per unit of v_x and of v_y.
fn rotation(v: [f64; 2]) -> (Mat3, [Vec3; 2]) {
    let q = Quotients::new(v[0] * v[0] + v[1] * v[1]);
    let axis = Vec3::new(-v[1], v[0], 0.0);
    let column = |unit: Vec3, first: f64, second: f64| {
        let once = axis.cross(unit);
        unit + (first * once + second * axis.cross(once))
    };
    let [x, y, z] = Vec3::AXES.map(|unit| column(unit, q.s, q.c));
    let turn = Mat3::from_cols(x, y, z);
    // The left Jacobian of the rotation, applied to dφ = (−dv_y, dv_x, 0).
    let turning = [Vec3::Y, Vec3::NEG_X].map(|unit| column(unit, q.c, q.t));
    (turn, turning)
}

/// Slopes of a point over the base's tilt (2,), each segment's bending (2S,) and length (S,).
pub(super) struct Slopes {
    pub(super) tilt: [Vec3; 2],
    pub(super) bends: Vec<Vec3>,
    pub(super) lengths: Vec<Vec3>,
}

/// The frames at the joints of a chain: the tilted base, then the end of each segment.
pub(super) struct Chain<'a> {
    bends: &'a [f64],
    lengths: &'a [f64],
    points: Vec<Vec3>,
    turns: Vec<Mat3>,
    /// Rotation of everything beyond a joint, per unit of tilt_x, tilt_y, then of each segment's
    /// v_x, v_y.
    turnings: Vec<Vec3>,
}

impl<'a> Chain<'a> {
    /// A chain of segments bent by `bends` (2S,) rad, of `lengths` (S,) mm, from `base` mm, which
    /// is turned by `tilt` rad.
    pub(super) fn new(base: Vec3, tilt: [f64; 2], bends: &'a [f64], lengths: &'a [f64]) -> Self {
        let (turn, turning) = rotation(tilt);
        let mut chain = Self {
            bends,
            lengths,
            points: vec![base],
            turns: vec![turn],
            turnings: turning.to_vec(),
        };
        for (k, length) in lengths.iter().enumerate() {
            let v = chain.bend(k);
            let (start, from) = (chain.turns[k], chain.points[k]);
            let (turn, turning) = rotation(v);
            chain.turnings.extend(turning.map(|axis| start * axis));
            chain.points.push(from + start * (length * chord(v)));
            chain.turns.push(start * turn);
        }
        chain
    }

    fn bend(&self, k: usize) -> [f64; 2] {
        [self.bends[2 * k], self.bends[2 * k + 1]]
    }

    /// The point at the share `f` of segment `k`.
    pub(super) fn point(&self, k: usize, f: f64) -> Vec3 {
        let v = self.bend(k).map(|x| x * f);
        let local = f * self.lengths[k] * chord(v);
        self.points[k] + self.turns[k] * local
    }

    /// Storage for the slopes of a point.
    pub(super) fn room(&self) -> Slopes {
        Slopes {
            tilt: [Vec3::ZERO; 2],
            bends: vec![Vec3::ZERO; self.bends.len()],
            lengths: vec![Vec3::ZERO; self.lengths.len()],
        }
    }

    /// The slopes of that point.
    pub(super) fn slopes(&self, k: usize, f: f64, out: &mut Slopes) {
        out.bends.fill(Vec3::ZERO);
        out.lengths.fill(Vec3::ZERO);
        let point = self.point(k, f);
        for (axis, out) in out.tilt.iter_mut().enumerate() {
            *out = self.turnings[axis].cross(point - self.points[0]);
        }
        for i in 0..=k {
            let share = if i == k { f } else { 1.0 };
            let (turn, v) = (self.turns[i], self.bend(i).map(|x| x * share));
            out.lengths[i] = turn * (share * chord(v));
            let moved = chord_slopes(v);
            for axis in 0..2 {
                let local = self.lengths[i] * share * share * moved[axis];
                let slope = &mut out.bends[2 * i + axis];
                *slope = turn * local;
                if i < k {
                    let arm = point - self.points[i + 1];
                    *slope += self.turnings[2 + 2 * i + axis].cross(arm);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const BASE: Vec3 = Vec3::new(1.0, -2.0, 3.0);

    #[test]
    fn a_quarter_circle_ends_where_a_quarter_circle_ends() {
        let radius = 200.0 / std::f64::consts::PI;
        let bends = [std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0];
        let chain = Chain::new(Vec3::ZERO, [0.0; 2], &bends, &[100.0, 50.0]);
        for (point, expected) in [
            (chain.point(0, 1.0), [radius, 0.0, radius]),
            (chain.point(1, 1.0), [radius + 50.0, 0.0, radius]),
            (
                chain.point(0, 0.5),
                [radius * (1.0 - 0.5f64.sqrt()), 0.0, radius * 0.5f64.sqrt()],
            ),
        ] {
            for (a, b) in point.to_array().into_iter().zip(expected) {
                assert!((a - b).abs() < 1e-12, "{point:?} against {expected:?}");
            }
        }
    }

    #[test]
    fn the_series_meet_the_quotients() {
        for square in [8.999e-4, 9.001e-4f64] {
            let (q, beta) = (Quotients::new(square), square.sqrt());
            let (sin, cos) = beta.sin_cos();
            // Round-off of the quotients: 1e-16 over β², β² and β⁴.
            assert!((q.s - sin / beta).abs() < 1e-15);
            assert!((q.c - (1.0 - cos) / square).abs() < 1e-12);
            assert!((q.t - (beta - sin) / (square * beta)).abs() < 1e-11);
            assert!((q.ds - (cos - sin / beta) / square).abs() < 1e-12);
            assert!((q.dc - (sin / beta - 2.0 * q.c) / square).abs() < 1e-11);
        }
    }

    proptest! {
        #[test]
        fn slopes_match_finite_differences(
            tilt in prop::array::uniform2(-0.4..0.4f64),
            bends in prop::array::uniform4(-2.5..2.5f64),
            small in prop::sample::select(vec![1.0, 1e-2, 1e-6, 0.0]),
            f in 0.05..1.0f64,
        ) {
            let bends = bends.map(|v| v * small);
            let lengths = [70.0, 50.0];
            let chain = Chain::new(BASE, tilt, &bends, &lengths);
            let mut room = chain.room();
            chain.slopes(1, f, &mut room);
            let slopes: Vec<Vec3> = room.tilt.into_iter().chain(room.bends).chain(room.lengths).collect();
            let numbers: Vec<f64> = tilt.iter().chain(&bends).chain(&lengths).copied().collect();
            for (i, slope) in slopes.iter().enumerate() {
                let at = |step: f64| {
                    let mut moved = numbers.clone();
                    moved[i] += step;
                    Chain::new(BASE, [moved[0], moved[1]], &moved[2..6], &moved[6..]).point(1, f)
                };
                let (plus, minus) = (at(1e-5), at(-1e-5));
                for axis in 0..3 {
                    // Central differences of values near 100 mm over 2e-5: round-off 1e-9,
                    // truncation 1e-8.
                    let numeric = (plus[axis] - minus[axis]) / 2e-5;
                    prop_assert!((slope[axis] - numeric).abs() < 1e-6, "{i}: {} against {numeric}", slope[axis]);
                }
            }
        }
    }
}

//! Mount: the base is turned and shifted in the frame of the cameras; a measurement fault, not
//! physics of the robot.
//!
//! `p = R·p + shift` about the base's origin, `R` the turn by the rotation vector `turn` (degrees;
//! Rodrigues' formula with the series at small angles). Directions only turn. Exact for any angle;
//! gravity on a truly tilted base is the effect `gravity`.

use super::conditions::Context;
use super::declaration::*;

/// One of three similar parameters.
const fn turn(name: &'static str, doc: &'static str) -> Parameter {
    Parameter::new(name, "deg", 0.0, 1.0, -6.0, 6.0, doc)
}

const fn shift(name: &'static str, doc: &'static str) -> Parameter {
    Parameter::new(name, "mm", 0.0, 1.0, -6.0, 6.0, doc)
}

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "mount",
        family: "sensor frame",
        stage: Stage::Sensing,
        kind: Kind::Fault,
        formula: "p = R(turn) · p + shift  about the origin of the base",
        doc: "The clamped base is misplaced in the measured frame: a rigid turn and shift of \
            everything seen.",
        signature: "Static and rigid, at home too: even the clamped base has moved.",
        reference: "Rotation vector by Rodrigues' formula.",
        experiment: ("points near the base, home revisits", 0.5),
        alike: &[
            ("routing", "roll"),
            ("pre_curve", "base"),
            ("gravity", "base"),
        ],
        needs: &[],
        parameters: &[
            turn("turn_x", "x component of the rotation vector"),
            turn("turn_y", "y component of the rotation vector"),
            turn("turn_z", "z component of the rotation vector"),
            shift("shift_x", "shift along x"),
            shift("shift_y", "shift along y"),
            shift("shift_z", "shift along z"),
        ],
    },
    law: Law::Sensing(&Mount),
};

struct Mount;

/// Below this angle (rad) sin(a)/a and (1 − cos a)/a² are taken from their series, which is exact
/// to round-off there.
const SMALL: f64 = 1e-4;

fn rotation(degrees: &[f64]) -> [[f64; 3]; 3] {
    let [x, y, z] = [
        degrees[0].to_radians(),
        degrees[1].to_radians(),
        degrees[2].to_radians(),
    ];
    let square = x * x + y * y + z * z;
    let angle = square.sqrt();
    let (a, b) = if angle < SMALL {
        (1.0 - square / 6.0, 0.5 - square / 24.0)
    } else {
        (
            angle.sin() / angle,
            2.0 * (0.5 * angle).sin().powi(2) / square,
        )
    };
    [
        [
            1.0 - b * (y * y + z * z),
            b * x * y - a * z,
            b * x * z + a * y,
        ],
        [
            b * x * y + a * z,
            1.0 - b * (x * x + z * z),
            b * y * z - a * x,
        ],
        [
            b * x * z - a * y,
            b * y * z + a * x,
            1.0 - b * (x * x + y * y),
        ],
    ]
}

impl SensingEffect for Mount {
    fn apply(
        &self,
        params: &[f64],
        positions: &[bool],
        points: &mut [f64],
        _context: &Context,
        _cameras: &[Camera],
    ) {
        move_rigidly(params, positions, points);
    }
}

/// Turn `points` (V, 3) by the first three numbers (deg) and shift places by the last three (mm).
pub(super) fn move_rigidly(six: &[f64], positions: &[bool], points: &mut [f64]) {
    let turn = rotation(&six[..3]);
    for (p, place) in points.chunks_exact_mut(3).zip(positions) {
        let from = [p[0], p[1], p[2]];
        for i in 0..3 {
            let shift = if *place { six[3 + i] } else { 0.0 };
            p[i] = turn[i][0] * from[0] + turn[i][1] * from[1] + turn[i][2] * from[2] + shift;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::rotation;

    #[test]
    fn rotations_are_orthogonal_down_to_the_smallest_angle() {
        for size in [0.0, 1e-12, 5.7e-3, 5.8e-3, 3.0, 170.0] {
            let r = rotation(&[size, -0.3 * size, 0.6 * size]);
            for i in 0..3 {
                for j in 0..3 {
                    let dot: f64 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
                    assert!((dot - f64::from(i == j)).abs() < 1e-14, "{size}: {dot}");
                }
            }
        }
    }

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let r = rotation(&[0.0, 0.0, 90.0]);
        assert!((r[1][0] - 1.0).abs() < 1e-15 && r[0][0].abs() < 1e-15);
    }
}

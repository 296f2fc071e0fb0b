//! The rod against finite differences, its limits and beam theory.

use super::*;
use proptest::prelude::*;

const LENGTHS: [f64; 2] = [100.0, 80.0];

/// Two chords, two channels, quadratic; chord lengths shorten with the angles. `offset` bends the
/// rest pose.
fn rod(offset: f64) -> Rod {
    let mut angles = vec![0.0; 6 * 4];
    angles[..4].copy_from_slice(&[offset, -offset, 0.5 * offset, 0.0]);
    angles[4..12].copy_from_slice(&[0.6, 0.05, -0.1, 0.02, 0.03, 0.5, 0.1, 0.7]);
    angles[12..].copy_from_slice(&[
        0.1, 0.0, 0.05, 0.0, 0.02, -0.1, 0.0, 0.0, 0.0, 0.1, 0.0, -0.05,
    ]);
    let mut lengths = vec![0.0; 15 * 2];
    lengths[..2].copy_from_slice(&LENGTHS);
    lengths[2] = 1.5;
    lengths[10] = -4.0;
    lengths[29] = -3.0;
    Rod::new(
        [1.0, 2.0, -3.0],
        vec![1.0, -1.0],
        vec![10.0, 8.0],
        Form::Powers { degree: 2 },
        angles,
        lengths,
    )
    .expect("a valid rod")
}

/// The same with other weights for the two cables of each command: 14 monomials of four pulls.
fn pulled() -> Rod {
    let number = |i: usize| 0.3 * ((7 * i % 11) as f64 / 11.0 - 0.4);
    let mut lengths = vec![0.0; 15 * 2];
    lengths[..2].copy_from_slice(&LENGTHS);
    lengths[10] = -4.0;
    Rod::new(
        [1.0, 2.0, -3.0],
        vec![1.0, -1.0],
        vec![10.0, 8.0],
        Form::Pulls { degree: 2 },
        (0..15 * 4).map(number).collect(),
        lengths,
    )
    .expect("a valid rod")
}

#[test]
fn a_pulled_rod_bends_by_one_cable_of_a_command_or_by_the_other() {
    let rod = pulled();
    assert_eq!((rod.channels(), rod.size()), (2, 6));
    for u in [[6.0, 3.0], [6.0, -5.0], [-7.0, 3.0], [-7.0, -5.0]] {
        let mut slopes = [f64::NAN; 12];
        rod.jacobian(&u, &mut slopes);
        for (own, other) in slopes.iter().zip(numeric(&rod, &u)) {
            assert!((own - other).abs() < 1e-6, "{own} {other} at {u:?}");
        }
    }
    // At the kink, the mean of the slopes of both sides.
    let (mut at, mut left, mut right) = ([0.0; 12], [0.0; 12], [0.0; 12]);
    rod.jacobian(&[1.0, 3.0], &mut at);
    rod.jacobian(&[1.0 - 1e-9, 3.0], &mut left);
    rod.jacobian(&[1.0 + 1e-9, 3.0], &mut right);
    for ((at, left), right) in at.iter().zip(left).zip(right) {
        assert!((at - 0.5 * (left + right)).abs() < 1e-6);
    }
    assert!((left[0] - right[0]).abs() > 0.1);
    let points = |u: [f64; 2]| {
        let mut out = [0.0; 6];
        rod.eval(&u, &mut out);
        out
    };
    for (below, above) in points([1.0 - 1e-9, 3.0])
        .iter()
        .zip(points([1.0 + 1e-9, 3.0]))
    {
        assert!((below - above).abs() < 1e-6);
    }
}

#[test]
fn a_splined_rod_is_smooth_and_continues_linearly() {
    let number = |i: usize| 0.3 * ((7 * i % 11) as f64 / 11.0 - 0.4);
    let mut lengths = vec![0.0; 15 * 2];
    lengths[..2].copy_from_slice(&LENGTHS);
    let rod = Rod::new(
        [1.0, 2.0, -3.0],
        vec![1.0, -1.0],
        vec![10.0, 8.0],
        Form::Splines { intervals: 3 },
        (0..37 * 4).map(number).collect(),
        lengths,
    )
    .expect("a valid rod");
    for u in [[6.0, 3.0], [1.0, -8.5], [13.0, 3.0], [-14.0, 12.0]] {
        let mut slopes = [f64::NAN; 12];
        rod.jacobian(&u, &mut slopes);
        for (own, other) in slopes.iter().zip(numeric(&rod, &u)) {
            assert!((own - other).abs() < 1e-5, "{own} {other} at {u:?}");
        }
    }
}

#[test]
fn splines_sum_to_one_and_follow_a_line_beyond_their_ends() {
    let splines = Terms::Splines(Splines::new(2, 5).expect("splines"));
    let values = |x: [f64; 2]| {
        let mut out = vec![f64::NAN; splines.count()];
        splines.values(&x, &mut out);
        out
    };
    // Coefficients at the Greville places of the first axis give that coordinate.
    let line = |x: [f64; 2]| -> f64 {
        let place = |i: usize| -1.0 + 0.4 * (i as f64 - 1.0);
        let terms = values(x).into_iter().enumerate();
        terms.map(|(at, b)| b * place(at / 8)).sum()
    };
    for x in [
        [0.3, -0.7],
        [-1.0, 1.0],
        [1.0, 0.2],
        [1.7, -2.0],
        [-3.0, 0.9],
    ] {
        assert!((values(x).iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!((line(x) - x[0]).abs() < 1e-12, "{x:?}");
    }
    for (variables, intervals) in [(0, 4), (2, 0), (7, 1), (2, usize::MAX), (3, 15)] {
        assert!(Splines::new(variables, intervals).is_err());
    }
}

fn numeric(shape: &dyn Shape, u: &[f64]) -> Vec<f64> {
    struct Plain<'a>(&'a dyn Shape);
    impl Shape for Plain<'_> {
        fn channels(&self) -> usize {
            self.0.channels()
        }
        fn size(&self) -> usize {
            self.0.size()
        }
        fn eval(&self, u: &[f64], out: &mut [f64]) {
            self.0.eval(u, out)
        }
    }
    let mut slopes = vec![0.0; shape.size() * shape.channels()];
    Plain(shape).jacobian(u, &mut slopes);
    slopes
}

#[test]
fn the_straight_pose_hangs_along_z_with_finite_slopes() {
    let rod = rod(0.0);
    let mut p = [0.0; 6];
    rod.eval(&[1.0, -1.0], &mut p);
    assert_eq!(p, [1.0, 2.0, 97.0, 1.0, 2.0, 177.0]);
    let mut slopes = [f64::NAN; 12];
    rod.jacobian(&[1.0, -1.0], &mut slopes);
    // First chord: length times the first-order angle, by hand.
    assert!(
        (slopes[0] - 100.0 * 0.6 / 10.0).abs() < 1e-12
            && (slopes[1] - 100.0 * 0.03 / 8.0).abs() < 1e-12
    );
    for (a, b) in slopes.iter().zip(numeric(&rod, &[1.0, -1.0])) {
        assert!((a - b).abs() < 1e-7, "{a} against {b}");
    }
}

proptest! {
    #[test]
    fn slopes_match_finite_differences(x in -15.0..15.0f64, y in -12.0..12.0f64, offset in -0.3..0.3f64) {
        let rod = rod(offset);
        let mut slopes = [0.0; 12];
        rod.jacobian(&[x, y], &mut slopes);
        for (a, b) in slopes.iter().zip(numeric(&rod, &[x, y])) {
            // Central differences of values near 200 mm over a step of 1e-5: round-off 5e-9,
            // truncation less.
            prop_assert!((a - b).abs() < 1e-6, "{} against {}", a, b);
        }
    }

    #[test]
    fn slopes_hold_close_to_the_straight_pose(x in -1e-3..1e-3f64, y in -1e-3..1e-3f64) {
        let rod = rod(0.0);
        let at = [1.0 + x, -1.0 + y];
        let mut slopes = [0.0; 12];
        rod.jacobian(&at, &mut slopes);
        for (a, b) in slopes.iter().zip(numeric(&rod, &at)) {
            prop_assert!((a - b).abs() < 1e-6, "{} against {}", a, b);
        }
    }
}

#[test]
fn the_series_meets_the_quotients() {
    for beta in [0.0199, 0.0201] {
        let bend = Bend::new(beta * 0.6, beta * 0.8);
        assert!((bend.sinc - f64::sin(beta) / beta).abs() < 1e-15);
        // The quotient cancels 1e-16 / 0.02³: good to 1e-10.
        assert!(
            (bend.rise - (beta * f64::cos(beta) - f64::sin(beta)) / beta.powi(3)).abs() < 1e-10
        );
    }
}

#[test]
fn a_tip_force_bends_the_straight_rod_like_a_cantilever() {
    let (length, c) = (180.0f64, 2e-7);
    let field = RodField::new(rod(0.0), "tip_force_x", c, 0.0).expect("a field");
    let mut shift = [0.0; 6];
    field.eval(&[1.0, -1.0], &mut shift);
    let beam = |s: f64| c * s * s * (3.0 * length - s) / 6.0;
    let expected = [beam(100.0), 0.0, 0.0, beam(length), 0.0, 0.0];
    for (a, b) in shift.iter().zip(expected) {
        assert!((a - b).abs() < 1e-12, "{a} against {b}");
    }
    let field = RodField::new(rod(0.0), "gravity_y", c, 0.0).expect("a field");
    field.eval(&[1.0, -1.0], &mut shift);
    let beam =
        |s: f64| c / length * s * s * (6.0 * length * length - 4.0 * length * s + s * s) / 24.0;
    for (a, b) in shift
        .iter()
        .zip([0.0, beam(100.0), 0.0, 0.0, beam(length), 0.0])
    {
        assert!((a - b).abs() < 1e-12, "{a} against {b}");
    }
}

#[test]
fn locked_chords_bend_into_an_s_and_keep_the_directions_of_their_ends() {
    let c = 1e-5;
    let mut shift = [0.0; 6];
    let field = RodField::new(rod(0.0), "tip_force_x", c, 1.0).expect("a field");
    field.eval(&[1.0, -1.0], &mut shift);
    // Clamped, guided beams one after the other: l³/12 each.
    let (first, second) = (c * 100.0f64.powi(3) / 12.0, c * 80.0f64.powi(3) / 12.0);
    for (a, b) in shift
        .iter()
        .zip([first, 0.0, 0.0, first + second, 0.0, 0.0])
    {
        assert!((a - b).abs() < 1e-12, "{a} against {b}");
    }
    assert!(RodField::new(rod(0.0), "tip_force_x", c, 1.1).is_err());
}

#[test]
fn a_force_along_the_straight_rod_does_not_bend_it() {
    for name in ["tip_force_z", "gravity_z"] {
        let mut shift = [f64::NAN; 6];
        RodField::new(rod(0.0), name, 1e-6, 0.0)
            .expect("a field")
            .eval(&[1.0, -1.0], &mut shift);
        assert_eq!(shift, [0.0; 6]);
    }
}

#[test]
fn fields_of_a_bent_rod_match_a_fine_sum() {
    for (name, load) in [("tip_force_z", Load::TipForce), ("gravity_z", Load::Weight)] {
        let (rod, c) = (rod(0.2), 1e-6);
        let u = [9.0, 6.0];
        let p = rod.points(&u);
        let mut shift = [0.0; 6];
        RodField::new(rod, name, c, 0.0)
            .expect("a field")
            .eval(&u, &mut shift);
        // Oracle: many short pieces, every product written out, moments summed point by point.
        let pieces = 400;
        let mut dots = Vec::new();
        for k in 0..2 {
            let d = p[k + 1] - p[k];
            let ds = d.length() / f64::from(pieces);
            for i in 0..pieces {
                dots.push((k, p[k] + (f64::from(i) + 0.5) / f64::from(pieces) * d, ds));
            }
        }
        let total: f64 = dots.iter().map(|d| d.2).sum();
        let mut expected = [0.0; 6];
        for (a, &(k, at, ds)) in dots.iter().enumerate() {
            let down = Vec3::Z;
            let moment = match load {
                Load::TipForce => (p[2] - at).cross(down),
                Load::Weight => dots[a..]
                    .iter()
                    .map(|d| d.2 / total * (d.1 - at).cross(down))
                    .sum(),
            };
            let d = p[k + 1] - p[k];
            let tangent = 1.0 / d.length() * d;
            let bending = moment - moment.dot(tangent) * tangent;
            for i in k..2 {
                let turn = (c * ds * bending).cross(p[i + 1] - at);
                for axis in 0..3 {
                    expected[3 * i + axis] += turn[axis];
                }
            }
        }
        let size = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!(size > 0.1, "the case must bend: {size}");
        for (a, b) in shift.iter().zip(expected) {
            // The midpoint sum is off by about 1/pieces² of the size, its end piece by 1/pieces of
            // one piece.
            assert!((a - b).abs() < 1e-4 * size, "{name}: {a} against {b}");
        }
    }
}

#[test]
fn monomials_are_graded_and_complete() {
    let m = Monomials::new(6, 3).expect("monomials");
    assert_eq!(m.len(), 83);
    assert_eq!(m.degrees().iter().filter(|&&d| d == 3).count(), 56);
    let (m, mut values) = (Monomials::new(2, 3).expect("monomials"), [0.0; 9]);
    m.values(&[2.0, 3.0], &mut values);
    assert_eq!(values, [2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]);
}

#[test]
fn bad_numbers_are_refused_in_one_line() {
    let lengths = vec![1.0; 6];
    let make = |scale: f64, rows: usize, degree: usize| {
        Rod::new(
            [0.0; 3],
            vec![0.0],
            vec![scale],
            Form::Powers { degree },
            vec![0.1; 2 * rows],
            lengths.clone(),
        )
    };
    assert!(make(1.0, 2, 1).is_ok());
    for bad in [
        make(0.0, 2, 1),
        make(f64::NAN, 2, 1),
        make(1.0, 2, 2),
        make(1.0, 2, 9),
        make(1.0, 0, 1),
    ] {
        let message = bad.expect_err("refused").to_string();
        assert!(!message.is_empty() && !message.contains('\n'));
    }
    assert!(RodField::new(rod(0.0), "twist_x", 1.0, 0.0).is_err());
    assert!(RodField::new(rod(0.0), "gravity_w", 1.0, 0.0).is_err());
    assert!(RodField::new(rod(0.0), "gravity_x", 0.0, 0.0).is_err());
}

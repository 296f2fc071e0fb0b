//! Oracles of the elastic rod: closed forms, balance of moments, slopes by finite differences.

use super::{ElasticField, ElasticRod, Layout, Tendon};
use crate::shape::Shape;
use proptest::prelude::*;
use std::f64::consts::PI;

const SEGMENTS: usize = 3;

fn tendons() -> Vec<Tendon> {
    let tendon = |j: usize| Tendon {
        end: j / 3,
        channel: j,
        pull: 1.0,
    };
    (0..9).map(tendon).collect()
}

/// Nine tendons, three per segment, all numbers different; `slack` as given.
fn rod(slack: f64) -> ElasticRod {
    let layout = Layout::new(SEGMENTS, 9, tendons(), &[1.0, 2.5, 3.0]).expect("a layout");
    let mut numbers = vec![slack];
    numbers.extend((0..9).map(|j| f64::from(j % 3) * 2.1 + f64::from(j / 3) * 0.5));
    numbers.extend((0..9).map(|j| 4.0 + 0.1 * f64::from(j)));
    numbers.extend((0..9).map(|j| 0.2 - 0.1 * f64::from(j % 4)));
    numbers.extend([6.0, 4.0, 9.0, 60.0, 65.0, 55.0]);
    numbers.extend([0.1, -0.05, 0.0, 0.02, 0.0, 0.0, 1.0, 2.0, -3.0, 0.05, -0.03]);
    ElasticRod::new(layout, numbers).expect("a rod")
}

/// −dE/dφ at a state, written from the energy.
fn moments(rod: &ElasticRod, u: &[f64]) -> f64 {
    let first = rod.layout().first;
    let (bends, stretch) = rod.state(u);
    let mut worst = 0.0f64;
    for i in 0..2 * SEGMENTS {
        let bent = bends[i] - rod.numbers[first.rest + i];
        let mut moment = -rod.numbers[first.stiffness + i / 2] * bent;
        for (j, tendon) in rod.layout().tendons.iter().enumerate() {
            let angle = rod.numbers[first.angle + j];
            let side = rod.numbers[first.radius + j] * [angle.cos(), angle.sin()][i % 2];
            let weight = if stretch[j] > 0.0 {
                1.0
            } else {
                rod.numbers[0]
            };
            if i / 2 <= tendon.end {
                moment += weight * stretch[j] * side;
            }
        }
        worst = worst.max(moment.abs());
    }
    worst
}

fn command() -> impl Strategy<Value = [f64; 9]> {
    prop::array::uniform9(-10.0..10.0f64)
}

proptest! {
    #[test]
    fn moments_balance_at_every_command(u in command(), slack in prop::sample::select(vec![0.0, 1e-3, 0.3, 1.0])) {
        // Forces of 10 mm at 4 mm: round-off 1e-14 of 40, over a condition of a few hundred.
        prop_assert!(moments(&rod(slack), &u) < 1e-9);
    }

    #[test]
    fn two_sided_tendons_are_linear(u in command(), v in command()) {
        let rod = rod(1.0);
        let bend = |u: &[f64]| rod.state(u).0;
        let (zero, a, b) = (bend(&[0.0; 9]), bend(&u), bend(&v));
        let both: Vec<f64> = u.iter().zip(&v).map(|(x, y)| 2.0 * x - y).collect();
        for (i, x) in bend(&both).iter().enumerate() {
            prop_assert!((x - zero[i] - 2.0 * (a[i] - zero[i]) + (b[i] - zero[i])).abs() < 1e-10);
        }
    }

    #[test]
    fn slopes_match_finite_differences(u in command(), slack in prop::sample::select(vec![0.0, 0.3, 1.0])) {
        let rod = rod(slack);
        let (channels, size, width) = (9, 9, rod.layout().width());
        // No tendon is so close to slack that a step changes its side.
        prop_assume!(rod.state(&u).1.iter().all(|x| x.abs() > 1e-3));
        let (mut by_command, mut out, mut by_number) =
            (vec![0.0; size * channels], vec![0.0; size], vec![0.0; size * width]);
        rod.jacobian(&u, &mut by_command);
        rod.number_slopes(&u, &mut out, &mut by_number);
        let mut plain = vec![0.0; size];
        rod.eval(&u, &mut plain);
        prop_assert_eq!(&plain, &out);
        let differences = |at: &dyn Fn(f64, &mut [f64])| -> Vec<f64> {
            let (mut plus, mut minus) = (vec![0.0; size], vec![0.0; size]);
            at(1e-6, &mut plus);
            at(-1e-6, &mut minus);
            plus.iter().zip(&minus).map(|(a, b)| (a - b) / 2e-6).collect()
        };
        for c in 0..channels {
            let numeric = differences(&|step, out| {
                let mut moved = u;
                moved[c] += step;
                rod.eval(&moved, out);
            });
            for (m, b) in numeric.iter().enumerate() {
                // Central differences of values near 200 mm over 2e-6: round-off 1e-7.
                prop_assert!((by_command[m * channels + c] - b).abs() < 2e-5);
            }
        }
        for p in 0..width {
            if p == 0 && (slack == 0.0 || slack == 1.0) {
                continue; // at its bounds there is no step to both sides
            }
            let numeric = differences(&|step, out| {
                let mut moved = rod.numbers.clone();
                moved[p] += step;
                ElasticRod::new(rod.layout.clone(), moved).expect("a rod").eval(&u, out);
            });
            for (m, b) in numeric.iter().enumerate() {
                let a = by_number[m * width + p];
                prop_assert!((a - b).abs() < 2e-5 * a.abs().max(1.0), "number {p}: {a} against {b}");
            }
        }
    }
}

/// One segment of 100 mm with two tendons at ±x.
fn pair(slack: f64, stiffness: f64, radius: f64) -> ElasticRod {
    let tendons = (0..2).map(|channel| Tendon {
        end: 0,
        channel,
        pull: 1.0,
    });
    let layout = Layout::new(1, 2, tendons.collect(), &[1.0]).expect("a layout");
    let mut numbers = vec![slack, 0.0, PI, radius, radius, 0.0, 0.0, stiffness, 100.0];
    numbers.extend([0.0; 7]);
    ElasticRod::new(layout, numbers).expect("a rod")
}

#[test]
fn a_pair_has_its_closed_forms() {
    let bend = |slack: f64, u: [f64; 2]| pair(slack, 8.0, 4.0).state(&u).0[0];
    // Two-sided: (κ + 2r²)·θ = r·(u₁ − u₂).
    assert!((bend(1.0, [3.0, -1.0]) - 4.0 * 4.0 / 40.0).abs() < 1e-12);
    // Cables: only the first pulls, (κ + r²)·θ = r·u₁, however far the other is paid out.
    for paid in [-2.0, -50.0] {
        assert!((bend(0.0, [3.0, paid]) - 12.0 / 24.0).abs() < 1e-12);
    }
    // In between: the slack tendon pushes with its share.
    assert!((bend(0.25, [3.0, -2.0]) - (12.0 + 0.25 * 8.0) / (24.0 + 0.25 * 16.0)).abs() < 1e-12);
    // Both paid out: straight for cables, at rest.
    assert!(bend(0.0, [-3.0, -1.0]).abs() < 1e-15);
    // Tendons much stiffer than the body hold their length: θ = u/r.
    let stiff = pair(0.0, 1e-6, 4.0).state(&[3.0, -30.0]).0[0];
    assert!((stiff - 0.75).abs() < 1e-6);
    // A body much stiffer than the tendons does not bend.
    assert!(pair(0.0, 1e9, 4.0).state(&[3.0, -30.0]).0[0] < 1e-7);
}

#[test]
fn an_outer_tendon_bends_the_inner_segment_too() {
    let tendons = vec![Tendon {
        end: 1,
        channel: 0,
        pull: 2.0,
    }];
    let layout = Layout::new(2, 1, tendons, &[2.0]).expect("a layout");
    let mut numbers = vec![0.0, 0.0, 4.0, 0.0, 8.0, 4.0, 50.0, 50.0];
    numbers.extend([0.0; 9]);
    let (bends, stretch) = ElasticRod::new(layout, numbers)
        .expect("a rod")
        .state(&[1.5]);
    // One tension T bends both: κ_s·θ_s = r·T, T = δ = d·u − r·(θ₁ + θ₂).
    let tension = 3.0 / (1.0 + 16.0 / 8.0 + 16.0 / 4.0);
    assert!((stretch[0] - tension).abs() < 1e-12);
    assert!((bends[0] - 4.0 * tension / 8.0).abs() < 1e-12);
    assert!((bends[2] - 4.0 * tension / 4.0).abs() < 1e-12);
}

#[test]
fn a_load_moves_markers_as_the_energy_says() {
    // Straight rod, no tendon pulls: the tip force turns the one segment by F·L²/2 over κ, the tip
    // moves by that times L/2.
    let rod = pair(0.0, 8.0, 4.0);
    let mut shift = [0.0; 3];
    let field = |name| ElasticField::new(rod.clone(), name, 0.01).expect("a field");
    field("tip_force_x").eval(&[-1.0, -1.0], &mut shift);
    let expected = 0.01 * 50.0 * 50.0 / 8.0;
    assert!((shift[0] - expected).abs() < 1e-9 && shift[1].abs() < 1e-12 && shift[2].abs() < 1e-12);
    // Spread evenly: the point at f moves by f²·L/2 per rad, a third of it on average.
    field("gravity_y").eval(&[-1.0, -1.0], &mut shift);
    assert!((shift[1] - expected / 3.0).abs() < 1e-9);
    // A taut tendon resists: κ + r² in place of κ.
    field("tip_force_y").eval(&[-1.0, -1.0], &mut shift);
    let free = shift[1];
    let taut = pair(0.0, 8.0, 4.0);
    ElasticField::new(taut, "tip_force_x", 0.01)
        .expect("a field")
        .eval(&[1e-9, -1.0], &mut shift);
    assert!((shift[0] / free - 8.0 / 24.0).abs() < 1e-6);
}

#[test]
fn numbers_that_no_rod_has_are_refused_in_one_line() {
    let layout = |segments, tendons: Vec<Tendon>, at: &[f64]| Layout::new(segments, 9, tendons, at);
    for wrong in [
        layout(0, vec![], &[1.0]),
        layout(99, vec![], &[1.0]),
        layout(2, tendons(), &[1.0]),
        layout(3, tendons(), &[]),
        layout(3, tendons(), &[3.1]),
        layout(3, tendons(), &[f64::NAN]),
        layout(3, vec![tendons()[0]; 65], &[1.0]),
        layout(
            1,
            vec![Tendon {
                end: 0,
                channel: 0,
                pull: f64::NAN,
            }],
            &[1.0],
        ),
        layout(
            1,
            vec![Tendon {
                end: 0,
                channel: usize::MAX,
                pull: 1.0,
            }],
            &[1.0],
        ),
    ] {
        let message = wrong.expect_err("refused").to_string();
        assert!(message.len() > 20 && !message.contains('\n'), "{message}");
    }
    let good = rod(0.0);
    for (at, value) in [
        (0, 1.5),
        (1, f64::NAN),
        (10, 0.0),
        (28, -1.0),
        (31, f64::INFINITY),
    ] {
        let mut numbers = good.numbers.clone();
        numbers[at] = value;
        let label = good.layout.labels()[at].clone();
        let message = ElasticRod::new(good.layout.clone(), numbers)
            .expect_err("refused")
            .to_string();
        assert!(message.contains(&label), "{message}");
    }
    assert!(ElasticRod::new(good.layout.clone(), vec![0.0; 3]).is_err());
    assert!(ElasticField::new(good, "heat", 1.0).is_err());
}

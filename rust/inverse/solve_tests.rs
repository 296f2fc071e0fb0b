//! Bounded searches on shapes with known solutions.

use super::super::published;
use super::{REACHED, Reach};
use crate::shape::Shape;
use std::sync::Arc;

const ALL: [bool; 3] = [true; 3];

/// A finger that bends with constant curvature: 0.1 rad per mm of each of two commands, 80 mm long.
struct Arc3;

impl Shape for Arc3 {
    fn channels(&self) -> usize {
        2
    }
    fn size(&self) -> usize {
        3
    }
    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let angle = 0.1 * u[0].hypot(u[1]).max(1e-9);
        let radius = 80.0 / angle;
        let aside = radius * (1.0 - angle.cos()) / (angle / 0.1);
        out.copy_from_slice(&[aside * u[0], aside * u[1], radius * angle.sin()]);
    }
}

/// Six commands in redundant pairs: x, y, z.
struct Redundant;

impl Shape for Redundant {
    fn channels(&self) -> usize {
        6
    }
    fn size(&self) -> usize {
        3
    }
    fn eval(&self, u: &[f64], out: &mut [f64]) {
        for i in 0..3 {
            let sum = u[i] + u[i + 3];
            out[i] = 3.0 * sum + 0.2 * sum * sum;
        }
    }
}

/// One periodic command: sin.
struct Fold;

impl Shape for Fold {
    fn channels(&self) -> usize {
        1
    }
    fn size(&self) -> usize {
        3
    }
    fn eval(&self, u: &[f64], out: &mut [f64]) {
        out.copy_from_slice(&[(2.0 * u[0]).sin() + 0.1 * u[0], 0.0, 0.0]);
    }
}

fn finger(axes: [bool; 3]) -> Reach {
    Reach::new(Arc::new(Arc3), vec![-5.0; 2], vec![5.0; 2], axes).unwrap()
}

fn at(u: &[f64]) -> [f64; 3] {
    let mut place = [0.0; 3];
    Arc3.eval(u, &mut place);
    place
}

#[test]
fn places_within_reach_are_found_to_a_nanometre_or_so() {
    let reach = finger(ALL);
    for k in 0..200 {
        let u = [
            4.9 * (1.7 * f64::from(k)).sin(),
            4.9 * (2.3 * f64::from(k)).cos(),
        ];
        let found = reach.solve(&at(&u), None);
        assert!(found.distance < 2e-6, "{u:?}: {found:?}");
        assert!(found.asked < 25, "{u:?}: {found:?}");
    }
}

#[test]
fn a_path_costs_a_few_looks_a_waypoint_and_does_not_jump() {
    let reach = finger(ALL);
    let u = |k: i32| {
        let angle = f64::from(k) * 0.02;
        [3.0 * angle.cos(), 3.0 * angle.sin()]
    };
    let targets: Vec<f64> = (0..315).flat_map(|k| at(&u(k))).collect();
    let found = reach.path(&targets, None);
    for (k, found) in found.iter().enumerate() {
        let expected = u(k as i32);
        assert!((0..2).all(|c| (found.u[c] - expected[c]).abs() < 1e-5));
        assert!(k == 0 || found.asked <= 8, "waypoint {k}: {}", found.asked);
    }
}

#[test]
fn what_is_out_of_reach_ends_at_the_nearest_place_with_its_distance() {
    let reach = finger(ALL);
    // Beyond a corner of the bounds, and next to an edge: the nearest of a million places is no
    // nearer.
    for target in [
        [60.0, 50.0, 60.0],
        [70.0, 0.0, 40.0],
        [0.0, 0.0, 95.0],
        [-30.0, 80.0, 10.0],
    ] {
        let found = reach.solve(&target, None);
        let mut best = f64::INFINITY;
        for i in 0..=1000 {
            for j in 0..=1000 {
                let place = at(&[-5.0 + 0.01 * f64::from(i), -5.0 + 0.01 * f64::from(j)]);
                let apart: f64 = place.iter().zip(target).map(|(p, t)| (p - t).powi(2)).sum();
                best = best.min(apart.sqrt());
            }
        }
        assert!(
            found.distance > 1.0 && found.distance <= best + 1e-9,
            "{target:?}: {found:?} {best}"
        );
        assert!(found.u.iter().all(|u| u.abs() <= 5.0));
    }
}

#[test]
fn axes_that_do_not_count_are_free() {
    let reach = finger([true, true, false]);
    let mut target = at(&[2.0, -3.0]);
    target[2] = -1000.0;
    let found = reach.solve(&target, None);
    assert!(
        found.distance < 1e-5 && (found.u[0] - 2.0).abs() < 1e-5 && (found.u[1] + 3.0).abs() < 1e-5
    );
}

#[test]
fn many_commands_share_the_work() {
    let reach = Reach::new(Arc::new(Redundant), vec![-2.0; 6], vec![2.0; 6], ALL).unwrap();
    let found = reach.solve(&[5.0, -4.0, 9.0], None);
    assert!(found.distance < 2e-6);
    let stay = reach.solve(&found.place, Some(&found.u));
    assert_eq!(stay.u, found.u);
}

#[test]
fn a_fold_is_no_trap() {
    let reach = Reach::new(Arc::new(Fold), vec![-3.0], vec![3.0], ALL).unwrap();
    // From u = −2.5, descent leads to the wrong side of a hill.
    for target in [1.07, -1.07, 0.9] {
        let found = reach.solve(&[target, 0.0, 0.0], Some(&[-2.5]));
        assert!(found.distance <= REACHED, "{target}: {found:?}");
    }
}

#[test]
fn the_published_way_gets_there_too_at_a_higher_price() {
    let reach = finger(ALL);
    let targets: Vec<f64> = (0..50)
        .flat_map(|k| {
            at(&[
                2.0 * (0.1 * f64::from(k)).sin(),
                2.0 * (0.1 * f64::from(k)).cos(),
            ])
        })
        .collect();
    let (ours, theirs) = (
        reach.path(&targets, None),
        published::path(&reach, &targets),
    );
    let sum = |found: &[super::Found]| found.iter().map(|f| f.asked).sum::<usize>();
    for (ours, theirs) in ours.iter().zip(&theirs) {
        assert!(theirs.distance < 0.05, "{theirs:?}");
        assert!(ours.distance <= theirs.distance + 1e-6);
    }
    assert!(
        sum(&ours) * 5 < sum(&theirs),
        "{} {}",
        sum(&ours),
        sum(&theirs)
    );
}

#[test]
fn bounds_axes_and_shapes_that_make_no_sense_are_refused() {
    let new = |low: Vec<f64>, high: Vec<f64>, axes| Reach::new(Arc::new(Arc3), low, high, axes);
    assert!(new(vec![1.0; 2], vec![0.0; 2], ALL).is_err());
    assert!(new(vec![f64::NAN; 2], vec![0.0; 2], ALL).is_err());
    assert!(new(vec![0.0; 3], vec![1.0; 3], ALL).is_err());
    assert!(new(vec![-1.0; 2], vec![1.0; 2], [false; 3]).is_err());
}

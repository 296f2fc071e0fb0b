//! Inverse kinematics by the method of the paper, for comparison.
//!
//! A coarse grid for the first waypoint only, then Nelder–Mead (1965) and a short polish by Adam
//! (Kingma & Ba 2015) on the slopes of the model; every further waypoint starts at the end of the
//! previous one. The paper gives no numbers: those below are ours. Clamping keeps commands within
//! their bounds, as in the paper. Pinned by solve_tests.rs and tests/model/test_kinematics.py.

use super::solve::{Found, Reach};
use super::{Distance, PLACE};

/// Nodes of the coarse grid along each command, and their largest number.
const NODES: usize = 11;
const MOST: usize = 20_000;
/// Initial simplex of the first waypoint and of the others, as a share of the range.
const SIMPLEX: (f64, f64) = (0.1, 0.02);
/// Most rounds of Nelder–Mead, and the spread of distances (mm²) and of commands (mm) that ends it.
const ROUNDS: usize = 200;
const SPREAD: (f64, f64) = (1e-8, 1e-4);
/// Steps of Adam and their size, as a share of the range.
const STEPS: usize = 20;
const RATE: f64 = 1e-3;

/// The effective commands for each of `targets` (T, 3), in sequence.
pub fn path(reach: &Reach, targets: &[f64]) -> Vec<Found> {
    let mut found: Vec<Found> = vec![];
    for target in targets.chunks_exact(PLACE) {
        let target = &[target[0], target[1], target[2]];
        let mut tip = reach.tip();
        let (start, share) = match found.last() {
            Some(last) => (last.u.clone(), SIMPLEX.1),
            None => (coarse(reach, &mut tip, target), SIMPLEX.0),
        };
        let near = nelder_mead(reach, &mut tip, target, start, share);
        let (u, squared) = adam(reach, &mut tip, target, near);
        tip.at(&u, target);
        found.push(Found {
            u,
            place: tip.place,
            distance: squared.sqrt(),
            asked: tip.asked,
        });
    }
    found
}

fn clamped(reach: &Reach, mut u: Vec<f64>) -> Vec<f64> {
    let (low, high) = reach.bounds();
    for (u, (low, high)) in u.iter_mut().zip(low.iter().zip(high)) {
        *u = u.clamp(*low, *high);
    }
    u
}

fn coarse(reach: &Reach, tip: &mut Distance, target: &[f64; PLACE]) -> Vec<f64> {
    let (low, high) = reach.bounds();
    let channels = low.len();
    let mut nodes = NODES;
    while nodes > 2 && nodes.checked_pow(channels as u32).is_none_or(|n| n > MOST) {
        nodes -= 1;
    }
    let count = nodes
        .checked_pow(channels as u32)
        .map_or(MOST, |n| n.min(MOST));
    let at = |mut i: usize| -> Vec<f64> {
        let node = |c: usize| {
            let share = (i % nodes) as f64 / (nodes - 1) as f64;
            i /= nodes;
            low[c] + share * (high[c] - low[c])
        };
        (0..channels).map(node).collect()
    };
    let all = (0..count).map(at).map(|u| (tip.at(&u, target), u));
    let best = all.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(|| low.to_vec(), |(_, u)| u)
}

fn nelder_mead(
    reach: &Reach,
    tip: &mut Distance,
    target: &[f64; PLACE],
    start: Vec<f64>,
    share: f64,
) -> Vec<f64> {
    let (low, high) = reach.bounds();
    let channels = start.len();
    let mut corner = |u: Vec<f64>| {
        let u = clamped(reach, u);
        (tip.at(&u, target), u)
    };
    let mut simplex = vec![corner(start.clone())];
    for c in 0..channels {
        let (mut u, by) = (start.clone(), share * (high[c] - low[c]));
        u[c] += if u[c] + by > high[c] { -by } else { by };
        simplex.push(corner(u));
    }
    for _ in 0..ROUNDS {
        simplex.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (best, worst) = (&simplex[0], &simplex[channels]);
        let wide = (0..channels)
            .map(|c| (worst.1[c] - best.1[c]).abs())
            .fold(0.0, f64::max);
        if worst.0 - best.0 <= SPREAD.0 && wide <= SPREAD.1 {
            break;
        }
        let middle: Vec<f64> = (0..channels)
            .map(|c| simplex[..channels].iter().map(|s| s.1[c]).sum::<f64>() / channels as f64)
            .collect();
        let away = |by: f64| -> Vec<f64> {
            let pairs = middle.iter().zip(&worst.1);
            pairs.map(|(m, w)| m + by * (m - w)).collect()
        };
        let reflected = corner(away(1.0));
        let new = if reflected.0 < best.0 {
            let expanded = corner(away(2.0));
            Some(if expanded.0 < reflected.0 {
                expanded
            } else {
                reflected
            })
        } else if reflected.0 < simplex[channels - 1].0 {
            Some(reflected)
        } else {
            let outside = reflected.0 < worst.0;
            let contracted = corner(away(if outside { 0.5 } else { -0.5 }));
            (contracted.0 < worst.0.min(reflected.0)).then_some(contracted)
        };
        match new {
            Some(new) => simplex[channels] = new,
            None => {
                let best = simplex[0].1.clone();
                for old in &mut simplex[1..] {
                    let pairs = old.1.iter().zip(&best);
                    *old = corner(pairs.map(|(o, b)| b + 0.5 * (o - b)).collect());
                }
            }
        }
    }
    let best = simplex.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or(start, |(_, u)| u)
}

fn adam(
    reach: &Reach,
    tip: &mut Distance,
    target: &[f64; PLACE],
    start: Vec<f64>,
) -> (Vec<f64>, f64) {
    let (low, high) = reach.bounds();
    let channels = start.len();
    let (mut gradient, mut normal) = (vec![0.0; channels], vec![0.0; channels * channels]);
    let (mut mean, mut square) = (vec![0.0; channels], vec![0.0; channels]);
    let mut best = (start.clone(), tip.at(&start, target));
    let mut u = start;
    for step in 1..=STEPS as i32 {
        let now = tip.with_slopes(&u, target, &mut gradient, &mut normal);
        if now < best.1 {
            best = (u.clone(), now);
        }
        for c in 0..channels {
            mean[c] = 0.9 * mean[c] + 0.1 * gradient[c];
            square[c] = 0.999 * square[c] + 0.001 * gradient[c] * gradient[c];
            let (m, s) = (
                mean[c] / (1.0 - 0.9f64.powi(step)),
                square[c] / (1.0 - 0.999f64.powi(step)),
            );
            u[c] -= RATE * (high[c] - low[c]) * m / (s.sqrt() + 1e-12);
        }
        u = clamped(reach, u);
    }
    let last = tip.at(&u, target);
    if last < best.1 { (u, last) } else { best }
}

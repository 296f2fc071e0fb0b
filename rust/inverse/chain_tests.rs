//! Commands whose effective command is the target, for every channel effect of the library.

use super::{CLOSE, Inverse};
use crate::allocations::allocations;
use crate::effects::{Chain, Context, REGISTRY};

const DT: f64 = 0.01;
const CONTEXT: Context = Context {
    t: 0.0,
    dt: 0.0,
    gravity: [0.0, 0.0, 1.0],
    load: 0.0,
    temperature: f64::NAN,
    seen_for: 0.0,
};

fn chain(names: &[&str]) -> (Chain, Vec<f64>) {
    let names: Vec<String> = names.iter().map(|name| name.to_string()).collect();
    let chain = Chain::new(&names, 2).unwrap();
    let start = chain.parameters().iter().map(|(_, p)| p.start).collect();
    (chain, start)
}

fn inverse(names: &[&str]) -> Inverse {
    let (chain, params) = chain(names);
    Inverse::new(&chain, &params, vec![-8.0; 2], vec![8.0; 2], CONTEXT).unwrap()
}

/// A figure of eight, mm.
fn wanted(k: usize) -> [f64; 2] {
    let t = k as f64 * DT;
    [3.0 * (1.3 * t).sin(), 2.0 * (2.6 * t + 0.4).sin()]
}

/// Error of the effective command along the figure, in a second chain stepped in parallel.
fn worst(names: &[&str]) -> f64 {
    let mut inverse = inverse(names);
    let (chain, params) = chain(names);
    let mut state = chain.init(&params, &[0.0, 0.0]).unwrap();
    inverse.settle(&[0.0, 0.0]);
    let (mut command, mut worst) = ([0.0; 2], 0.0f64);
    for k in 1..1500 {
        inverse.command(&wanted(k), DT, &mut command);
        let context = Context {
            t: k as f64 * DT,
            dt: DT,
            ..CONTEXT
        };
        let mut acts = command;
        chain.step(&params, &mut acts, &mut state, &context);
        let passed = inverse.passed(&command, DT);
        assert!((0..2).all(|c| (passed[c] - acts[c]).abs() < 1e-9));
        // If the figure starts aside, the approach is not evaluated.
        let far = (0..2).map(|c| (acts[c] - wanted(k)[c]).abs());
        worst = if k > 20 {
            far.fold(worst, f64::max)
        } else {
            worst
        };
    }
    worst
}

#[test]
fn every_channel_effect_is_inverted_alone() {
    let channel =
        |e: &&&crate::effects::Effect| e.law.role() == "channel" && e.declaration.family != "delay";
    let mut tried = 0;
    for effect in REGISTRY.iter().filter(channel) {
        let name = effect.declaration.name;
        let worst = worst(&[name]);
        // The parts removed by a dead zone or a saturation are not reachable.
        let allowed = if name == "saturation" {
            3.0
        } else {
            2.0 * CLOSE
        };
        assert!(worst <= allowed, "{name}: {worst} mm");
        tried += 1;
    }
    assert!(tried >= 15, "{tried}");
}

#[test]
fn effects_together_are_inverted_too() {
    let all = [
        "servo_swap",
        "gain",
        "offset",
        "backlash",
        "coupling",
        "hysteresis",
        "creep",
        "asymmetry",
    ];
    let worst = worst(&all);
    assert!(worst <= 4.0 * CLOSE, "{worst} mm");
}

#[test]
fn without_compensation_the_same_effects_are_far_off() {
    // Shows that the tests above can fail.
    for name in ["backlash", "hysteresis", "creep", "gain"] {
        let (chain, params) = chain(&[name]);
        let mut state = chain.init(&params, &[0.0, 0.0]).unwrap();
        let worst = (1..1500).fold(0.0f64, |worst, k| {
            let mut acts = wanted(k);
            let context = Context {
                t: k as f64 * DT,
                dt: DT,
                ..CONTEXT
            };
            chain.step(&params, &mut acts, &mut state, &context);
            worst.max((acts[0] - wanted(k)[0]).abs())
        });
        assert!(worst > 1000.0 * CLOSE, "{name}: {worst}");
    }
}

#[test]
fn inside_a_play_nothing_moves_and_a_still_goal_stays_still() {
    let mut inverse = inverse(&["backlash"]);
    inverse.settle(&[0.0, 0.0]);
    let mut command = [0.0; 2];
    inverse.command(&[1.0, 0.0], DT, &mut command);
    let acts = inverse.passed(&command, DT)[0];
    assert!((command[0] - 1.2).abs() < 1e-4 && (acts - 1.0).abs() < 2.0 * CLOSE);
    // 10 nm of noise causes no move, and a target 0.01 mm back crosses the full play.
    let before = command;
    inverse.command(&[acts + 1e-5, 1e-5], DT, &mut command);
    assert_eq!(command, before);
    inverse.command(&[0.99, 0.0], DT, &mut command);
    assert!((command[0] - 0.79).abs() < 1e-4, "{command:?}");
}

#[test]
fn delays_are_left_out() {
    let mut inverse = inverse(&["latency", "lag", "rate_limit", "gain"]);
    let (_, params) = chain(&["gain"]);
    let mut command = [0.0; 2];
    assert!(inverse.command(&[1.0, -1.0], DT, &mut command) <= CLOSE);
    assert!((command[0] * params[0] - 1.0).abs() < 1e-3);
}

#[test]
fn what_lies_beyond_the_bounds_ends_at_them_and_says_by_how_much() {
    let mut inverse = inverse(&["backlash"]);
    let mut command = [0.0; 2];
    let missed = inverse.command(&[9.0, 0.0], DT, &mut command);
    assert!(
        command[0] == 8.0 && (missed - 1.2).abs() < 1e-9,
        "{command:?} {missed}"
    );
}

#[test]
fn nothing_is_allocated() {
    let all = [
        "servo_swap",
        "gain",
        "offset",
        "backlash",
        "coupling",
        "hysteresis",
        "creep",
        "mullins",
        "friction",
    ];
    let mut inverse = inverse(&all);
    let mut command = [0.0; 2];
    inverse.settle(&[0.0, 0.0]);
    let asked = allocations(|| {
        for k in 0..50 {
            inverse.command(&wanted(k), DT, &mut command);
            inverse.passed(&command, DT);
        }
    });
    assert_eq!(asked, 0);
}

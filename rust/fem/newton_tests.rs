//! Equilibria against what is known of them: patch test, beam theory, symmetry, work of the cables, refinement.

use super::*;
use crate::fem::brick::Material;
use crate::fem::cable::{Averaging, Route};
use crate::fem::mesh::{self, Resolution};
use crate::fem::solid::Design;
use crate::fem::{norm, sub};
use std::f64::consts::FRAC_PI_2;

pub(super) fn design(core: usize, layers: usize) -> Design {
    let route = |k: usize| Route {
        angle: k as f64 * FRAC_PI_2,
        path: vec![[0.0, 8.0], [55.0, 5.5]],
    };
    Design {
        profile: vec![[0.0, 12.0], [60.0, 9.0]],
        resolution: Resolution {
            core,
            rings: 1,
            layers,
        },
        young: 0.3,
        poisson: 0.46,
        density: 1070.0,
        cable_stiffness: 20.0,
        averaging: Averaging {
            ring: 1.5,
            disc: 2.0,
        },
        routes: (0..4).map(route).collect(),
    }
}

fn reach(solid: &Solid, shortening: &[f64], gravity: Vec3, tip: Vec3) -> State {
    let mut solver = Solver::new(solid).unwrap();
    let mut state = solver.home(gravity, tip).unwrap();
    let goal = Load {
        shortening: shortening.to_vec(),
        gravity,
        tip,
    };
    solver.advance(&mut state, &goal).unwrap();
    state
}

fn block(cells: [usize; 3], size: Vec3, young: f64, poisson: f64) -> Solid {
    Solid::new(
        mesh::block(cells, size),
        Vec::new(),
        Material::new(young, poisson).unwrap(),
        1000.0,
    )
    .unwrap()
}

#[test]
fn patch_test_a_linear_field_is_in_balance_inside_distorted_bricks() {
    let mut mesh = mesh::block([3, 3, 3], [3.0, 4.0, 5.0]);
    let inner: Vec<usize> = (0..64)
        .filter(|&n| {
            (0..3).all(|i| mesh.nodes[n][i] > 0.1 && mesh.nodes[n][i] < [2.9, 3.9, 4.9][i])
        })
        .collect();
    for &n in &inner {
        for i in 0..3 {
            mesh.nodes[n][i] += 0.3 * ((7 * n + 3 * i) as f64).sin();
        }
    }
    assert_eq!(inner.len(), 8);
    let solid = Solid::new(mesh, Vec::new(), Material::new(0.5, 0.45).unwrap(), 0.0).unwrap();
    let x: Vec<Vec3> = solid
        .mesh
        .nodes
        .iter()
        .map(|p| {
            [
                1.2 * p[0] + 0.3 * p[1],
                0.9 * p[1] - 0.2 * p[2],
                1.1 * p[2] + 0.1 * p[0],
            ]
        })
        .collect();
    let mut work = Work::new(&solid).unwrap();
    work.assemble(
        &x,
        &Load {
            shortening: vec![],
            gravity: [0.0; 3],
            tip: [0.0; 3],
        },
    );
    let (held, force) = (solid.mesh.per_layer, |n: usize, i: usize| {
        work.residual[3 * n + i].abs()
    });
    let inside = inner
        .iter()
        .flat_map(|&n| (0..3).map(move |i| (n - held, i)))
        .map(|(n, i)| force(n, i));
    let largest = work.residual.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
    // Inside, forces cancel to round-off; on the surface they are tractions.
    assert!(inside.fold(0.0, f64::max) < 1e-13 && largest > 1e-2);
}

#[test]
fn tangent_of_the_whole_solid_agrees_with_finite_differences_and_woodbury_with_it() {
    let solid = Solid::finger(&design(2, 6)).unwrap();
    let state = reach(
        &solid,
        &[4.0, 1.0, -4.0, -1.0],
        [0.3, 0.0, 1.0],
        [0.0, 0.05, 0.0],
    );
    let mut work = Work::new(&solid).unwrap();
    work.assemble(&state.x, &state.load);
    assert!(
        work.refactor() && !work.taut.is_empty(),
        "taut {}",
        work.taut.len()
    );
    assert_eq!(work.shift, 0.0);
    let direction: Vec<f64> = (0..solid.unknowns())
        .map(|i| (0.7 * i as f64).sin())
        .collect();
    let product = work.multiply(&direction);
    let gradient = |h: f64| {
        let mut other = Work::new(&solid).unwrap();
        other.assemble(&solid.displace(&state.x, &direction, h), &state.load);
        other.residual
    };
    let (up, down) = (gradient(1e-5), gradient(-1e-5));
    for i in 0..product.len() {
        assert!((product[i] - (up[i] - down[i]) / 2e-5).abs() < 1e-6 * (1.0 + product[i].abs()));
    }
    for (p, q) in direction.iter().zip(work.solve(product)) {
        assert!((p - q).abs() < 1e-8);
    }
}

#[test]
fn cantilever_sags_as_beam_theory_says_and_converges_with_order_two() {
    let (length, side, young, g) = (60.0, 10.0, 0.5, 1e-3);
    let sag = |n: usize, poisson: f64| {
        let solid = block([n, n, 5 * n], [side, side, length], young, poisson);
        let state = reach(&solid, &[], [g, 0.0, 0.0], [0.0; 3]);
        let last = state.x.len() - solid.mesh.per_layer;
        let tip = &state.x[last..];
        tip.iter()
            .zip(&solid.mesh.nodes[last..])
            .map(|(p, q)| p[0] - q[0])
            .sum::<f64>()
            / tip.len() as f64
    };
    let beam = |poisson: f64| {
        let line_load = 1000.0 * 1e-9 * 9.80665 * g * side * side;
        let bending = line_load * length.powi(4) / (8.0 * young * side.powi(4) / 12.0);
        let shear_modulus = young / (2.0 * (1.0 + poisson));
        // Shear coefficient of a square, Cowper (1966): 10 (1 + ν) / (12 + 11 ν).
        let coefficient = 10.0 * (1.0 + poisson) / (12.0 + 11.0 * poisson);
        bending + line_load * length.powi(2) / (2.0 * coefficient * shear_modulus * side * side)
    };
    // With ν near 0 the clamp does not restrain the section, which is what a beam assumes.
    let sags = [sag(2, 0.02), sag(4, 0.02), sag(8, 0.02)];
    let limit = sags[2] + (sags[2] - sags[1]) / 3.0;
    let order = ((sags[1] - sags[0]) / (sags[2] - sags[1])).log2();
    assert!(
        (limit / beam(0.02) - 1.0).abs() < 0.005,
        "{sags:?} {limit} {}",
        beam(0.02)
    );
    assert!((order - 2.0).abs() < 0.25, "order {order}, {sags:?}");
    // Nearly incompressible: stiffer by the clamp's restraint (3 %) and coarse cells, but not locked (30 % and more).
    let ratio = sag(4, 0.48) / beam(0.48);
    assert!(ratio > 0.92 && ratio < 1.0, "{ratio}");
}

#[test]
fn a_quarter_turn_of_the_command_turns_the_shape() {
    let solid = Solid::finger(&design(3, 12)).unwrap();
    let one = reach(&solid, &[6.0, 3.0, -6.0, -3.0], [0.5, 0.0, 1.0], [0.0; 3]);
    let two = reach(&solid, &[-3.0, 6.0, 3.0, -6.0], [0.0, 0.5, 1.0], [0.0; 3]);
    assert!(
        norm(sub(
            one.x[one.x.len() - 1],
            solid.mesh.nodes[one.x.len() - 1]
        )) > 10.0
    );
    for (n, p) in solid.mesh.nodes.iter().enumerate() {
        let turned = |v: Vec3| [-v[1], v[0], v[2]];
        let image = solid
            .mesh
            .nodes
            .iter()
            .position(|q| norm(sub(*q, turned(*p))) < 1e-9)
            .unwrap();
        assert!(norm(sub(turned(one.x[n]), two.x[image])) < 1e-5);
    }
}

#[test]
fn a_slack_cable_is_no_cable() {
    let mut alone = design(2, 8);
    alone.routes.truncate(1);
    let (four, one) = (
        Solid::finger(&design(2, 8)).unwrap(),
        Solid::finger(&alone).unwrap(),
    );
    let gravity = [0.0, 0.0, -0.2]; // standing: gravity slackens too
    let all = reach(&four, &[6.0, -4.0, -6.0, -4.0], gravity, [0.0; 3]);
    let single = reach(&one, &[6.0], gravity, [0.0; 3]);
    let tension: Vec<f64> = four
        .cables
        .iter()
        .zip(&all.load.shortening)
        .map(|(c, &d)| c.tension(&all.x, d))
        .collect();
    assert!(
        tension[0] > 1.0 && tension[1..] == [0.0, 0.0, 0.0],
        "{tension:?}"
    );
    assert!(
        all.x
            .iter()
            .zip(&single.x)
            .all(|(p, q)| norm(sub(*p, *q)) < 1e-5)
    );
}

#[test]
fn the_cable_s_work_is_the_energy_gained_over_a_stroke() {
    let solid = Solid::finger(&design(2, 8)).unwrap();
    let gravity = [0.4, 0.1, 0.0];
    let mut solver = Solver::new(&solid).unwrap();
    let mut state = solver.home(gravity, [0.0; 3]).unwrap();
    let (steps, stroke) = (40, 10.0);
    let mut pulls = Vec::new();
    let start = 2.0; // taut from here on, so that the tension is smooth and Simpson's rule exact to 1e-5
    let mut energies = Vec::new();
    for k in 0..=steps {
        let d = start + (stroke - start) * k as f64 / steps as f64;
        let goal = Load {
            shortening: vec![d, -d, -d, -d],
            gravity,
            tip: [0.0; 3],
        };
        solver.advance(&mut state, &goal).unwrap();
        pulls.push(solver.pulls(&state)[0]);
        energies.push(solid.energy(&state.x, &goal));
    }
    let weight = |k: usize| {
        if k == 0 || k == steps {
            1.0
        } else {
            2.0 + 2.0 * (k % 2) as f64
        }
    };
    let h = (stroke - start) / steps as f64;
    let work: f64 = (0..=steps).map(|k| weight(k) * pulls[k]).sum::<f64>() * h / 3.0;
    let gained = energies[steps] - energies[0];
    assert!(
        gained > 5.0 && (work / gained - 1.0).abs() < 1e-5,
        "{work} {gained}"
    );
}

#[test]
fn large_steps_and_small_steps_end_at_the_same_equilibrium() {
    let solid = Solid::finger(&design(2, 8)).unwrap();
    let goal = Load {
        shortening: vec![8.0, 5.0, -8.0, -5.0],
        gravity: [0.0, 0.0, 1.0],
        tip: [0.0; 3],
    };
    let far = reach(&solid, &goal.shortening, goal.gravity, goal.tip);
    let mut solver = Solver::new(&solid).unwrap();
    let mut near = solver.home(goal.gravity, goal.tip).unwrap();
    for k in 1..=40 {
        let part = between(&near.load, &goal, 1.0 / f64::from(41 - k));
        solver.advance(&mut near, &part).unwrap();
    }
    assert!(
        far.x
            .iter()
            .zip(&near.x)
            .all(|(p, q)| norm(sub(*p, *q)) < 1e-5)
    );
}

#[test]
fn an_impossible_command_says_where_and_what_to_try() {
    let solid = Solid::finger(&design(1, 6)).unwrap();
    let mut solver = Solver::new(&solid).unwrap();
    let mut state = solver.home([0.0; 3], [0.0; 3]).unwrap();
    let goal = Load {
        shortening: vec![0.0; 4],
        gravity: [0.0; 3],
        tip: [0.0, 0.0, -1e6],
    };
    let error = solver.advance(&mut state, &goal).unwrap_err();
    let text = error.to_string();
    assert!(
        matches!(error, Error::NoEquilibrium(_))
            && text.contains("out of balance")
            && text.contains("try")
    );
}

#[test]
#[ignore = "long proof"]
fn the_finger_converges_under_refinement() {
    let tip = |core: usize, layers: usize| {
        let solid = Solid::finger(&design(core, layers)).unwrap();
        let state = reach(&solid, &[8.0, 0.0, -8.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
        let last = state.x.len() - solid.mesh.per_layer;
        state.x[last..].iter().map(|p| p[0]).sum::<f64>() / solid.mesh.per_layer as f64
    };
    let tips = [tip(3, 18), tip(4, 24), tip(6, 36)];
    // Cables that cut in deeper on finer meshes would lose 3 mm here; what is left is discretisation.
    assert!(
        tips[0] > 15.0 && (tips[2] - tips[0]).abs() < 0.3,
        "{tips:?}"
    );
    assert!(
        (tips[2] - tips[1]).abs() < (tips[1] - tips[0]).abs(),
        "{tips:?}"
    );
}

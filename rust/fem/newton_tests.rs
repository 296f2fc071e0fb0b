//! Equilibria against references: patch test, beam theory, symmetry, work of the cables,
//! refinement.

use super::*;
use crate::fem::guide::Averaging;
use crate::fem::material::Body;
use crate::fem::mesh::{self, Resolution};
use crate::fem::route::Route;
use crate::fem::solid::Design;
use crate::fem::tetrahedra::{tests::cut_block, tetrahedra};
use std::f64::consts::FRAC_PI_2;

pub(in crate::fem) fn design(core: usize, layers: usize) -> Design {
    let route = |k: usize| Route::Formula {
        angle: k as f64 * FRAC_PI_2,
        turn: 0.0,
        path: vec![[0.0, 8.0], [55.0, 5.5]],
    };
    let resolution = Resolution {
        core,
        rings: 1,
        layers,
    };
    Design {
        mesh: mesh::finger(&[[0.0, 12.0], [60.0, 9.0]], &[55.0], resolution).unwrap(),
        body: Body::uniform(0.3, 0.46, 1070.0).unwrap(),
        cable_stiffness: 20.0,
        pretension: 0.0,
        load_at: None,
        averaging: Averaging {
            ring: 1.5,
            disc: 2.0,
        },
        routes: (0..4).map(route).collect(),
        drive: Drive::Shortening,
        change: Default::default(),
    }
}

pub(super) fn reach(solid: &Solid, shortening: &[f64], gravity: Vec3, tip: Vec3) -> State {
    let mut solver = Solver::new(solid).unwrap();
    let mut state = solver.home(gravity, tip).unwrap();
    let goal = Load {
        cables: shortening.to_vec(),
        gravity,
        tip,
    };
    solver.advance(&mut state, &goal).unwrap();
    state
}

#[test]
fn patch_test_a_linear_field_is_in_balance_inside_distorted_cells() {
    let size = Vec3::new(3.0, 4.0, 5.0);
    let inner = |p: &Vec3| p[0].abs() < 1.4 && p[1].abs() < 1.9 && (0.1..4.9).contains(&p[2]);
    let distort = |nodes: &mut [Vec3]| {
        for (n, p) in nodes.iter_mut().enumerate().filter(|(_, p)| inner(p)) {
            (0..3).for_each(|i| p[i] += 0.2 * ((7 * n + 3 * i) as f64).sin());
        }
    };
    let mut bricks = mesh::block([3, 3, 3], size).unwrap();
    distort(&mut bricks.nodes);
    let (mut nodes, cells) = cut_block([3, 3, 3], size);
    distort(&mut nodes);
    for mesh in [bricks, tetrahedra(nodes, &cells, 0).unwrap()] {
        let solid = Solid::new(mesh, Vec::new(), &Body::uniform(0.5, 0.45, 0.0).unwrap()).unwrap();
        let field = |p: &Vec3| {
            Vec3::new(
                1.2 * p[0] + 0.3 * p[1],
                0.9 * p[1] - 0.2 * p[2],
                1.1 * p[2] + 0.1 * p[0],
            )
        };
        let x: Vec<Vec3> = solid.mesh.nodes.iter().map(field).collect();
        let mut work = Work::new(&solid).unwrap();
        let still = Load {
            cables: vec![],
            gravity: Vec3::ZERO,
            tip: Vec3::ZERO,
        };
        work.assemble(&x, &still);
        let nodes = solid.mesh.nodes.iter().zip(&solid.free);
        let held = crate::fem::solid::HELD;
        let inside: Vec<usize> = nodes
            .filter(|(p, f)| inner(p) && **f != held)
            .map(|(_, f)| *f)
            .collect();
        let largest = |r: &[f64]| r.iter().fold(0.0, |m: f64, r| m.max(r.abs()));
        let out_of_balance = inside
            .iter()
            .map(|f| largest(&work.residual[3 * f..3 * f + 3]))
            .fold(0.0, f64::max);
        // Inside, forces cancel to round-off; on the surface they are tractions.
        assert!(inside.len() >= 8 && out_of_balance < 1e-13 && largest(&work.residual) > 1e-2);
    }
}

#[test]
fn tangent_of_the_full_solid_agrees_with_finite_differences_and_woodbury_with_it() {
    let solid = Solid::build(design(2, 6)).unwrap();
    let state = reach(
        &solid,
        &[4.0, 1.0, -4.0, -1.0],
        Vec3::new(0.3, 0.0, 1.0),
        Vec3::new(0.0, 0.05, 0.0),
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
fn a_tension_does_what_the_shortening_with_that_tension_does() {
    let by_shortening = Solid::build(design(2, 8)).unwrap();
    let mut other = design(2, 8);
    other.drive = Drive::Tension;
    let by_tension = Solid::build(other).unwrap();
    let gravity = Vec3::new(0.2, 0.0, 1.0);
    let mut solver = Solver::new(&by_shortening).unwrap();
    let mut state = solver.home(gravity, Vec3::ZERO).unwrap();
    let mut goal = state.load.clone();
    goal.cables = vec![7.0, 5.0, -7.0, -5.0];
    solver.advance(&mut state, &goal).unwrap();
    let pulls = solver.pulls(&state);
    assert!(
        pulls[0] > 2.0 && pulls[1] > 1.0 && pulls[2] < 0.0,
        "{pulls:?}"
    );
    let same = reach(&by_tension, &pulls, gravity, Vec3::ZERO);
    let apart = |(p, q): (&Vec3, &Vec3)| p.distance(*q);
    assert!(same.x.iter().zip(&state.x).map(apart).fold(0.0, f64::max) < 1e-4);
}

#[test]
fn a_quarter_turn_of_the_command_turns_the_shape() {
    let solid = Solid::build(design(3, 12)).unwrap();
    let one = reach(
        &solid,
        &[6.0, 3.0, -6.0, -3.0],
        Vec3::new(0.5, 0.0, 1.0),
        Vec3::ZERO,
    );
    let two = reach(
        &solid,
        &[-3.0, 6.0, 3.0, -6.0],
        Vec3::new(0.0, 0.5, 1.0),
        Vec3::ZERO,
    );
    assert!(one.x[one.x.len() - 1].distance(solid.mesh.nodes[one.x.len() - 1]) > 10.0);
    for (n, p) in solid.mesh.nodes.iter().enumerate() {
        let turned = |v: Vec3| Vec3::new(-v[1], v[0], v[2]);
        let image = solid
            .mesh
            .nodes
            .iter()
            .position(|q| q.distance(turned(*p)) < 1e-9)
            .unwrap();
        assert!(turned(one.x[n]).distance(two.x[image]) < 1e-5);
    }
}

#[test]
fn a_slack_cable_is_no_cable() {
    let mut alone = design(2, 8);
    alone.routes.truncate(1);
    let (four, one) = (
        Solid::build(design(2, 8)).unwrap(),
        Solid::build(alone).unwrap(),
    );
    let gravity = Vec3::new(0.0, 0.0, -0.2); // upright: gravity also makes the cables slack
    let all = reach(&four, &[6.0, -4.0, -6.0, -4.0], gravity, Vec3::ZERO);
    let single = reach(&one, &[6.0], gravity, Vec3::ZERO);
    let tension: Vec<f64> = four
        .cables
        .iter()
        .zip(&all.load.cables)
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
            .all(|(p, q)| p.distance(*q) < 1e-5)
    );
}

#[test]
fn the_cable_s_work_is_the_energy_gained_over_a_stroke() {
    let solid = Solid::build(design(2, 8)).unwrap();
    let gravity = Vec3::new(0.4, 0.1, 0.0);
    let mut solver = Solver::new(&solid).unwrap();
    let mut state = solver.home(gravity, Vec3::ZERO).unwrap();
    let (steps, stroke) = (40, 10.0);
    let mut pulls = Vec::new();
    // taut from here on, so the tension is smooth and Simpson's rule exact to 1e-5
    let start = 2.0;
    let mut energies = Vec::new();
    for k in 0..=steps {
        let d = start + (stroke - start) * k as f64 / steps as f64;
        let goal = Load {
            cables: vec![d, -d, -d, -d],
            gravity,
            tip: Vec3::ZERO,
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
    let solid = Solid::build(design(2, 8)).unwrap();
    let goal = Load {
        cables: vec![8.0, 5.0, -8.0, -5.0],
        gravity: Vec3::Z,
        tip: Vec3::ZERO,
    };
    let far = reach(&solid, &goal.cables, goal.gravity, goal.tip);
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
            .all(|(p, q)| p.distance(*q) < 1e-5)
    );
}

#[test]
fn an_impossible_command_says_where_and_what_to_try() {
    let solid = Solid::build(design(1, 6)).unwrap();
    let mut solver = Solver::new(&solid).unwrap();
    let mut state = solver.home(Vec3::ZERO, Vec3::ZERO).unwrap();
    let goal = Load {
        cables: vec![0.0; 4],
        gravity: Vec3::ZERO,
        tip: Vec3::new(0.0, 0.0, -1e6),
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
        let solid = Solid::build(design(core, layers)).unwrap();
        let state = reach(&solid, &[8.0, 0.0, -8.0, 0.0], Vec3::Z, Vec3::ZERO);
        let last = state.x.len() - solid.mesh.per_layer;
        state.x[last..].iter().map(|p| p[0]).sum::<f64>() / solid.mesh.per_layer as f64
    };
    let tips = [tip(3, 18), tip(4, 24), tip(6, 36)];
    // Cables that cut in deeper on finer meshes would lose 3 mm here; the rest is discretisation.
    assert!(
        tips[0] > 15.0 && (tips[2] - tips[0]).abs() < 0.3,
        "{tips:?}"
    );
    assert!(
        (tips[2] - tips[1]).abs() < (tips[1] - tips[0]).abs(),
        "{tips:?}"
    );
}

#[test]
fn a_load_acts_where_it_hangs() {
    // Force and moment of the shares are those of the position; farther out, it bends more.
    let size = Vec3::new(30.0, 30.0, 100.0);
    let at = |load_at: Option<Vec3>| {
        Solid::build(Design {
            mesh: mesh::block([3, 3, 40], size).unwrap(),
            body: Body::uniform(0.25, 0.45, 1070.0).unwrap(),
            cable_stiffness: 20.0,
            pretension: 0.0,
            load_at,
            averaging: Averaging {
                ring: 1.5,
                disc: 2.0,
            },
            routes: Vec::new(),
            drive: Drive::Shortening,
            change: Default::default(),
        })
    };
    let place = Vec3::new(4.0, -3.0, 103.0);
    let solid = at(Some(place)).unwrap();
    let load = Load {
        cables: Vec::new(),
        gravity: Vec3::ZERO,
        tip: Vec3::ONE,
    };
    let (mut force, mut first) = (0.0, Vec3::ZERO);
    for (n, &x) in solid.mesh.nodes.iter().enumerate() {
        let f = solid.dead_force(n, &load)[0];
        force += f;
        first += f * x;
    }
    assert!((force - 1.0).abs() < 1e-12);
    assert!(first.distance(place) < 1e-9);
    assert!(at(Some(Vec3::new(0.0, 0.0, 160.0))).is_err());
}

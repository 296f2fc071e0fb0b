//! Sweeps against paths, fields against solved loads, the same points on another mesh, stops and refusals.

use super::*;
use crate::fem::cable::{Averaging, Route};
use crate::fem::mesh::Resolution;
use crate::fem::norm;
use crate::fem::solid::Design;
use std::f64::consts::FRAC_PI_2;

fn small(core: usize, layers: usize, points: Option<&[Vec3]>) -> Simulation {
    let route = |k: usize| Route {
        angle: k as f64 * FRAC_PI_2,
        path: vec![[0.0, 8.0], [55.0, 5.5]],
    };
    let solid = Solid::finger(&Design {
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
    })
    .unwrap();
    let points = match points {
        None => Points::surface(&solid.mesh),
        Some(p) => Points::embedded(&solid.mesh, p, 1.0).unwrap(),
    };
    let drive = vec![
        vec![1.0, 0.0],
        vec![0.0, 1.0],
        vec![-1.0, 0.0],
        vec![0.0, -1.0],
    ];
    Simulation::new(solid, points, drive).unwrap()
}

fn largest(a: &[Vec3], b: &[Vec3]) -> f64 {
    a.iter()
        .zip(b)
        .fold(0.0, |m: f64, (p, q)| m.max(norm(sub(*p, *q))))
}

const HANGING: Vec3 = [0.0, 0.0, 1.0];

#[test]
fn sweep_is_in_c_order_and_agrees_with_the_path() {
    let s = small(2, 8, None);
    let axes = vec![vec![-5.0, 0.0, 4.0], vec![-6.0, -1.0, 3.0, 5.0]];
    let grid = s
        .sweep(&axes, HANGING, [0.0; 3], &Progress::default())
        .unwrap();
    let commands: Vec<Vec<f64>> = axes[0]
        .iter()
        .flat_map(|&a| axes[1].iter().map(move |&b| vec![a, b]))
        .collect();
    let path = s
        .path(
            &commands,
            &vec![HANGING; 12],
            [0.0; 3],
            &Progress::default(),
        )
        .unwrap();
    for (a, b) in grid.iter().zip(&path) {
        assert!(largest(&a.places, &b.places) < 1e-5);
        assert!(
            a.tension
                .iter()
                .zip(&b.tension)
                .all(|(p, q)| (p - q).abs() < 1e-4)
        );
    }
}

#[test]
fn fields_are_the_slopes_of_solved_loads() {
    let s = small(2, 8, None);
    // Both pairs pulled, so that no cable changes between slack and taut within the small loads.
    let command = vec![vec![5.0, -4.0]];
    let fields = s
        .fields(&command, HANGING, [0.0; 3], &Progress::default())
        .unwrap();
    for f in 0..6 {
        let solve = |sign: f64| {
            let (mut gravity, mut tip) = (HANGING, [0.0; 3]);
            if f < 3 {
                gravity[f] += sign * 1e-3
            } else {
                tip[f - 3] += sign * 1e-4
            }
            s.path(&command, &[gravity], tip, &Progress::default())
                .unwrap()
                .remove(0)
                .places
        };
        let scale = if f < 3 { 2e-3 } else { 2e-4 };
        let slope: Vec<Vec3> = solve(1.0)
            .iter()
            .zip(solve(-1.0))
            .map(|(p, q)| sub(*p, q).map(|v| v / scale))
            .collect();
        let size = slope.iter().fold(0.0, |m: f64, v| m.max(norm(*v)));
        assert!(
            largest(&slope, &fields[0][f]) < 2e-3 * size.max(0.05),
            "{}",
            FIELDS[f]
        );
    }
}

#[test]
fn another_mesh_reports_the_same_points() {
    let one = small(3, 16, None);
    let template: Vec<Vec3> = one
        .solid
        .mesh
        .surface
        .iter()
        .map(|&n| one.solid.mesh.nodes[n])
        .collect();
    let other = small(4, 14, Some(&template));
    let look = |s: &Simulation| {
        s.path(
            &[vec![6.0, 3.0]],
            &[HANGING],
            [0.0; 3],
            &Progress::default(),
        )
        .unwrap()
        .remove(0)
        .places
    };
    let (a, b) = (look(&one), look(&other));
    let moved = largest(&a, &template);
    // Two coarse meshes of one finger: they differ by their own errors, a few per cent of the motion.
    assert!(
        moved > 15.0 && largest(&a, &b) < 0.06 * moved,
        "{moved} {}",
        largest(&a, &b)
    );
}

#[test]
fn a_stop_interrupts_and_bad_requests_are_refused() {
    let s = small(1, 6, None);
    let stopped = Progress::default();
    stopped.stop.store(true, Ordering::Relaxed);
    let axes = vec![vec![0.0, 1.0], vec![0.0, 1.0]];
    assert!(matches!(
        s.sweep(&axes, HANGING, [0.0; 3], &stopped),
        Err(Error::Interrupted)
    ));
    let go = Progress::default();
    assert!(s.sweep(&axes[..1], HANGING, [0.0; 3], &go).is_err());
    assert!(
        s.sweep(&[vec![1.0, 0.0], vec![0.0]], HANGING, [0.0; 3], &go)
            .is_err()
    );
    assert!(s.path(&[vec![1.0]], &[HANGING], [0.0; 3], &go).is_err());
    assert!(
        s.path(&[vec![1.0, f64::NAN]], &[HANGING], [0.0; 3], &go)
            .is_err()
    );
    assert!(s.path(&[vec![1.0, 0.0]], &[], [0.0; 3], &go).is_err());
}

#[test]
fn short_tours_take_the_nearest_next() {
    let commands: Vec<Vec<f64>> = [3.0, -1.0, 1.0, 2.0].iter().map(|&u| vec![u]).collect();
    let stop = AtomicBool::new(false);
    assert_eq!(short_tour(&commands, &stop).unwrap(), vec![1, 2, 3, 0]);
}

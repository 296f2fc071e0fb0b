//! Equilibria without cables against beam theory, and elements against each other.

use super::tests::reach;
use crate::fem::Vec3;
use crate::fem::material::{Body, Region};
use crate::fem::mesh;
use crate::fem::newton::State;
use crate::fem::solid::Solid;
use crate::fem::tetrahedra::{tests::cut_block, tetrahedra};

fn block(cells: [usize; 3], size: Vec3, young: f64, poisson: f64) -> Solid {
    let body = Body::uniform(young, poisson, 1000.0).unwrap();
    Solid::new(mesh::block(cells, size).unwrap(), Vec::new(), &body).unwrap()
}

/// The same block of 10-node tetrahedra, six per brick.
fn cut(cells: [usize; 3], size: Vec3, young: f64, poisson: f64) -> Solid {
    let (nodes, cells) = cut_block(cells, size);
    let mesh = tetrahedra(nodes, &cells, 0).unwrap();
    Solid::new(
        mesh,
        Vec::new(),
        &Body::uniform(young, poisson, 1000.0).unwrap(),
    )
    .unwrap()
}

/// Mean lateral displacement of the end face.
fn end_moves(solid: &Solid, state: &State) -> f64 {
    let end: Vec<usize> = (0..state.x.len())
        .filter(|&n| solid.mesh.nodes[n][2] > solid.mesh.height - 1e-9)
        .collect();
    let moved = |n: &usize| state.x[*n][0] - solid.mesh.nodes[*n][0];
    end.iter().map(moved).sum::<f64>() / end.len() as f64
}

/// Sag under its own weight of a cantilever by Timoshenko's beam theory; length, side, modulus,
/// Poisson's ratio, g.
fn beam(length: f64, side: f64, young: f64, poisson: f64, g: f64) -> f64 {
    let line_load = 1000.0 * 1e-9 * 9.80665 * g * side * side;
    let bending = line_load * length.powi(4) / (8.0 * young * side.powi(4) / 12.0);
    let shear_modulus = young / (2.0 * (1.0 + poisson));
    // Shear coefficient of a square, Cowper (1966): 10 (1 + ν) / (12 + 11 ν).
    let coefficient = 10.0 * (1.0 + poisson) / (12.0 + 11.0 * poisson);
    bending + line_load * length.powi(2) / (2.0 * coefficient * shear_modulus * side * side)
}

/// A cantilever of bricks or tetrahedra sags as in theory, with the order of its elements; `stiff`
/// is the sag at Poisson's ratio 0.48 with two and four cells across, over the theory's.
fn check_cantilever(
    solid: fn([usize; 3], Vec3, f64, f64) -> Solid,
    cells: [usize; 3],
    orders: [f64; 2],
    stiff: [f64; 2],
) {
    let (length, side, young, g) = (60.0, 10.0, 0.5, 1e-3);
    let sag = |n: usize, poisson: f64| {
        let solid = solid([n, n, 5 * n], Vec3::new(side, side, length), young, poisson);
        end_moves(&solid, &reach(&solid, &[], g * Vec3::X, Vec3::ZERO))
    };
    // With ν near 0 the clamp does not restrain the section, as beam theory assumes.
    let sags = cells.map(|n| sag(n, 0.02));
    let order = ((sags[1] - sags[0]) / (sags[2] - sags[1])).log2();
    let limit = sags[2] + (sags[2] - sags[1]) / (order.exp2() - 1.0);
    let exact = beam(length, side, young, 0.02, g);
    assert!(
        (limit / exact - 1.0).abs() < 0.005,
        "{sags:?} {limit} {exact}"
    );
    assert!(
        orders[0] < order && order < orders[1],
        "order {order}, {sags:?}"
    );
    // Nearly incompressible: less by the clamp's restraint (some 4 %) and coarse cells, but not
    // locked (30 % and more).
    for (n, known) in [2, 4].into_iter().zip(stiff) {
        let ratio = sag(n, 0.48) / beam(length, side, young, 0.48, g);
        assert!((ratio - known).abs() < 0.005, "{n} cells: {ratio}");
    }
}

#[test]
fn cantilever_of_bricks_sags_as_beam_theory_says_with_order_two() {
    check_cantilever(block, [2, 4, 8], [1.75, 2.25], [0.888, 0.934]);
}

#[test]
fn cantilever_of_quadratic_tetrahedra_sags_as_beam_theory_says_with_order_three() {
    check_cantilever(cut, [1, 2, 4], [2.5, 3.5], [0.902, 0.943]);
}

#[test]
fn tetrahedra_and_bricks_agree_in_a_large_bend() {
    let solids = [
        block([6, 6, 24], Vec3::new(10.0, 10.0, 60.0), 0.3, 0.47),
        cut([3, 3, 12], Vec3::new(10.0, 10.0, 60.0), 0.3, 0.47),
    ];
    let [fine, coarse] = solids.map(|solid| {
        let state = reach(&solid, &[], Vec3::Z, 0.12 * Vec3::X);
        end_moves(&solid, &state)
    });
    // Half the length sideways; the rest is the error of the bricks, which falls with their size.
    assert!(
        fine > 20.0 && (coarse / fine - 1.0).abs() < 0.02,
        "{coarse} {fine}"
    );
}

#[test]
fn a_stiffer_region_and_a_stiffer_side_bend_as_beam_theory_says() {
    let (length, side, young, g) = (60.0, 6.0, 0.5, 2e-4);
    let far = f64::INFINITY;
    let sag = |region: Option<Region>, axis: usize| {
        let body = Body::new(young, 0.02, 1000.0, region.into_iter().collect()).unwrap();
        let mesh = mesh::block([4, 4, 30], Vec3::new(side, side, length)).unwrap();
        let solid = Solid::new(mesh, Vec::new(), &body).unwrap();
        let state = reach(&solid, &[], g * Vec3::AXES[axis], Vec3::ZERO);
        let end = solid.mesh.nodes.len() - 1;
        state.x[end][axis] - solid.mesh.nodes[end][axis]
    };
    let region = |high: f64, side: Option<f64>| {
        Some(Region {
            low: Vec3::splat(-far),
            high: Vec3::new(far, far, high),
            side,
            cells: None,
            young: 2.0 * young,
        })
    };
    let plain = sag(None, 0);
    // The half next to the clamp, 15/16 of the sag under a uniform load (1 − (L − a)⁴/L⁴), twice as
    // stiff.
    let stiffened = sag(region(0.5 * length, None), 0);
    assert!(
        (stiffened / plain - (1.0 - 0.5 * 15.0 / 16.0)).abs() < 0.01,
        "{}",
        stiffened / plain
    );
    // One half of the section twice as stiff: about its own neutral axis, at h/12 from the middle,
    // EI grows by 1.5 − 12·1.5·(1/12)² = 1.375 across the border; along it by 1.5.
    let across = sag(region(length, Some(0.0)), 0);
    let along = sag(region(length, Some(0.0)), 1);
    assert!((plain / across - 1.375).abs() < 0.02, "{}", plain / across);
    assert!((plain / along - 1.5).abs() < 0.02, "{}", plain / along);
}

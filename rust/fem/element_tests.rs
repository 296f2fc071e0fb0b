//! Elements: gradient and tangent by differences, rigid motion and uniform strain in closed form,
//! inverted cells.

use super::*;
use crate::fem::natural::EDGES;

/// Rest nodes of a skewed cell, and the same stretched, sheared and bent, so no symmetry hides a
/// wrong sign.
fn skewed(kind: Kind) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut rest = vec![
        Vec3::new(0.0, 0.1, 0.0),
        Vec3::new(2.0, 0.0, 0.2),
        Vec3::new(2.2, 1.9, 0.0),
        Vec3::new(0.1, 2.0, -0.1),
        Vec3::new(0.0, 0.0, 3.0),
        Vec3::new(2.1, 0.1, 2.9),
        Vec3::new(2.0, 2.1, 3.2),
        Vec3::new(-0.1, 1.8, 3.0),
    ];
    if kind == Kind::Tetrahedron {
        rest = vec![rest[0], rest[1], rest[2], rest[7]];
        for (e, [i, j]) in EDGES.into_iter().enumerate() {
            let mid = 0.5 * (rest[i] + rest[j]);
            rest.push(mid + 0.05 * (e as f64).sin() * Vec3::new(1.0, -0.5, 0.3));
        }
    }
    let x = rest.iter().map(|p| {
        Vec3::new(
            1.1 * p[0] + 0.3 * p[2] + 0.02 * p[2] * p[2],
            0.9 * p[1] - 0.2 * p[0] + 0.03 * p[0] * p[2],
            0.95 * p[2] + 0.1 * p[1] - 0.02 * p[1] * p[0],
        )
    });
    (rest.clone(), x.collect())
}

fn one(kind: Kind, rest: &[Vec3], young: f64, poisson: f64) -> Result<Box<dyn Element>> {
    let cell: Vec<usize> = (0..kind.nodes()).collect();
    let body = Body::uniform(young, poisson, 0.0).unwrap();
    Ok(elements(kind, [(0, &cell[..])].into_iter(), rest, &body)?.remove(0))
}

const KINDS: [Kind; 2] = [Kind::Brick, Kind::Tetrahedron];

#[test]
fn gradient_and_tangent_agree_with_finite_differences() {
    for kind in KINDS {
        let (rest, x) = skewed(kind);
        let element = one(kind, &rest, 0.6, 0.48).unwrap();
        let n = kind.nodes();
        let (mut force, mut k) = (vec![Vec3::ZERO; n], vec![[Vec3::ZERO; 3]; n * (n + 1) / 2]);
        let energy = element.tangent(&x, &mut force, &mut k);
        assert!((energy - element.energy(&x)).abs() < 1e-13 * energy);
        let h = 1e-5;
        for b in 0..n {
            for m in 0..3 {
                let moved = |s: f64| {
                    let mut y = x.clone();
                    y[b][m] += s * h;
                    y
                };
                let slope =
                    (element.energy(&moved(1.0)) - element.energy(&moved(-1.0))) / (2.0 * h);
                // Central differences of step 1e-5: truncation and round-off are both about 1e-9.
                assert!(
                    (slope - force[b][m]).abs() < 1e-8,
                    "{slope} {}",
                    force[b][m]
                );
                let (mut up, mut down, mut scrap) = (force.clone(), force.clone(), k.clone());
                element.tangent(&moved(1.0), &mut up, &mut scrap);
                element.tangent(&moved(-1.0), &mut down, &mut scrap);
                for a in b..n {
                    for i in 0..3 {
                        let numeric = (up[a][i] - down[a][i]) / (2.0 * h);
                        let said = k[a * (a + 1) / 2 + b][i][m];
                        assert!((numeric - said).abs() < 1e-8, "{kind:?} {a} {i} {b} {m}");
                    }
                }
            }
        }
    }
}

#[test]
fn rigid_motion_costs_nothing_and_uniform_strain_has_the_closed_form() {
    for kind in KINDS {
        let (rest, _) = skewed(kind);
        let element = one(kind, &rest, 0.3, 0.45).unwrap();
        let (c, s) = (0.8, 0.6);
        let turned = |p: &Vec3| {
            let (x, y) = (c * p[0] - s * p[1], s * p[0] + c * p[1]);
            Vec3::new(x + 5.0, y - 2.0, p[2] + 1.0)
        };
        let turned: Vec<Vec3> = rest.iter().map(turned).collect();
        assert!(element.energy(&turned).abs() < 1e-13);
        let stretch = Vec3::new(1.2, 0.9, 1.05);
        let x: Vec<Vec3> = rest.iter().map(|p| stretch * p).collect();
        let (j, first) = (stretch.element_product(), stretch.length_squared());
        let material = Body::uniform(0.3, 0.45, 0.0).unwrap().at(Vec3::ZERO, 0);
        let density = 0.5 * material.mu * (first * j.powf(-2.0 / 3.0) - 3.0)
            + 0.25 * material.kappa * (j * j - 1.0 - 2.0 * j.ln());
        let volume: f64 = element.share().iter().sum();
        assert!((element.energy(&x) - density * volume).abs() < 1e-12);
    }
}

#[test]
fn an_inverted_cell_is_refused_or_infinite() {
    for kind in KINDS {
        let (rest, x) = skewed(kind);
        let flipped: Vec<Vec3> = x.iter().map(|p| Vec3::new(-p[0], p[1], p[2])).collect();
        let element = one(kind, &rest, 0.3, 0.45).unwrap();
        assert_eq!(element.energy(&flipped), f64::INFINITY);
        assert!(one(kind, &flipped, 0.3, 0.45).is_err());
    }
}

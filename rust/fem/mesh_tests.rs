//! The mesh: stated counts, a closed surface of the right volume, symmetry, refused resolutions.

use super::*;

const CONE: [[f64; 2]; 3] = [[0.0, 16.0], [90.0, 10.0], [110.0, 4.0]];
const USUAL: Resolution = Resolution {
    core: 3,
    rings: 1,
    layers: 42,
};

fn volume_and_closed(mesh: &Mesh) -> (f64, Vec3) {
    let (mut volume, mut area) = (0.0, Vec3::ZERO);
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.nodes[mesh.surface[i]]);
        let (u, v) = (b - a, c - a);
        let n = u.cross(v);
        volume += a.dot(n) / 6.0;
        area += 0.5 * n;
    }
    (volume, area)
}

#[test]
fn usual_resolution_has_the_stated_counts() {
    let mesh = finger(&CONE, &[90.0], USUAL).unwrap();
    assert_eq!(
        (mesh.nodes.len(), mesh.cells.len() / 8, mesh.surface.len()),
        (1204, 882, 548)
    );
    assert_eq!(mesh.triangles.len(), 2 * (12 * 42 + 2 * 21));
    assert!(
        mesh.levels.iter().any(|z| (z - 90.0).abs() < 1e-12),
        "a tendon's end is a layer"
    );
}

#[test]
fn surface_is_closed_outward_and_has_the_cone_s_volume() {
    let exact: f64 = CONE
        .windows(2)
        .map(|w| {
            let (h, a, b) = (w[1][0] - w[0][0], w[0][1], w[1][1]);
            PI * h / 3.0 * (a * a + a * b + b * b)
        })
        .sum();
    for resolution in [
        USUAL,
        Resolution {
            core: 4,
            rings: 2,
            layers: 30,
        },
    ] {
        let (volume, area) = volume_and_closed(&finger(&CONE, &[90.0], resolution).unwrap());
        // Triangulated faces of a cone are flat to within the layer height: 0.1 % here.
        assert!((volume / exact - 1.0).abs() < 2e-3, "{volume} {exact}");
        assert!(area.abs().max_element() < 1e-9, "open surface: {area}");
    }
}

#[test]
fn quarter_turn_maps_the_mesh_onto_itself() {
    let mesh = finger(
        &CONE,
        &[],
        Resolution {
            core: 3,
            rings: 2,
            layers: 4,
        },
    )
    .unwrap();
    for p in &mesh.nodes {
        let turned = Vec3::new(-p[1], p[0], p[2]);
        assert!(mesh.nodes.iter().any(|q| q.abs_diff_eq(turned, 1e-12)));
    }
}

#[test]
fn bad_resolutions_and_profiles_are_refused() {
    assert!(
        finger(
            &CONE,
            &[90.0],
            Resolution {
                core: 0,
                rings: 1,
                layers: 42
            }
        )
        .is_err()
    );
    assert!(
        finger(
            &CONE,
            &[90.0],
            Resolution {
                core: 3,
                rings: 1,
                layers: 1
            }
        )
        .is_err()
    );
    let most = Resolution {
        core: 16,
        rings: 16,
        layers: 400,
    };
    let refused = finger(&CONE, &[90.0], most).unwrap_err().to_string();
    assert!(refused.contains("526513 nodes"), "{refused}");
    assert!(finger(&[[0.0, 10.0], [0.0, 9.0]], &[], USUAL).is_err());
    assert!(finger(&[[0.0, 10.0], [50.0, f64::NAN]], &[], USUAL).is_err());
}

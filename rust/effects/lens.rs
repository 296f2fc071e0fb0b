//! Lens: the cameras distort straight lines towards the image border; a measurement fault, not
//! physics of the robot.
//!
//! A camera with the pose [R | t] (base → camera, looking along its z) has p at `q = R·p + t`, in
//! its image at `n = (q_x, q_y)/q_z`, and measures `n·(1 + radial·|n|²)`. The measured point is
//! nearest to the rays of all cameras (least squares; with one camera, the point of its ray nearest
//! to the true one). Points behind a camera are not visible to it. Without camera poses in the run,
//! the effect is zero. One number for all cameras, on top of their calibration. Source: first
//! radial term of Brown's model. Limit: positions only, by section centroids; the size of a section
//! does not change.

use super::conditions::Context;
use super::declaration::*;
use crate::algebra::{Mat3, Vec3};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "lens",
        family: "sensor frame",
        stage: Stage::Sensing,
        kind: Kind::Fault,
        formula: "n → n · (1 + radial · |n|²) in each picture; p where the rays of all cameras \
            meet best",
        doc: "Radial distortion that the calibration of the cameras leaves: a changed focus, a \
            wide lens calibrated in its middle.",
        signature: "Static; nothing in the middle of the pictures, growing with the third power \
            towards their rim, at home too.",
        reference: "Brown, Decentering distortion of lenses, Photogrammetric Engineering 32 (1966) \
            444.",
        experiment: (
            "points over the full picture, and the poses of the cameras in the run",
            1.0,
        ),
        alike: &[],
        needs: &["cameras"],
        parameters: &[Parameter::new(
            "radial",
            "1",
            0.0,
            0.05,
            -0.4,
            0.4,
            "first radial term, left over by the calibration",
        )],
    },
    law: Law::Sensing(&Lens),
};

struct Lens;

/// Share of the identity that keeps the intersection of one ray, or of parallel ones, unique.
const UNIQUE: f64 = 1e-12;

impl SensingEffect for Lens {
    fn apply(
        &self,
        params: &[f64],
        positions: &[bool],
        points: &mut [f64],
        _context: &Context,
        cameras: &[Camera],
    ) {
        if params[0] == 0.0 || cameras.is_empty() {
            return;
        }
        for (p, place) in points.chunks_exact_mut(3).zip(positions) {
            if *place {
                let at = Vec3::from_slice(p);
                (at + seen_away(params[0], at, cameras)).write_to_slice(p);
            }
        }
    }
}

/// Displacement of the measured point, mm.
fn seen_away(radial: f64, p: Vec3, cameras: &[Camera]) -> Vec3 {
    let mut system = Mat3::from_diagonal(Vec3::splat(UNIQUE));
    let mut right = Vec3::ZERO;
    for pose in cameras {
        let [x, y, z] = pose.map(|row| Vec3::from_slice(&row));
        let q = Mat3::from_rows(x, y, z) * p + Vec3::from(pose.map(|row| row[3]));
        if q.z <= 0.0 {
            continue;
        }
        let seen = q / q.z;
        let bent = radial * (seen.x * seen.x + seen.y * seen.y);
        // From the camera to p, and the distorted ray, both in the base frame, at the depth of p.
        let offset = bent * (q.x * x + q.y * y);
        let ray = q.x * x + q.y * y + q.z * z + offset;
        let square = ray.length_squared();
        // The distance of p + shift from the ray: that of (shift − `offset`), since the ray goes
        // through p + `offset`.
        let across = |v: Vec3| v - v.dot(ray) / square * ray;
        let [along_x, along_y, along_z] = Vec3::AXES.map(across);
        system += Mat3::from_cols(along_x, along_y, along_z);
        right += across(offset);
    }
    system.inverse() * right
}

//! A body that differs from its description: modulus along and across, rest shape, and tendon
//! routing.
//!
//! One number for each field of a design (`loads.rs`, in its units) is the amount. A body's modulus
//! is multiplied by the exponential of them; body and tendons together are twisted about z,
//! uniformly over the height, then bent to an arc that starts upright at the base. A changed design
//! is either built and solved again, or its forces at the positions of a known equilibrium give the
//! field: with the residual r(x, p) and the tangent K at constant tension, dx/dp = −K⁻¹ ∂r/∂p, and
//! a cable stretches by b·dx/dp + ∂L/∂p, b = ∂L/∂x. Derivatives in p are central differences of two
//! such designs. Units: mm, N, rad inside, ° in a change.

use super::Vec3;
use super::cable::Cable;
use super::element::{Element, elements};
use super::material::Modulation;
use super::natural::MOST_NODES;
use super::solid::{Design, Solid};
use crate::error::Result;
use crate::response::loads::{ACROSS, CURVE, LOADS, PUSH, ROUTING, STIFF, TWIST};

/// The amount of each field of a design.
pub type Change = [f64; PUSH - LOADS];

/// Half the distance of the two designs of a central difference, in the units of the fields: 0.01
/// in a logarithm of the modulus, 0.05 mm and 0.05°. The third derivatives of all of them are of
/// the order of the first: 1e-4 of the field.
const LOGARITHM: f64 = 0.01;
const STEP: f64 = 0.05;

/// A design with `by` more of one field; None without such a command. `drive` maps commands to
/// tendons.
pub fn changed(design: &Design, drive: &[Vec<f64>], field: usize, by: f64) -> Option<Design> {
    let mut design = design.clone();
    if field >= ROUTING {
        let command = field - ROUTING;
        let mut found = false;
        for (route, row) in design.routes.iter_mut().zip(drive) {
            if row.get(command).is_some_and(|d| *d != 0.0) {
                *route = route.turned(by.to_radians());
                found = true;
            }
        }
        return found.then_some(design);
    }
    design.change[field - LOADS] += by;
    Some(design)
}

/// The changed modulus of a design before its shape changes.
pub(super) fn modulation(design: &Design, change: &Change) -> Modulation {
    let (nodes, change) = (&design.mesh.nodes, |field: usize| change[field - LOADS]);
    let far = |m: f64, p: &Vec3| m.max(p[0].abs()).max(p[1].abs());
    Modulation {
        hats: std::array::from_fn(|k| change(STIFF + k)),
        across: [change(ACROSS), change(ACROSS + 1)],
        height: design.mesh.height,
        reach: nodes.iter().fold(0.0, far),
    }
}

/// Bind the cables and move the rest positions of a design, which applies the changes. The design's
/// mesh and body are modified.
pub(super) fn bind(design: &mut Design) -> Result<Vec<Cable>> {
    let change = |field: usize| design.change[field - LOADS];
    let modulation = modulation(design, &design.change);
    let height = design.mesh.height;
    let (twist, curve) = (
        change(TWIST).to_radians(),
        [change(CURVE), change(CURVE + 1)],
    );
    if modulation
        .hats
        .iter()
        .chain(&modulation.across)
        .any(|c| *c != 0.0)
    {
        design.body = design.body.clone().modulated(modulation);
    }
    let route = |route| {
        Cable::new(
            &design.mesh,
            route,
            design.averaging,
            design.cable_stiffness,
            design.drive,
        )
    };
    let mut cables = design
        .routes
        .iter()
        .map(route)
        .collect::<Result<Vec<_>>>()?;
    if twist != 0.0 || curve != [0.0; 2] {
        let nodes = design.mesh.nodes.iter_mut();
        nodes.for_each(|p| *p = bent(twisted(*p, twist, height), curve, height));
    }
    for cable in &mut cables {
        cable.rest_length = cable.length(&design.mesh.nodes) - design.pretension;
    }
    Ok(cables)
}

/// A rest place of a body twisted by `twist` rad at its tip.
fn twisted(p: Vec3, twist: f64, height: f64) -> Vec3 {
    let (s, c) = (twist * (p[2] / height).clamp(0.0, 1.0)).sin_cos();
    Vec3::new(c * p[0] - s * p[1], s * p[0] + c * p[1], p[2])
}

/// A rest place of a body bent to an arc whose tip is `curve` mm aside (of a small angle): κ =
/// 2·curve/height².
fn bent(p: Vec3, curve: [f64; 2], height: f64) -> Vec3 {
    let size = curve[0].hypot(curve[1]);
    if p[2] <= 0.0 || size == 0.0 {
        return p;
    }
    let (curvature, side) = (2.0 * size / (height * height), curve.map(|c| c / size));
    let (sin, cos) = (curvature * p[2]).sin_cos();
    let out = side[0] * p[0] + side[1] * p[1];
    // The middle line is at (1 − cos)/κ, sin/κ; other points turn with their section.
    let half = (0.5 * curvature * p[2]).sin();
    let aside = 2.0 * half * half / curvature + (cos - 1.0) * out;
    Vec3::new(
        p[0] + side[0] * aside,
        p[1] + side[1] * aside,
        sin / curvature - sin * out,
    )
}

/// The parts of a changed design with forces at positions other than its own equilibrium.
struct Changed {
    elements: Vec<Box<dyn Element>>,
    cables: Vec<Cable>,
}

impl Changed {
    fn new(mut design: Design) -> Result<Changed> {
        let cables = bind(&mut design)?;
        let mesh = &design.mesh;
        let cells = mesh.each_cell().enumerate();
        let mut elements = elements(mesh.kind, cells, &mesh.nodes, &design.body)?;
        elements.retain(|e| e.nodes().iter().any(|&n| !mesh.clamped[n]));
        Ok(Changed { elements, cables })
    }

    fn add(
        &self,
        x: &[Vec3],
        tension: &[f64],
        share: f64,
        force: &mut [Vec3],
        stretch: &mut [f64],
    ) {
        let parts = (&self.elements[..], &self.cables[..]);
        add_parts(parts, x, tension, share, force, stretch);
    }
}

/// Add `share` × the forces of elements and cables on the places `x` to `force`, and × the stretch
/// of the cables to `stretch`.
pub(super) fn add_parts(
    (elements, cables): (&[Box<dyn Element>], &[Cable]),
    x: &[Vec3],
    tension: &[f64],
    share: f64,
    force: &mut [Vec3],
    stretch: &mut [f64],
) {
    let mut own = [Vec3::ZERO; MOST_NODES];
    for element in elements {
        own.fill(Vec3::ZERO);
        element.force(x, &mut own);
        for (&n, f) in element.nodes().iter().zip(own) {
            force[n] += share * f;
        }
    }
    for ((cable, tension), stretch) in cables.iter().zip(tension).zip(stretch) {
        *stretch += share * (cable.length(x) - cable.rest_length);
        if *tension != 0.0 {
            cable.slope(x, |n, b| force[n] += share * tension * b);
        }
    }
}

/// The fields of one solid's changes of design: two designs for each.
pub(super) struct Changes {
    pairs: Vec<(usize, f64, [Changed; 2])>,
}

impl Changes {
    /// All fields of the solid's design; a change that cannot be built (a tendon outside the solid)
    /// has none.
    pub fn new(solid: &Solid, drive: &[Vec<f64>]) -> Changes {
        let pair = |field: usize| {
            let design = solid.design.as_deref()?;
            let step = if field < CURVE { LOGARITHM } else { STEP };
            let side = |by: f64| Changed::new(changed(design, drive, field, by)?).ok();
            Some((field, step, [side(step)?, side(-step)?]))
        };
        Changes {
            pairs: (LOADS..PUSH).filter_map(pair).collect(),
        }
    }

    /// For each existing field: its number, the forces −∂r/∂p on the unknowns and the stretch ∂L/∂p
    /// of each cable at places `x` with tensions `tension`, per unit.
    pub fn at<'a>(
        &'a self,
        solid: &'a Solid,
        x: &'a [Vec3],
        tension: &'a [f64],
    ) -> impl Iterator<Item = (usize, Vec<f64>, Vec<f64>)> + 'a {
        self.pairs.iter().map(move |(field, step, [up, down])| {
            let (mut force, mut stretch) = (vec![Vec3::ZERO; x.len()], vec![0.0; tension.len()]);
            up.add(x, tension, -0.5 / step, &mut force, &mut stretch);
            down.add(x, tension, 0.5 / step, &mut force, &mut stretch);
            (
                *field,
                solid.gathered(force),
                stretch.iter().map(|s| -s).collect(),
            )
        })
    }
}

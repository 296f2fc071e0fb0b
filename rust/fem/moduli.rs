//! First and second derivatives of a body's element forces by its modulus: `stiff_0 … stiff_6`,
//! `stiff_x|y`.
//!
//! Forces are linear in the modulus E = E₀ exp Σ p_i m_i(X). So ∂r/∂p_i at the same positions are
//! the forces of a body of modulus E m_i, and ∂²r/∂p_i∂p_j those of E m_i m_j: exact, from separate
//! elements where that is not zero. N.

use super::Vec3;
use super::change::{Change, add_parts, bind, modulation};
use super::element::{Element, elements};
use super::material::Body;
use super::solid::{Design, Solid};
use crate::error::Result;
use crate::response::loads::{LOADS, MODULI, STIFF};

type Elements = Vec<Box<dyn Element>>;

/// The elements whose forces are the derivatives.
pub(super) struct Moduli {
    first: Vec<Elements>,
    /// Pairs i ≤ j, row by row.
    second: Vec<Elements>,
}

impl Moduli {
    /// All of them; none for a solid without a design.
    pub fn new(solid: &Solid) -> Result<Moduli> {
        let (mut first, mut second) = (vec![], vec![]);
        if let Some(design) = solid.design.as_deref() {
            let mut made = design.clone();
            bind(&mut made)?;
            for i in 0..MODULI {
                let one = sloped(design, made.body.clone(), i);
                first.push(answering(&made, &one)?);
                for j in i..MODULI {
                    second.push(answering(&made, &sloped(design, one.clone(), j))?);
                }
            }
        }
        Ok(Moduli { first, second })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.first.len()
    }

    /// ∂r/∂p_i on the unknowns at places `x`.
    pub fn first(&self, solid: &Solid, i: usize, x: &[Vec3]) -> Vec<f64> {
        forces(solid, &self.first[i], x)
    }

    /// ∂²r/∂p_i∂p_j, i ≤ j.
    pub fn second(&self, solid: &Solid, i: usize, j: usize, x: &[Vec3]) -> Vec<f64> {
        let place = i * MODULI - i * (i + 1) / 2 + j;
        forces(solid, &self.second[place], x)
    }
}

/// The body whose modulus is the derivative of that of `body` by the i-th field.
fn sloped(design: &Design, body: Body, i: usize) -> Body {
    let mut change = Change::default();
    change[STIFF - LOADS + i] = 1.0;
    body.slope(modulation(design, &change))
}

/// Elements of the free cells in which a body has any modulus.
fn answering(design: &Design, body: &Body) -> Result<Elements> {
    let (mesh, points) = (&design.mesh, design.mesh.kind.points().0);
    let answers = |(number, cell): &(usize, &[usize])| {
        let corners: Vec<Vec3> = cell.iter().map(|&n| mesh.nodes[n]).collect();
        let free = cell.iter().any(|&n| !mesh.clamped[n]);
        let any = |xi: &Vec3| body.at(mesh.kind.place(&corners, *xi).0, *number).mu != 0.0;
        free && points.iter().any(any)
    };
    let cells = mesh.each_cell().enumerate().filter(answers);
    elements(mesh.kind, cells, &mesh.nodes, body)
}

fn forces(solid: &Solid, elements: &[Box<dyn Element>], x: &[Vec3]) -> Vec<f64> {
    let mut force = vec![Vec3::ZERO; x.len()];
    add_parts((elements, &[]), x, &[], 1.0, &mut force, &mut []);
    solid.gathered(force)
}

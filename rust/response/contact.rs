//! Contact with a plane or a sphere, which pushes and never pulls, without friction.
//!
//! Some stations along the body, each a point p_i (the middle of its section) and a radius r_i,
//! have a gap to the obstacle: gap_i = (2 n·d + κ d·d)/(1 + √(1 + 2κ n·d + κ² d·d)) − r_i, d = p_i
//! − q (mm), q its foremost point, n the normal there, towards the body, κ its curvature (0: a
//! plane). The obstacle pushes a station along its normal n_i with a force λ_i (N), and with the
//! unit-force fields of the prior gap_i = gap_i⁰ + Σ_j n_i·t_j(p_i) (T_j − T_j⁰) + Σ_k n_i·f_k(p_i)
//! n_k λ_k ≥ 0, λ_i ≥ 0,
//!     λ_i gap_i = 0
//! together with the condition of every cable (`cables.rs`), which the same forces stretch: one
//! complementarity problem. Normals are those of the body without contact. Limits: fields of the
//! unloaded equilibrium, so the response to a push of many mm is too large; no contact between
//! stations.

use crate::algebra::Vec3;
use crate::algebra::complementarity::Problem;
use crate::error::{Result, invalid};
use crate::response::cables::Cables;
use crate::response::loads::{CONTACT, Coefficients, FIELDS, PUSH, STATIONS, TENDON, TIP_FORCE};
use crate::response::second_order::Second;
use crate::shape::Shape;
use std::sync::Arc;

/// The stations of a body.
pub struct Contact {
    places: Arc<dyn Shape>,
    /// Displacements of the stations by the fields of the prior, then by its cables and
    /// second-order terms.
    fields: Vec<Option<Arc<dyn Shape>>>,
    radii: Vec<f64>,
}

/// Field of the force on a station along x.
fn push(station: usize) -> usize {
    if station + 1 < STATIONS.len() {
        PUSH + 3 * station
    } else {
        TIP_FORCE
    }
}

impl Contact {
    /// `places` are the middles of the stations, `fields` their displacements by name; `radii`
    /// (mm).
    pub fn new(
        places: Arc<dyn Shape>,
        named: Vec<(String, Arc<dyn Shape>)>,
        cables: Option<&Cables>,
        second: Option<&Second>,
        radii: Vec<f64>,
    ) -> Result<Contact> {
        let count = STATIONS.len();
        if radii.len() != count || radii.iter().any(|r| !(r.is_finite() && *r >= 0.0)) {
            return Err(invalid(format!(
                "radii {radii:?} of stations: give {count} numbers of mm, 0 or more"
            )));
        }
        let mut fields: Vec<Option<Arc<dyn Shape>>> = vec![None; FIELDS.len()];
        for (name, field) in named {
            if let Some(f) = FIELDS.iter().position(|known| *known == name) {
                fields[f] = Some(field);
            }
        }
        fields.extend(cables.into_iter().flat_map(Cables::fields).map(Some));
        let wrong = |s: &Arc<dyn Shape>| s.size() != 3 * count || s.channels() != places.channels();
        let other = second.is_some_and(|second| second.outputs() != 3 * count);
        if other || wrong(&places) || fields.iter().flatten().any(wrong) {
            return Err(invalid(format!(
                "stations of a body: places and fields must give {} numbers at the same commands",
                3 * count
            )));
        }
        let forces = (0..count).flat_map(|k| push(k)..push(k) + 3);
        if let Some(missing) = forces.into_iter().find(|f| fields[*f].is_none()) {
            return Err(invalid(format!(
                "stations of a body need the field {}; build the model with its fields",
                FIELDS[missing]
            )));
        }
        if let Some(second) = second {
            fields.extend(second.fields()?.into_iter().map(Some));
        }
        Ok(Contact {
            places,
            fields,
            radii,
        })
    }

    /// Add the obstacle of `loads` at the command `u`: `weights` (fields, then tension changes) are
    /// input without contact and output with its pushes. `cables` come with the result of
    /// `Cables::at` and their further stretch.
    pub fn stop(
        &self,
        u: &[f64],
        loads: &Coefficients,
        cables: Option<(&Cables, &[f64], &[f64])>,
        weights: &mut [f64],
    ) {
        let stations = self.radii.len();
        let moves = |f: usize| {
            let mut out = vec![0.0; 3 * stations];
            if let Some(field) = &self.fields[f] {
                field.eval(u, &mut out);
            }
            out
        };
        let at = |all: &[f64], k: usize| Vec3::from_slice(&all[3 * k..]);
        let mut places = vec![0.0; 3 * stations];
        self.places.eval(u, &mut places);
        for (f, weight) in weights.iter().enumerate().filter(|(_, w)| **w != 0.0) {
            let moved = moves(f);
            places
                .iter_mut()
                .zip(moved)
                .for_each(|(p, m)| *p += weight * m);
        }
        let obstacle = Obstacle::of(loads);
        let free: Vec<(f64, Vec3)> = (0..stations)
            .map(|k| obstacle.gap(at(&places, k), self.radii[k]))
            .collect();
        if free.iter().all(|(gap, _)| *gap >= 0.0) {
            return;
        }
        // Displacements of all stations by a unit push on each, and by each cable.
        let pushed: Vec<Vec<f64>> = (0..stations)
            .map(|k| {
                let mut sum = vec![0.0; 3 * stations];
                for (axis, n) in free[k].1.to_array().into_iter().enumerate() {
                    sum.iter_mut()
                        .zip(moves(push(k) + axis))
                        .for_each(|(s, m)| *s += n * m);
                }
                sum
            })
            .collect();
        let (mut problem, mut before) = (Problem::default(), vec![]);
        if let Some((cables, place, beyond)) = cables {
            let (fields, gives) = (&loads[..FIELDS.len()], &loads[TENDON..CONTACT]);
            cables.pose(place, fields, gives, beyond, &mut problem);
            before.extend(cables.before(place));
        }
        let (n, matrix) = (before.len(), std::mem::take(&mut problem.matrix));
        let pulled: Vec<Vec<f64>> = (0..n).map(|j| moves(FIELDS.len() + j)).collect();
        let (size, all) = (n + stations, &mut problem.matrix);
        if let Some((cables, place, _)) = cables {
            for i in 0..n {
                all.extend_from_slice(&matrix[i * n..(i + 1) * n]);
                all.extend((0..stations).map(|k| {
                    let along = |a: usize| free[k].1[a] * cables.stretch(place, i, push(k) + a);
                    -(0..3).map(along).sum::<f64>()
                }));
            }
        }
        for (k, (gap, normal)) in free.iter().enumerate() {
            let towards = |moved: &Vec<f64>| normal.dot(at(moved, k));
            all.extend(pulled.iter().chain(&pushed).map(towards));
            // The gap is that with the tensions without the obstacle; the problem needs the one
            // without any.
            let tension = |j: usize| before[j] + weights[FIELDS.len() + j];
            problem.right.push(
                -gap + (0..n)
                    .map(|j| towards(&pulled[j]) * tension(j))
                    .sum::<f64>(),
            );
        }
        let start = (0..size).map(|i| {
            if i < n {
                before[i] + weights[FIELDS.len() + i] > 0.0
            } else {
                free[i - n].0 < 0.0
            }
        });
        problem.positive.extend(start);
        let found = problem.solve();
        for j in 0..n {
            weights[FIELDS.len() + j] = found[j] - before[j];
        }
        for k in 0..stations {
            for a in 0..3 {
                weights[push(k) + a] += found[n + k] * free[k].1[a];
            }
        }
    }
}

/// The obstacle.
struct Obstacle {
    foremost: Vec3,
    normal: Vec3,
    curvature: f64,
}

impl Obstacle {
    fn of(loads: &Coefficients) -> Obstacle {
        let number = |i: usize| loads[CONTACT + 1 + i];
        Obstacle {
            foremost: Vec3::new(number(0), number(1), number(2)),
            normal: Vec3::new(number(3), number(4), number(5)),
            curvature: number(6),
        }
    }

    /// Gap of a ball at `p`, and the normal there.
    fn gap(&self, p: Vec3, radius: f64) -> (f64, Vec3) {
        let (d, k) = (p - self.foremost, self.curvature);
        let (out, square) = (self.normal.dot(d), d.length_squared());
        let root = (1.0 + 2.0 * k * out + k * k * square).max(0.0).sqrt();
        let normal = self.normal + k * d;
        let gap = (2.0 * out + k * square) / (1.0 + root) - radius;
        (gap, 1.0 / normal.length().max(1e-12) * normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_to_a_sphere_are_distances_to_its_centre() {
        let normal = Vec3::new(0.6, 0.0, -0.8);
        for radius in [3.0, 40.0, 1e7] {
            let obstacle = Obstacle {
                foremost: Vec3::new(10.0, 2.0, 50.0),
                normal,
                curvature: 1.0 / radius,
            };
            let centre = obstacle.foremost - radius * normal;
            for p in [[12.0, 5.0, 40.0], [20.0, 2.0, 70.0], [8.0, 2.0, 55.0]].map(Vec3::from) {
                let (gap, n) = obstacle.gap(p, 1.5);
                let away = p - centre;
                assert!((gap - (away.length() - radius - 1.5)).abs() < 1e-7 * radius.max(10.0));
                assert!(n.distance(1.0 / away.length() * away) < 1e-6);
            }
        }
    }
}

//! The start of a registration: the command whose predicted shape is nearest to a cloud.
//!
//! Every candidate command is rated by the distance of the cloud from its vertices. The best are
//! refined by Gauss-Newton on the distance from points to the surface, along its normals, with
//! Tukey weights of a width from WIDE down to NARROW. The start with the least robust cost is
//! returned. Its command is not a measurement. mm.

use super::nearest::both_ways;
use super::robust::{tukey, tukey_cost};
use super::surface::Surface;
use crate::algebra::Vec3;
use crate::algebra::dense;
use crate::error::{Result, invalid};
use crate::shape::Shape;

/// Widths of the Tukey weights, mm, from the first step to the last.
const WIDE: f64 = 8.0;
const NARROW: f64 = 0.8;
/// Tukey's cut over the width.
pub const CUT: f64 = 2.5;
const STEPS: usize = 12;
/// Points of the cloud for comparing candidates, and for refining them.
const COMPARED: usize = 300;
const MOVED: usize = 600;
/// Candidates that are refined.
const BEST: usize = 3;
/// Least distance of different shapes, mm RMS.
const OTHER: f64 = 3.0;
/// Damping for commands that the cloud does not identify, as a share of the largest curvature.
const DAMPING: f64 = 1e-6;

/// A command, its shape, and its mean Tukey cost, 0 to 1.
#[derive(Debug, Clone)]
pub struct Start {
    pub command: Vec<f64>,
    pub places: Vec<Vec3>,
    pub cost: f64,
    /// Scale of the cloud relative to the template, about the origin, fitted with the command.
    pub scale: f64,
    /// The next best different shape: its cost, and the distance of its vertices, mm RMS.
    pub other: Option<(f64, f64)>,
}

/// The vertices (N, 3) of a shape at a command.
pub fn places(shape: &dyn Shape, command: &[f64]) -> Vec<Vec3> {
    let mut out = vec![0.0; shape.size()];
    shape.eval(command, &mut out);
    out.chunks_exact(3).map(Vec3::from_slice).collect()
}

/// Find the start for a `cloud` among `candidates` (G, C), whose commands stay between `low` and
/// `high` (C,).
pub fn start(
    shape: &dyn Shape,
    triangles: &[[usize; 3]],
    cloud: &[Vec3],
    candidates: &[Vec<f64>],
    low: &[f64],
    high: &[f64],
) -> Result<Start> {
    let few = spread(cloud, COMPARED);
    let mut ranked = vec![];
    for command in candidates {
        let (_, back) = both_ways(&places(shape, command), &few)?;
        let cost: f64 = back
            .distance
            .iter()
            .map(|d| tukey_cost(*d, CUT * WIDE))
            .sum();
        ranked.push((cost, command));
    }
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let some = spread(cloud, MOVED);
    let moved = ranked
        .iter()
        .take(BEST)
        .map(|(_, u)| moved(shape, triangles, &some, u, low, high));
    let mut found = moved.collect::<Result<Vec<_>>>()?;
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut found = found.into_iter();
    let mut best = found
        .next()
        .ok_or_else(|| invalid("no candidate commands to start from; give one or more"))?;
    best.other = found
        .map(|s| (s.cost, apart(&s.places, &best.places)))
        .find(|(_, far)| *far > OTHER);
    Ok(best)
}

/// Distance of two shapes, mm RMS over the vertices.
fn apart(one: &[Vec3], other: &[Vec3]) -> f64 {
    let squares = one.iter().zip(other).map(|(p, q)| p.distance_squared(*q));
    (squares.sum::<f64>() / one.len().max(1) as f64).sqrt()
}

/// Evenly spread points of a cloud, up to a number.
pub fn spread(cloud: &[Vec3], most: usize) -> Vec<Vec3> {
    let count = cloud.len().min(most);
    (0..count).map(|k| cloud[k * cloud.len() / count]).collect()
}

fn moved(
    shape: &dyn Shape,
    triangles: &[[usize; 3]],
    cloud: &[Vec3],
    from: &[f64],
    low: &[f64],
    high: &[f64],
) -> Result<Start> {
    let mut command = from.to_vec();
    let mut surface = Surface::new(&places(shape, &command), triangles)?;
    let mut slopes = vec![0.0; shape.size() * command.len()];
    for step in 0..STEPS {
        let part = step as f64 / (STEPS - 1) as f64;
        let cut = CUT * WIDE * (NARROW / WIDE).powf(part);
        shape.jacobian(&command, &mut slopes);
        let Some(change) = ahead(&surface, cloud, &slopes, command.len(), cut, false) else {
            break;
        };
        for c in 0..command.len() {
            command[c] = (command[c] + change[c]).clamp(low[c], high[c]);
        }
        surface.move_to(&places(shape, &command));
    }
    shape.jacobian(&command, &mut slopes);
    let larger = ahead(&surface, cloud, &slopes, command.len(), CUT * WIDE, true);
    let cost = cloud
        .iter()
        .map(|p| tukey_cost(surface.foot(*p).distance, CUT * NARROW));
    Ok(Start {
        cost: cost.sum::<f64>() / cloud.len().max(1) as f64,
        scale: 1.0 + larger.map_or(0.0, |change| change[command.len()]),
        other: None,
        places: places(shape, &command),
        command,
    })
}

/// One Gauss-Newton step of the distances along the normals, by the commands and, if it is
/// `scaled`, by the scale.
fn ahead(
    surface: &Surface,
    cloud: &[Vec3],
    slopes: &[f64],
    channels: usize,
    cut: f64,
    scaled: bool,
) -> Option<Vec<f64>> {
    let count = channels + usize::from(scaled);
    let (mut curve, mut slope) = (vec![vec![0.0; count]; count], vec![0.0; count]);
    let mut rate = vec![0.0; count];
    for p in cloud {
        let foot = surface.foot(*p);
        let weight = tukey(foot.distance, cut);
        if weight == 0.0 {
            continue;
        }
        let normal = surface.normal(foot.triangle);
        let off = normal.dot(foot.place - p);
        for (c, rate) in rate.iter_mut().enumerate().take(channels) {
            let along = |v: usize| {
                (0..3)
                    .map(|i| normal[i] * slopes[(3 * v + i) * channels + c])
                    .sum::<f64>()
            };
            let corners = surface.corners(foot.triangle);
            *rate = corners
                .iter()
                .zip(foot.weights)
                .map(|(v, w)| w * along(*v))
                .sum();
        }
        if scaled {
            rate[channels] = normal.dot(foot.place);
        }
        for a in 0..count {
            slope[a] -= weight * off * rate[a];
            (0..count).for_each(|b| curve[a][b] += weight * rate[a] * rate[b]);
        }
    }
    let most = (0..channels)
        .map(|c| curve[c][c])
        .fold(f64::MIN_POSITIVE, f64::max);
    (0..channels).for_each(|c| curve[c][c] += DAMPING * most);
    dense::solve(curve, slope)
}

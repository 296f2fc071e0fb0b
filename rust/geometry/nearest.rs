//! Nearest neighbours between two sets of points, both ways in one pass over all pairs.
//!
//! A template has hundreds of points and a cloud thousands: with wide vectors all pairs are quicker than any tree, up to some
//! ten million of them. Squared distances in single precision about
//! the middle of both sets choose the nearest, and its distance is then taken in double. Units are those of the points.
//! Limit: of two candidates whose distances differ by less than 1e-6 of the extent either may be called the nearest.

use crate::error::{Result, invalid};
use crate::modes::wide;
use crate::vector::{Vec3, norm, sub};

/// Points of the second set that are looked at together: their minima stay in the first cache.
const TILE: usize = 256;
/// Points of the first set that are looked at together: as many as stay in registers.
const ROWS: usize = 4;
/// What pads a tile: farther than anything, and its square is finite.
const FAR: f32 = 1e18;

/// For each point of a set the nearest of another: which, and how far.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Nearest {
    pub index: Vec<u32>,
    pub distance: Vec<f64>,
}

/// One tile of the second set, coordinate by coordinate, with the nearest of the first set so far.
struct Tile {
    x: [f32; TILE],
    y: [f32; TILE],
    z: [f32; TILE],
    least: [f32; TILE],
    which: [u32; TILE],
}

/// The nearest in `b` of each point of `a` (N, 3), and the nearest in `a` of each point of `b` (M, 3).
pub fn both_ways(a: &[Vec3], b: &[Vec3]) -> Result<(Nearest, Nearest)> {
    for (name, points) in [("first", a), ("second", b)] {
        if points.is_empty() {
            return Err(invalid(format!(
                "the {name} set of points is empty; nearest neighbours need one or more"
            )));
        }
        if let Some(i) = points.iter().position(|p| p.iter().any(|c| !c.is_finite())) {
            return Err(invalid(format!(
                "point {i} of the {name} set is not finite; leave out what was not seen"
            )));
        }
    }
    let middle = middle(a, b);
    let first = single(a, middle);
    let mut least = vec![f32::INFINITY; a.len()];
    let mut index = vec![0u32; a.len()];
    let mut back = Vec::with_capacity(b.len());
    for (t, points) in b.chunks(TILE).enumerate() {
        let mut tile = tile(points, middle);
        wide(
            #[inline(always)]
            || sweep(&first, &mut tile, &mut least, &mut index, (t * TILE) as u32),
        );
        back.extend_from_slice(&tile.which[..points.len()]);
    }
    Ok((found(a, b, index), found(b, a, back)))
}

impl Nearest {
    /// For each point in turn the nearest, and how far it is.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.index
            .iter()
            .map(|i| *i as usize)
            .zip(self.distance.iter().copied())
    }
}

fn found(from: &[Vec3], to: &[Vec3], index: Vec<u32>) -> Nearest {
    let distance = from.iter().zip(&index);
    let distance = distance
        .map(|(p, i)| norm(sub(*p, to[*i as usize])))
        .collect();
    Nearest { index, distance }
}

/// The middle of the box about both sets: single precision is finest there.
fn middle(a: &[Vec3], b: &[Vec3]) -> Vec3 {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for p in a.iter().chain(b) {
        for c in 0..3 {
            low[c] = low[c].min(p[c]);
            high[c] = high[c].max(p[c]);
        }
    }
    std::array::from_fn(|c| 0.5 * (low[c] + high[c]))
}

fn single(points: &[Vec3], middle: Vec3) -> Vec<[f32; 3]> {
    let about = |p: &Vec3| std::array::from_fn(|c| (p[c] - middle[c]) as f32);
    points.iter().map(about).collect()
}

fn tile(points: &[Vec3], middle: Vec3) -> Tile {
    let mut tile = Tile {
        x: [FAR; TILE],
        y: [FAR; TILE],
        z: [FAR; TILE],
        least: [f32::INFINITY; TILE],
        which: [0; TILE],
    };
    for (k, p) in points.iter().enumerate() {
        tile.x[k] = (p[0] - middle[0]) as f32;
        tile.y[k] = (p[1] - middle[1]) as f32;
        tile.z[k] = (p[2] - middle[2]) as f32;
    }
    tile
}

/// Compare all of the first set with one tile, whose first point is number `start`.
#[inline(always)]
fn sweep(first: &[[f32; 3]], tile: &mut Tile, least: &mut [f32], index: &mut [u32], start: u32) {
    let mut i = 0;
    while i + ROWS <= first.len() {
        let rows = rows::<ROWS>(&first[i..i + ROWS], i as u32, tile);
        keep(&rows, first, tile, least, index, i, start);
        i += ROWS;
    }
    while i < first.len() {
        let rows = rows::<1>(&first[i..i + 1], i as u32, tile);
        keep(&rows, first, tile, least, index, i, start);
        i += 1;
    }
}

/// Squared distance of each of `R` points to the nearest of the tile, whose own nearest are brought up to date.
#[inline(always)]
fn rows<const R: usize>(points: &[[f32; 3]], number: u32, tile: &mut Tile) -> [f32; R] {
    const LANES: usize = 16;
    let mut nearest = [[f32::INFINITY; LANES]; R];
    for first in (0..TILE).step_by(LANES) {
        let x: &[f32; LANES] = tile.x[first..first + LANES].try_into().unwrap();
        let y: &[f32; LANES] = tile.y[first..first + LANES].try_into().unwrap();
        let z: &[f32; LANES] = tile.z[first..first + LANES].try_into().unwrap();
        let least: &mut [f32; LANES] = (&mut tile.least[first..first + LANES]).try_into().unwrap();
        let which: &mut [u32; LANES] = (&mut tile.which[first..first + LANES]).try_into().unwrap();
        for r in 0..R {
            let [a, b, c] = points[r];
            let mut d = [0.0f32; LANES];
            for k in 0..LANES {
                let (u, v, w) = (x[k] - a, y[k] - b, z[k] - c);
                d[k] = u * u + v * v + w * w;
            }
            for k in 0..LANES {
                nearest[r][k] = if d[k] < nearest[r][k] {
                    d[k]
                } else {
                    nearest[r][k]
                };
            }
            for k in 0..LANES {
                which[k] = if d[k] < least[k] {
                    number + r as u32
                } else {
                    which[k]
                };
                least[k] = if d[k] < least[k] { d[k] } else { least[k] };
            }
        }
    }
    let smallest = |lanes: &[f32; LANES]| lanes.iter().copied().fold(f32::INFINITY, f32::min);
    std::array::from_fn(
        #[inline(always)]
        |r| smallest(&nearest[r]),
    )
}

/// Where a tile holds a nearer point than those before, find out which it is: that happens seldom.
#[inline(always)]
fn keep<const R: usize>(
    rows: &[f32; R],
    first: &[[f32; 3]],
    tile: &Tile,
    least: &mut [f32],
    index: &mut [u32],
    i: usize,
    start: u32,
) {
    for r in 0..R {
        if rows[r] < least[i + r] {
            least[i + r] = rows[r];
            let [a, b, c] = first[i + r];
            let mut place = 0;
            for k in (0..TILE).rev() {
                let (u, v, w) = (tile.x[k] - a, tile.y[k] - b, tile.z[k] - c);
                place = if u * u + v * v + w * w == rows[r] {
                    k
                } else {
                    place
                };
            }
            index[i + r] = start + place as u32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn naive(a: &[Vec3], b: &[Vec3]) -> Nearest {
        let nearest = |p: &Vec3| {
            let distances = b.iter().map(|q| norm(sub(*p, *q))).enumerate();
            distances.min_by(|x, y| x.1.total_cmp(&y.1)).unwrap()
        };
        let (index, distance) = a.iter().map(nearest).map(|(i, d)| (i as u32, d)).unzip();
        Nearest { index, distance }
    }

    fn set(size: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Vec3>> {
        proptest::collection::vec([-60.0..60.0f64, -60.0..60.0, 0.0..110.0], size)
    }

    proptest! {
        #[test]
        fn one_pass_finds_what_a_search_of_all_finds(a in set(1..40), b in set(1..700), far in 0.0..1e4f64) {
            let moved = |s: &[Vec3]| -> Vec<Vec3> { s.iter().map(|p| [p[0] + far, p[1] - far, p[2]]).collect() };
            let (a, b) = (moved(&a), moved(&b));
            let (there, back) = both_ways(&a, &b).unwrap();
            for (found, wanted) in [(there, naive(&a, &b)), (back, naive(&b, &a))] {
                for (f, w) in found.distance.iter().zip(&wanted.distance) {
                    prop_assert!((f - w).abs() < 2e-4 && *f >= w - 1e-9);
                }
            }
        }
    }

    #[test]
    fn a_point_that_is_in_both_sets_is_found_and_empty_sets_are_refused() {
        let a: Vec<Vec3> = (0..300)
            .map(|i| [f64::from(i), 0.5 * f64::from(i % 7), -3.0])
            .collect();
        let (there, back) = both_ways(&a, &a).unwrap();
        assert!(
            there
                .distance
                .iter()
                .chain(&back.distance)
                .all(|d| *d == 0.0)
        );
        assert!(
            there
                .index
                .iter()
                .enumerate()
                .all(|(i, n)| i == *n as usize)
        );
        assert!(both_ways(&[], &a).is_err() && both_ways(&a, &[[f64::NAN, 0.0, 0.0]]).is_err());
    }
}

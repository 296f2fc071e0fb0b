//! Nearest neighbours between two sets of points, both ways in one pass over pairs.
//!
//! A template has hundreds of points and a cloud thousands: with wide vectors, all pairs are faster
//! than any tree, up to about ten million pairs. Both sets are ordered along a space-filling curve
//! and cut into compact groups. Pairs of groups are skipped if their boxes are farther apart than
//! the distances found so far. Squared distances in single precision about the middle of both sets
//! select the nearest point; its distance is then computed in double precision. Units are those of
//! the points. Limit: if the distances of two candidates differ by less than 1e-6 of the extent,
//! either may be selected.

use super::curve::{Ordered, bounds};
use crate::algebra::Vec3;
use crate::error::{Result, invalid};
use crate::shape::modes::wide;

/// Points of the second set per tile.
const TILE: usize = 64;
/// Points of the first set per tile: as many as fit in registers.
const ROWS: usize = 4;
/// Numbers processed at once.
const LANES: usize = 8;
/// Shares of the bounds that are processed first: the nearest boxes lower the bound for the others.
const SHARES: [f32; 2] = [0.1, 1.0];

/// For each point of a set, the nearest of another: index and distance.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Nearest {
    pub index: Vec<u32>,
    pub distance: Vec<f64>,
}

/// The nearest in `b` of each point of `a` (N, 3), and the nearest in `a` of each point of `b` (M,
/// 3).
pub fn both_ways(a: &[Vec3], b: &[Vec3]) -> Result<(Nearest, Nearest)> {
    for (name, points) in [("first", a), ("second", b)] {
        if points.is_empty() {
            return Err(invalid(format!(
                "the {name} set of points is empty; nearest neighbours need one or more"
            )));
        }
        if let Some(i) = points.iter().position(|p| !p.is_finite()) {
            return Err(invalid(format!(
                "point {i} of the {name} set is not finite; leave out what was not seen"
            )));
        }
    }
    let (there, back) = wide(
        #[inline(always)]
        || search(a, b),
    );
    Ok((found(a, b, there), found(b, a, back)))
}

impl Nearest {
    /// For each point, the nearest and its distance.
    pub fn pairs(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.index
            .iter()
            .map(|i| *i as usize)
            .zip(self.distance.iter().copied())
    }
}

fn found(from: &[Vec3], to: &[Vec3], index: Vec<u32>) -> Nearest {
    let distance = from.iter().zip(&index);
    let distance = distance.map(|(p, i)| p.distance(to[*i as usize])).collect();
    Nearest { index, distance }
}

/// For each point of either set, the index of the nearest of the other.
#[inline(always)]
fn search(a: &[Vec3], b: &[Vec3]) -> (Vec<u32>, Vec<u32>) {
    let (low, high) = bounds(a, b);
    let (first, second) = (Ordered::new(a, low, high), Ordered::new(b, low, high));
    let (groups, tiles) = (
        Boxes::new(&first.points, ROWS),
        Boxes::new(&second.points, TILE),
    );
    let most = groups.len().max(tiles.len()).next_multiple_of(LANES);
    let mut gaps = vec![f32::INFINITY; most];
    let (mut there, mut back) = (vec![0; a.len()], vec![0; b.len()]);
    let mut at: Vec<Tile> = Vec::with_capacity(tiles.len());
    // The nearest along the curve: that of the previous point, which is close.
    let mut near = 0;
    for (t, points) in second.points.chunks(TILE).enumerate() {
        let mut tile = Tile::new(points);
        groups.gaps(tiles.of(t), &mut gaps[..groups.len()]);
        tile.compare(&first.points, near);
        gaps[near] = f32::INFINITY;
        for share in SHARES {
            for from in (0..groups.len()).step_by(LANES) {
                if !any_within(&gaps[from..from + LANES], share * tile.most) {
                    continue;
                }
                for g in from..from + LANES {
                    if gaps[g] <= share * tile.most {
                        tile.compare(&first.points, g);
                        gaps[g] = f32::INFINITY;
                    }
                }
            }
        }
        near = tile.which[0] as usize / ROWS;
        for (k, which) in tile.which[..points.len()].iter().enumerate() {
            back[second.order[t * TILE + k] as usize] = first.order[*which as usize];
        }
        at.push(tile);
    }
    let mut near = 0;
    gaps.fill(f32::INFINITY);
    for (i, p) in first.points.iter().enumerate() {
        tiles.gaps((*p, *p), &mut gaps[..tiles.len()]);
        let mut least = at[near].nearest(p, f32::INFINITY).unwrap_or(f32::INFINITY);
        for from in (0..tiles.len()).step_by(LANES) {
            if !any_within(&gaps[from..from + LANES], least) {
                continue;
            }
            for t in from..from + LANES {
                if gaps[t] < least
                    && let Some(nearer) = at[t].nearest(p, least)
                {
                    (least, near) = (nearer, t);
                }
            }
        }
        let place = near * TILE + at[near].place(p, least);
        there[first.order[i] as usize] = second.order[place];
    }
    (there, back)
}

/// Whether any of `LANES` gaps is within a bound: most are not, and are skipped together.
#[inline(always)]
fn any_within(gaps: &[f32], bound: f32) -> bool {
    (0..LANES).fold(false, |any, k| any | (gaps[k] <= bound))
}

/// The bounding boxes of groups of points of a set.
struct Boxes {
    low: [Vec<f32>; 3],
    high: [Vec<f32>; 3],
}

impl Boxes {
    #[inline(always)]
    fn new(points: &[[f32; 3]], each: usize) -> Boxes {
        let count = points.len().div_ceil(each);
        let mut boxes = Boxes {
            low: std::array::from_fn(|_| vec![0.0; count]),
            high: std::array::from_fn(|_| vec![0.0; count]),
        };
        for (t, some) in points.chunks(each).enumerate() {
            let (mut low, mut high) = (some[0], some[0]);
            for p in some {
                for c in 0..3 {
                    low[c] = if p[c] < low[c] { p[c] } else { low[c] };
                    high[c] = if p[c] > high[c] { p[c] } else { high[c] };
                }
            }
            for c in 0..3 {
                (boxes.low[c][t], boxes.high[c][t]) = (low[c], high[c]);
            }
        }
        boxes
    }

    fn len(&self) -> usize {
        self.low[0].len()
    }

    fn of(&self, t: usize) -> ([f32; 3], [f32; 3]) {
        (
            self.low.each_ref().map(|low| low[t]),
            self.high.each_ref().map(|high| high[t]),
        )
    }

    /// Squared gaps between all boxes and another: a lower bound for their points, rounding
    /// included.
    #[inline(always)]
    fn gaps(&self, (low, high): ([f32; 3], [f32; 3]), gaps: &mut [f32]) {
        let count = gaps.len();
        let [x, y, z]: [_; 3] =
            std::array::from_fn(|c| (&self.low[c][..count], &self.high[c][..count]));
        let gap = |sides: (&[f32], &[f32]), g: usize, c: usize| {
            let (after, before) = (sides.0[g] - high[c], low[c] - sides.1[g]);
            let apart = if after > before { after } else { before };
            if apart > 0.0 { apart } else { 0.0 }
        };
        for g in 0..count {
            let (u, v, w) = (gap(x, g, 0), gap(y, g, 1), gap(z, g, 2));
            gaps[g] = u * u + v * v + w * w;
        }
    }
}

/// Points of the second set, coordinate by coordinate, the last one repeated, with the nearest of
/// the first set so far.
struct Tile {
    at: [[f32; TILE]; 3],
    least: [f32; TILE],
    which: [u32; TILE],
    /// The largest of `least`.
    most: f32,
}

impl Tile {
    #[inline(always)]
    fn new(points: &[[f32; 3]]) -> Tile {
        Tile {
            at: std::array::from_fn(|c| {
                std::array::from_fn(|k| points[k.min(points.len() - 1)][c])
            }),
            least: [f32::INFINITY; TILE],
            which: [0; TILE],
            most: f32::INFINITY,
        }
    }

    /// Compare with group `g` of the first set.
    #[inline(always)]
    fn compare(&mut self, first: &[[f32; 3]], g: usize) {
        let start = g * ROWS;
        let rows: [[f32; 3]; ROWS] =
            std::array::from_fn(|r| first[(start + r).min(first.len() - 1)]);
        let mut most = [0.0f32; LANES];
        for from in (0..TILE).step_by(LANES) {
            let lanes = from..from + LANES;
            let [x, y, z]: [&[f32; LANES]; 3] =
                std::array::from_fn(|c| self.at[c][lanes.clone()].try_into().unwrap());
            let (mut least, mut which) = ([0.0f32; LANES], [0u32; LANES]);
            least.copy_from_slice(&self.least[lanes.clone()]);
            which.copy_from_slice(&self.which[lanes.clone()]);
            for r in 0..ROWS {
                let [a, b, c] = rows[r];
                for k in 0..LANES {
                    let (u, v, w) = (x[k] - a, y[k] - b, z[k] - c);
                    let d = u * u + v * v + w * w;
                    which[k] = if d < least[k] {
                        (start + r) as u32
                    } else {
                        which[k]
                    };
                    least[k] = if d < least[k] { d } else { least[k] };
                }
            }
            for k in 0..LANES {
                most[k] = if least[k] > most[k] {
                    least[k]
                } else {
                    most[k]
                };
            }
            self.least[lanes.clone()].copy_from_slice(&least);
            self.which[lanes].copy_from_slice(&which);
        }
        self.most = most.iter().copied().fold(0.0, f32::max);
    }

    /// Squared distance of a point to the nearest of the tile, if that is less than `least`.
    #[inline(always)]
    fn nearest(&self, of: &[f32; 3], least: f32) -> Option<f32> {
        let mut nearest = [f32::INFINITY; LANES];
        for from in (0..TILE).step_by(LANES) {
            for k in 0..LANES {
                let d = self.squared(of, from + k);
                nearest[k] = if d < nearest[k] { d } else { nearest[k] };
            }
        }
        let any = nearest.iter().fold(false, |any, d| any | (*d < least));
        any.then(|| nearest.iter().copied().fold(f32::INFINITY, f32::min))
    }

    /// The index of the tile's point at a squared distance.
    #[inline(always)]
    fn place(&self, of: &[f32; 3], distance: f32) -> usize {
        (0..TILE).rev().fold(0, |place, k| {
            if self.squared(of, k) == distance {
                k
            } else {
                place
            }
        })
    }

    #[inline(always)]
    fn squared(&self, of: &[f32; 3], k: usize) -> f32 {
        let [u, v, w]: [f32; 3] = std::array::from_fn(|c| self.at[c][k] - of[c]);
        u * u + v * v + w * w
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn naive(a: &[Vec3], b: &[Vec3]) -> Nearest {
        let nearest = |p: &Vec3| {
            let distances = b.iter().map(|q| p.distance(*q)).enumerate();
            distances.min_by(|x, y| x.1.total_cmp(&y.1)).unwrap()
        };
        let (index, distance) = a.iter().map(nearest).map(|(i, d)| (i as u32, d)).unzip();
        Nearest { index, distance }
    }

    fn set(size: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Vec3>> {
        let place = [-60.0..60.0f64, -60.0..60.0, 0.0..110.0];
        proptest::collection::vec(place.prop_map(Vec3::from), size)
    }

    proptest! {
        #[test]
        fn one_pass_finds_what_a_search_of_all_finds(a in set(1..40), b in set(1..700), far in 0.0..1e4f64) {
            let moved = |s: &[Vec3]| -> Vec<Vec3> { s.iter().map(|p| p + far * Vec3::new(1.0, -1.0, 0.0)).collect() };
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
    fn boxes_that_are_passed_over_hold_nothing_nearer() {
        // A bent tube and a noisy cloud of one of its sides, with some points far off: many tiles
        // and groups.
        let mut state = 1u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut tube = |turn: f64, noise: f64| {
            let (angle, z) = (turn * next(), 100.0 * next());
            let [x, y] = [8.0 * angle.cos(), 8.0 * angle.sin()];
            Vec3::new(
                x + 0.004 * z * z + noise * next(),
                y + noise * next(),
                z + noise * next(),
            )
        };
        let a: Vec<Vec3> = (0..549).map(|_| tube(6.3, 0.0)).collect();
        let mut b: Vec<Vec3> = (0..2990).map(|_| tube(3.1, 1.0)).collect();
        b.extend((0..13).map(|i| Vec3::new(300.0, -40.0 * f64::from(i), 7.0)));
        let (there, back) = both_ways(&a, &b).unwrap();
        for (found, wanted) in [(there, naive(&a, &b)), (back, naive(&b, &a))] {
            for (f, w) in found.distance.iter().zip(&wanted.distance) {
                assert!((f - w).abs() < 2e-4 && *f >= w - 1e-9);
            }
        }
    }

    #[test]
    fn a_point_that_is_in_both_sets_is_found_and_empty_sets_are_refused() {
        let a: Vec<Vec3> = (0..300)
            .map(|i| Vec3::new(f64::from(i), 0.5 * f64::from(i % 7), -3.0))
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
        assert!(both_ways(&[], &a).is_err() && both_ways(&a, &[Vec3::NAN]).is_err());
    }
}

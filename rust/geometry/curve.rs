//! Points in the order of Morton's space-filling curve: neighbours along it are usually close in
//! space (Morton 1966).

use crate::algebra::Vec3;

/// Cells of the curve along an axis.
const CELLS: usize = 16;
/// The four bits of a cell's number with two gaps after each.
const APART: [u16; CELLS] = {
    let mut apart = [0; CELLS];
    let mut cell = 0;
    while cell < CELLS {
        let bits = (cell | cell << 4) & 0xc3;
        apart[cell] = ((bits | bits << 2) & 0x249) as u16;
        cell += 1;
    }
    apart
};

/// The box about both sets.
#[inline(always)]
pub fn bounds(a: &[Vec3], b: &[Vec3]) -> (Vec3, Vec3) {
    // Four points at once, as plain numbers, to fill wide vectors.
    let (mut low, mut high) = ([f64::INFINITY; 12], [f64::NEG_INFINITY; 12]);
    for points in [a, b] {
        let (fours, rest) = points.as_chunks::<4>();
        for four in fours {
            let four = four.map(|p| p.to_array());
            for (k, v) in four.as_flattened().iter().enumerate() {
                low[k] = if *v < low[k] { *v } else { low[k] };
                high[k] = if *v > high[k] { *v } else { high[k] };
            }
        }
        for (k, v) in rest.iter().flat_map(Vec3::to_array).enumerate() {
            (low[k], high[k]) = (low[k].min(v), high[k].max(v));
        }
    }
    let of = |all: [f64; 12], worse: fn(Vec3, Vec3) -> Vec3| {
        let lanes = all.chunks_exact(3).map(Vec3::from_slice);
        lanes.fold(Vec3::from_slice(&all), worse)
    };
    (of(low, Vec3::min), of(high, Vec3::max))
}

/// Points in single precision about the middle of a box, where precision is highest, along Morton's
/// curve, with their indices.
pub struct Ordered {
    pub points: Vec<[f32; 3]>,
    pub order: Vec<u32>,
}

impl Ordered {
    #[inline(always)]
    pub fn new(points: &[Vec3], low: Vec3, high: Vec3) -> Ordered {
        let middle = 0.5 * (low + high);
        let sides = (high - low).max(Vec3::splat(f64::MIN_POSITIVE));
        let scale = ((1.0 - 1e-6) * CELLS as f64 / sides).as_vec3();
        let near = |p: &Vec3| (p - middle).as_vec3().to_array();
        let key = |p: &Vec3| {
            let p = near(p);
            let cell =
                |c: usize| (p[c] * scale[c] + 0.5 * CELLS as f32) as i32 & (CELLS as i32 - 1);
            APART[cell(0) as usize] | APART[cell(1) as usize] << 1 | APART[cell(2) as usize] << 2
        };
        let keys: Vec<u16> = points.iter().map(key).collect();
        let mut starts = [0u32; CELLS * CELLS * CELLS + 1];
        keys.iter().for_each(|key| starts[*key as usize + 1] += 1);
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let mut ordered = Ordered {
            points: vec![[0.0; 3]; points.len()],
            order: vec![0; points.len()],
        };
        for (i, key) in keys.iter().enumerate() {
            let place = &mut starts[*key as usize];
            ordered.points[*place as usize] = near(&points[i]);
            ordered.order[*place as usize] = i as u32;
            *place += 1;
        }
        ordered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_there_once_and_cells_follow_the_curve() {
        let cell = |i: usize| f64::from(i as u32) + 0.5;
        // The corners of a cube of 16³ cells, and each cell of its diagonal, last first.
        let mut points: Vec<Vec3> = (0..CELLS).rev().map(|i| Vec3::splat(cell(i))).collect();
        points.extend([
            Vec3::ZERO,
            Vec3::splat(16.0),
            16.0 * Vec3::X,
            16.0 * Vec3::Y,
            16.0 * Vec3::Z,
        ]);
        let (low, high) = bounds(&points[..5], &points[5..]);
        assert_eq!((low, high), (Vec3::ZERO, Vec3::splat(16.0)));
        let ordered = Ordered::new(&points, low, high);
        let mut all = ordered.order.clone();
        all.sort();
        assert!(all.iter().enumerate().all(|(i, o)| i == *o as usize));
        for (p, i) in ordered.points.iter().zip(&ordered.order) {
            assert!((0..3).all(|c| f64::from(p[c]) == points[*i as usize][c] - 8.0));
        }
        let place = |i: u32| ordered.order.iter().position(|o| *o == i);
        assert!((1..CELLS as u32).all(|i| place(i) < place(i - 1)));
        // Half of the cube across x comes before all of the other half across z, because z is the
        // most significant.
        let [x, y, z] = [18, 19, 20].map(place);
        assert!(x < y && y < z && place(16) < x && z < place(0));
    }

    #[test]
    fn points_without_extent_keep_their_order() {
        let place = Vec3::new(3.0, -1.0, 2.0);
        let ordered = Ordered::new(&[place; 5], place, place);
        assert_eq!(ordered.order, [0, 1, 2, 3, 4]);
        assert!(ordered.points.iter().all(|p| *p == [0.0; 3]));
    }
}

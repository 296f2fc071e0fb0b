//! Layers applied to a few columns side by side: commands, or one command and its tangents.
//!
//! Weights are packed [rows/32][columns][32], so one pass reads them once, in order; a number of
//! each column is broadcast against them, and all sums of a block stay in registers (`GROUP`).
//! Every sum goes over its inputs in order for any number of columns, so a command has the same
//! result alone and in a batch.

use pulp::Simd;
use std::f32::consts::{FRAC_1_SQRT_2, LN_2, LOG2_E};

/// Most columns side by side.
pub const COLUMNS: usize = 8;
/// Rows of a block of weights.
const BLOCK: usize = 32;
/// Inputs of a layer per block: they fit in the first-level cache.
const INPUTS: usize = 512;
/// Numbers that a reduction sums side by side.
const SUMS: usize = 8;

/// y = W x + b.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    pub rows: usize,
    pub columns: usize,
    packed: Vec<f32>,
    pub bias: Vec<f32>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Activation {
    Relu,
    Gelu,
}

/// N columns of numbers, each `stride` after the other.
pub(super) struct Columns<'a, const N: usize> {
    pub numbers: &'a mut [f32],
    pub stride: usize,
    /// Whether columns beyond the first are tangents of it.
    pub tangents: bool,
}

impl<const N: usize> Columns<'_, N> {
    #[inline(always)]
    fn column(&mut self, n: usize, width: usize) -> &mut [f32] {
        &mut self.numbers[n * self.stride..][..width]
    }

    /// Factor of a constant in a column: the slope of a constant is 0.
    #[inline(always)]
    fn constant(&self, n: usize) -> f32 {
        if self.tangents && n > 0 { 0.0 } else { 1.0 }
    }
}

/// Distance of the columns of a network: not a power of two, which would collide in the cache.
pub(super) fn stride(widest: usize) -> usize {
    widest.next_multiple_of(BLOCK) + BLOCK / 2
}

impl Linear {
    /// From `weights` (rows, columns) row by row, and `bias` (rows,).
    pub fn new(columns: usize, weights: &[f64], bias: &[f64]) -> Linear {
        let rows = bias.len();
        let mut layer = Linear {
            rows,
            columns,
            packed: vec![0.0; rows.next_multiple_of(BLOCK) * columns],
            bias: bias.iter().map(|b| *b as f32).collect(),
        };
        for (i, weight) in weights.iter().enumerate() {
            *layer.weight_mut(i / columns, i % columns) = *weight as f32;
        }
        layer
    }

    fn place(&self, row: usize, column: usize) -> usize {
        (row / BLOCK * self.columns + column) * BLOCK + row % BLOCK
    }

    pub fn weight(&self, row: usize, column: usize) -> f32 {
        self.packed[self.place(row, column)]
    }

    pub fn weight_mut(&mut self, row: usize, column: usize) -> &mut f32 {
        let place = self.place(row, column);
        &mut self.packed[place]
    }

    /// Write W x + b of every column to `out`, with zeros from the last row to the end of its
    /// block.
    #[inline(always)]
    pub fn apply<S: Simd, const N: usize>(&self, simd: S, x: &Columns<N>, out: &mut Columns<N>) {
        // As many sums as fit in registers (or in plain loops without vectors), and enough to hide
        // latency.
        match (S::F32_LANES, N) {
            (16, ..=4) => self.sums::<S, N, 2, 2>(simd, x, out),
            (16, _) => self.sums::<S, N, 2, 1>(simd, x, out),
            (8, 1) => self.sums::<S, N, 4, 2>(simd, x, out),
            (8, ..=3) => self.sums::<S, N, 4, 1>(simd, x, out),
            (8, 4) => self.sums::<S, N, 2, 1>(simd, x, out),
            (8, _) => self.sums::<S, N, 1, 1>(simd, x, out),
            (4, ..=3) => self.sums::<S, N, 8, 1>(simd, x, out),
            (4, 4) => self.sums::<S, N, 4, 1>(simd, x, out),
            (4, _) => self.sums::<S, N, 2, 1>(simd, x, out),
            (_, ..=4) => self.sums::<S, N, 8, 1>(simd, x, out),
            _ => self.sums::<S, N, 4, 1>(simd, x, out),
        }
        for n in 0..N {
            let constant = x.constant(n);
            let column = out.column(n, self.rows);
            for r in 0..self.rows {
                column[r] += constant * self.bias[r];
            }
        }
    }

    /// W x of every column, V vectors of rows of each of B blocks at a time.
    #[inline(always)]
    fn sums<S: Simd, const N: usize, const V: usize, const B: usize>(
        &self,
        simd: S,
        x: &Columns<N>,
        out: &mut Columns<N>,
    ) {
        let blocks = self.packed.len() / (BLOCK * self.columns);
        for first in (0..self.columns).step_by(INPUTS) {
            let inputs = Inputs::of(x, first, self.columns.min(first + INPUTS));
            for b in (0..blocks - blocks % B).step_by(B) {
                self.group::<S, N, V, B>(simd, &inputs, b, first > 0, out);
            }
            for b in blocks - blocks % B..blocks {
                self.group::<S, N, V, 1>(simd, &inputs, b, first > 0, out);
            }
        }
    }

    /// The products of `inputs` in B blocks of rows from `b` on, written to `out` or added to it.
    #[inline(always)]
    fn group<S: Simd, const N: usize, const V: usize, const B: usize>(
        &self,
        simd: S,
        inputs: &Inputs<N>,
        b: usize,
        added: bool,
        out: &mut Columns<N>,
    ) {
        let size = BLOCK * self.columns;
        let blocks: [&[f32]; B] = std::array::from_fn(|k| &self.packed[(b + k) * size..][..size]);
        for first in (0..BLOCK).step_by(V * S::F32_LANES) {
            let place = |n: usize, k: usize| n * out.stride + (b + k) * BLOCK + first;
            let mut sums = [[[simd.splat_f32s(0.0); V]; B]; N];
            if added {
                for (n, k) in (0..N).flat_map(|n| (0..B).map(move |k| (n, k))) {
                    let rows = &out.numbers[place(n, k)..][..V * S::F32_LANES];
                    sums[n][k].copy_from_slice(S::as_simd_f32s(rows).0);
                }
            }
            for (at, numbers) in inputs.all() {
                let numbers: [S::f32s; N] = std::array::from_fn(|n| simd.splat_f32s(numbers[n]));
                for k in 0..B {
                    let row = &blocks[k][*at as usize * BLOCK + first..][..V * S::F32_LANES];
                    let (weights, _) = S::as_simd_f32s(row);
                    for v in 0..V {
                        for n in 0..N {
                            sums[n][k][v] =
                                simd.mul_add_e_f32s(weights[v], numbers[n], sums[n][k][v]);
                        }
                    }
                }
            }
            for (n, k) in (0..N).flat_map(|n| (0..B).map(move |k| (n, k))) {
                let start = place(n, k);
                let rows = &mut out.numbers[start..][..V * S::F32_LANES];
                S::as_mut_simd_f32s(rows).0.copy_from_slice(&sums[n][k]);
            }
        }
    }
}

/// The inputs of a layer that are not zero in all columns. After Relu half of them are zero,
/// tangents too, and their weights are not read.
struct Inputs<const N: usize> {
    count: usize,
    places: [u32; INPUTS],
    numbers: [[f32; N]; INPUTS],
}

impl<const N: usize> Inputs<N> {
    #[inline(always)]
    fn of(x: &Columns<N>, first: usize, end: usize) -> Inputs<N> {
        let columns: [&[f32]; N] = std::array::from_fn(|n| &x.numbers[n * x.stride..][..end]);
        let mut found = Inputs {
            count: 0,
            places: [0; INPUTS],
            numbers: [[0.0; N]; INPUTS],
        };
        for at in first..end {
            let numbers: [f32; N] = std::array::from_fn(|n| columns[n][at]);
            found.places[found.count] = at as u32;
            found.numbers[found.count] = numbers;
            // No branch: zeros are not predictable.
            found.count += usize::from(numbers.iter().fold(false, |any, v| any | (*v != 0.0)));
        }
        found
    }

    #[inline(always)]
    fn all(&self) -> impl Iterator<Item = (&u32, &[f32; N])> {
        self.places[..self.count].iter().zip(&self.numbers)
    }
}

impl Activation {
    /// Change the first `width` numbers of every column; tangents by the slope at the value.
    #[inline(always)]
    pub(super) fn apply<const N: usize>(self, x: &mut Columns<N>, width: usize) {
        match self {
            Activation::Relu => each(
                x,
                width,
                #[inline(always)]
                // At the kink, the slope of the side above.
                |v| (v.max(0.0), if v >= 0.0 { 1.0 } else { 0.0 }),
            ),
            Activation::Gelu => each(
                x,
                width,
                #[inline(always)]
                |v| {
                    let (below, density) = normal(v);
                    (v * below, below + v * density)
                },
            ),
        }
    }
}

/// Replace every value by that of `law`, its tangents by themselves times the slope of `law`.
#[inline(always)]
fn each<const N: usize>(x: &mut Columns<N>, width: usize, law: impl Fn(f32) -> (f32, f32)) {
    let (stride, tangents) = (x.stride, x.tangents);
    if tangents {
        let (values, rest) = x.numbers.split_at_mut(stride);
        // A few at a time, so their slopes stay in the cache.
        let mut slopes = [0.0f32; BLOCK];
        for (b, values) in values[..width].chunks_mut(BLOCK).enumerate() {
            for (value, slope) in values.iter_mut().zip(&mut slopes) {
                (*value, *slope) = law(*value);
            }
            for n in 1..N {
                let column = &mut rest[(n - 1) * stride + b * BLOCK..][..values.len()];
                for (tangent, slope) in column.iter_mut().zip(&slopes) {
                    *tangent *= slope;
                }
            }
        }
    } else {
        for n in 0..N {
            for value in x.column(n, width) {
                *value = law(*value).0;
            }
        }
    }
}

/// The share of a standard normal distribution below `x`, and its density there; to 3e-7.
///
/// erf by the rational function of Eigen (Guennebaud et al., https://eigen.tuxfamily.org,
/// MathFunctionsImpl.h), exp by its series about the nearest power of two: plain arithmetic, which
/// compiles to vectors.
#[inline(always)]
pub(super) fn normal(x: f32) -> (f32, f32) {
    const DENSITY: f32 = 0.398_942_3; // of x = 0
    const ABOVE: [f32; 7] = [
        -2.726_142_3e-10,
        2.770_681_5e-8,
        -2.101_024e-6,
        -5.692_506_4e-5,
        -7.349_906_3e-4,
        -2.954_6e-3,
        -1.609_603_3e-2,
    ];
    const UNDER: [f32; 5] = [
        -1.456_607_2e-5,
        -2.133_740_6e-4,
        -1.682_827e-3,
        -7.373_329e-3,
        -1.426_473_9e-2,
    ];
    let z = (x * FRAC_1_SQRT_2).clamp(-4.0, 4.0);
    let square = z * z;
    let (mut above, mut under) = (ABOVE[0], UNDER[0]);
    for k in 1..ABOVE.len() {
        above = above * square + ABOVE[k];
    }
    for k in 1..UNDER.len() {
        under = under * square + UNDER[k];
    }
    let below = 0.5 + 0.5 * (z * above / under);
    (below, DENSITY * exponential((-0.5 * x * x).max(-80.0)))
}

/// e^x for −80 ≤ x ≤ 0.
#[inline(always)]
fn exponential(x: f32) -> f32 {
    const SERIES: [f32; 6] = [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0];
    const ROUNDS: f32 = 12_582_912.0; // 1.5 · 2²³: a number added to it loses its fraction
    let rounded = x * LOG2_E + ROUNDS;
    let power = rounded - ROUNDS;
    // ln 2 in two parts, the first of few digits.
    let rest = (x - power * 0.693_359_4) - power * (LN_2 - 0.693_359_4);
    let mut sum = SERIES[0];
    for k in 1..SERIES.len() {
        sum = sum * rest + SERIES[k];
    }
    let whole = f32::from_bits((rounded.to_bits() << 23).wrapping_add(1.0f32.to_bits()));
    (sum * rest + 1.0) * whole
}

/// y = s x + t, number by number.
#[inline(always)]
pub(super) fn affine<const N: usize>(x: &mut Columns<N>, scale: &[f32], shift: &[f32]) {
    for n in 0..N {
        let constant = x.constant(n);
        let column = x.column(n, scale.len());
        for i in 0..scale.len() {
            column[i] = scale[i] * column[i] + constant * shift[i];
        }
    }
}

/// Take the mean from the first `width` numbers of every column and divide them by their standard
/// deviation; tangents go with the first column: with y = (x − m)/σ, dy = (dx − mean(dx) −
/// y·mean(y·dx))/σ.
#[inline(always)]
pub(super) fn normalise<const N: usize>(x: &mut Columns<N>, width: usize, epsilon: f32) {
    let part = 1.0 / width as f32;
    for n in 0..N {
        let column = x.column(n, width);
        let mean = part * dot(column, None);
        column.iter_mut().for_each(|v| *v -= mean);
    }
    let factor = |variance: f32| 1.0 / (variance + epsilon).sqrt();
    if !x.tangents {
        for n in 0..N {
            let column = x.column(n, width);
            let factor = factor(part * dot(column, Some(column)));
            column.iter_mut().for_each(|v| *v *= factor);
        }
        return;
    }
    let (values, rest) = x.numbers.split_at_mut(x.stride);
    let values = &mut values[..width];
    let factor = factor(part * dot(values, Some(values)));
    values.iter_mut().for_each(|v| *v *= factor);
    for n in 1..N {
        let column = &mut rest[(n - 1) * x.stride..][..width];
        let along = part * dot(column, Some(values));
        for (v, value) in column.iter_mut().zip(values.iter()) {
            *v = (*v - along * value) * factor;
        }
    }
}

/// Σ a·b, or Σ a.
#[inline(always)]
fn dot(a: &[f32], b: Option<&[f32]>) -> f32 {
    let mut sums = [0.0f32; SUMS];
    let b = b.map(|b| &b[..a.len()]);
    let whole = a.len() - a.len() % SUMS;
    for first in (0..whole).step_by(SUMS) {
        for k in 0..SUMS {
            sums[k] += a[first + k] * b.map_or(1.0, |b| b[first + k]);
        }
    }
    for i in whole..a.len() {
        sums[i - whole] += a[i] * b.map_or(1.0, |b| b[i]);
    }
    sums.iter().sum()
}

//! Layers at work on several numbers side by side: commands, or one command and its tangents.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Commands, or a command and its tangents, that run side by side.
pub const LANES: usize = 8;
/// Rows of a layer that are summed at a time.
const ROWS: usize = 4;

pub(super) type Lanes = [f32; LANES];

/// y = W x + b, W row by row.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    pub columns: usize,
    pub weights: Vec<f32>,
    pub bias: Vec<f32>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Activation {
    Relu,
    Gelu,
}

impl Linear {
    #[inline(always)]
    /// W x, and b times what `biased` says of each lane.
    pub fn apply(&self, x: &[Lanes], biased: &Lanes, out: &mut [Lanes]) {
        let blocks = out
            .chunks_mut(ROWS)
            .zip(self.weights.chunks(ROWS * self.columns))
            .zip(self.bias.chunks(ROWS));
        for ((out, weights), bias) in blocks {
            let mut sums = [[0.0f32; LANES]; ROWS];
            if out.len() == ROWS {
                let (one, rest) = weights.split_at(self.columns);
                let (two, rest) = rest.split_at(self.columns);
                let (three, four) = rest.split_at(self.columns);
                for ((((x, a), b), c), d) in x.iter().zip(one).zip(two).zip(three).zip(four) {
                    for k in 0..LANES {
                        sums[0][k] += a * x[k];
                        sums[1][k] += b * x[k];
                        sums[2][k] += c * x[k];
                        sums[3][k] += d * x[k];
                    }
                }
            } else {
                for (sum, row) in sums.iter_mut().zip(weights.chunks(self.columns)) {
                    for (x, w) in x.iter().zip(row) {
                        (0..LANES).for_each(|k| sum[k] += w * x[k]);
                    }
                }
            }
            for ((out, sum), bias) in out.iter_mut().zip(&sums).zip(bias) {
                (0..LANES).for_each(|k| out[k] = sum[k] + bias * biased[k]);
            }
        }
    }
}

impl Activation {
    /// Value and slope.
    pub fn at(self, x: f32) -> (f32, f32) {
        match self {
            Activation::Relu if x > 0.0 => (x, 1.0),
            Activation::Relu => (0.0, if x == 0.0 { 1.0 } else { 0.0 }),
            Activation::Gelu => {
                let wide = f64::from(x);
                let below = 0.5 * (1.0 + libm::erf(wide * FRAC_1_SQRT_2));
                let density = (-0.5 * wide * wide).exp() / (2.0 * PI).sqrt();
                ((wide * below) as f32, (below + wide * density) as f32)
            }
        }
    }

    /// Lane 0 is the value, those after it up to `count` are slopes.
    pub fn with_slopes(self, lanes: &mut Lanes, count: usize) {
        let (value, slope) = self.at(lanes[0]);
        lanes[0] = value;
        lanes[1..count].iter_mut().for_each(|v| *v *= slope);
    }
}

/// Take the mean from every lane and divide it by its standard deviation; tangents go with lane 0.
pub(super) fn normalise(x: &mut [Lanes], epsilon: f32, tangents: bool) {
    let count = x.len() as f32;
    let mut mean = [0.0f32; LANES];
    x.iter()
        .for_each(|v| (0..LANES).for_each(|k| mean[k] += v[k] / count));
    x.iter_mut()
        .for_each(|v| (0..LANES).for_each(|k| v[k] -= mean[k]));
    let with = |k: usize| if tangents { 0 } else { k };
    let mut squares = [0.0f32; LANES];
    x.iter()
        .for_each(|v| (0..LANES).for_each(|k| squares[k] += v[k] * v[with(k)] / count));
    let part: Lanes = std::array::from_fn(|k| 1.0 / (squares[with(k)] + epsilon).sqrt());
    for v in x.iter_mut() {
        let value = v[0];
        for k in 0..LANES {
            let along = if tangents && k > 0 {
                value * squares[k] * part[0] * part[0]
            } else {
                0.0
            };
            v[k] = (v[k] - along) * part[k];
        }
    }
}

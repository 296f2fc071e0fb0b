//! A trained network as a shape: commands in, points of the body out, with exact slopes.
//!
//!   x₀ = u,   x_{k+1} = a_k(W_k x_k + b_k),   out = W x + b
//!
//! with Relu, Gelu (Hendrycks & Gimpel 2016, arXiv:1606.08415) or a normalised layer (Ba et al.
//! 2016, arXiv:1607.06450) as a_k. Constants before and after a linear layer are folded into it in
//! double precision when the file is read (`onnx.rs`, `fold.rs`); the layers then run in single
//! precision, several commands side by side, or one command with its slopes (a tangent for each
//! channel) in the same pass (`layers.rs`), with the widest vectors of the processor, detected when
//! the file is read. A pass reads the weights once and takes little longer than that. It allocates
//! nothing: each thread keeps its own workspace, made when it reads a network or in its first pass;
//! so no thread waits for another. Limits: values are accurate to about 1e-6 of the size of the
//! outputs; at a kink of Relu, the slope is that of the side above.

mod fold;
mod layers;
mod onnx;

use fold::{Waiting, folded, settle};
pub use layers::COLUMNS;
use layers::{Activation, Columns, Linear, affine, normalise};
pub use onnx::check;

use crate::error::{Result, invalid};
use crate::shape::{Shape, Work};
use pulp::{Arch, Simd, WithSimd};
use std::cell::RefCell;

thread_local! {
    /// The activations of the widest network that this thread has run.
    static ROOM: RefCell<Vec<f32>> = const { RefCell::new(vec![]) };
}

/// A layer as in a file.
pub(crate) enum Layer {
    Linear {
        columns: usize,
        weights: Vec<f64>,
        bias: Vec<f64>,
    },
    Normalise {
        epsilon: f32,
        scale: Vec<f64>,
        shift: Vec<f64>,
    },
    Activation(Activation),
    Scale(Vec<f64>),
    Shift(Vec<f64>),
}

#[derive(Debug, Clone)]
enum Step {
    Linear(Linear),
    Activation(Activation),
    Normalise {
        epsilon: f32,
    },
    /// y = s x + t, elementwise.
    Affine {
        scale: Vec<f32>,
        shift: Vec<f32>,
    },
}

/// Layers, one after the other.
#[derive(Debug, Clone)]
pub struct Network {
    channels: usize,
    size: usize,
    widest: usize,
    steps: Vec<Step>,
    arch: Arch,
}

impl Network {
    /// Read an ONNX file that `softmap-training` wrote.
    pub fn read(file: &[u8]) -> Result<Network> {
        Network::new(onnx::layers(file)?)
    }

    fn new(layers: Vec<Layer>) -> Result<Network> {
        let first = layers.iter().find_map(|layer| match layer {
            Layer::Linear { columns, .. } => Some(*columns),
            _ => None,
        });
        let channels =
            first.ok_or_else(|| invalid("a network without a linear layer; export it again"))?;
        let (mut width, mut widest) = (channels, channels);
        let mut steps: Vec<Step> = vec![];
        let mut waiting: Option<Waiting> = None;
        let fits = |width: usize, count: usize| {
            if width == count {
                return Ok(());
            }
            Err(invalid(format!(
                "a layer of {count} numbers follows one of {width}; export it again"
            )))
        };
        for layer in layers {
            match layer {
                Layer::Scale(by) => {
                    fits(width, by.len())?;
                    let wait = waiting.get_or_insert_with(|| Waiting::none(width));
                    wait.scale.iter_mut().zip(&by).for_each(|(s, b)| *s *= b);
                    wait.shift.iter_mut().zip(&by).for_each(|(s, b)| *s *= b);
                }
                Layer::Shift(by) => {
                    fits(width, by.len())?;
                    let wait = waiting.get_or_insert_with(|| Waiting::none(width));
                    wait.shift.iter_mut().zip(&by).for_each(|(s, b)| *s += b);
                }
                Layer::Linear {
                    columns,
                    weights,
                    bias,
                } => {
                    fits(width, columns)?;
                    width = bias.len();
                    steps.push(Step::Linear(folded(waiting.take(), columns, weights, bias)));
                }
                Layer::Activation(activation) => {
                    settle(&mut steps, waiting.take());
                    steps.push(Step::Activation(activation));
                }
                Layer::Normalise {
                    epsilon,
                    scale,
                    shift,
                } => {
                    settle(&mut steps, waiting.take());
                    fits(width, scale.len())?;
                    fits(width, shift.len())?;
                    steps.push(Step::Normalise { epsilon });
                    waiting = Some(Waiting { scale, shift });
                }
            }
            widest = widest.max(width);
        }
        settle(&mut steps, waiting);
        if !matches!(steps.last(), Some(Step::Linear(_))) || channels == 0 || width == 0 {
            return Err(invalid(
                "a network must end in a linear layer; export it again",
            ));
        }
        let found = Network {
            channels,
            size: width,
            widest,
            steps,
            arch: Arch::new(),
        };
        ROOM.with_borrow_mut(|room| found.grow(room));
        Ok(found)
    }

    /// Allocate for the most columns side by side, twice: before and after a layer.
    fn grow(&self, room: &mut Vec<f32>) {
        let wanted = 2 * COLUMNS * layers::stride(self.widest);
        if room.len() < wanted {
            room.resize(wanted, 0.0);
        }
    }

    /// Number of trained parameters.
    pub fn parameters(&self) -> usize {
        let of = |step: &Step| match step {
            Step::Linear(layer) => layer.rows * (layer.columns + 1),
            _ => 0,
        };
        self.steps.iter().map(of).sum()
    }

    /// The same network seen through a linear map: `weights` (M, M2), `offset` (M2,).
    pub fn project(&self, weights: &[f64], offset: &[f64]) -> Result<Network> {
        let count = offset.len();
        if weights.len() != self.size * count {
            return Err(invalid(format!(
                "{} weights, expected {} times {count}",
                weights.len(),
                self.size
            )));
        }
        let mut found = self.clone();
        let Some(Step::Linear(last)) = found.steps.last_mut() else {
            unreachable!("a network ends in a linear layer")
        };
        let through = |values: &dyn Fn(usize) -> f32, m: usize| -> f64 {
            (0..self.size)
                .map(|i| weights[i * count + m] * f64::from(values(i)))
                .sum()
        };
        let columns = last.columns;
        let rows: Vec<f64> = (0..count * columns)
            .map(|k| through(&|i| last.weight(i, k % columns), k / columns))
            .collect();
        let bias: Vec<f64> = (0..count)
            .map(|m| through(&|i| last.bias[i], m) + offset[m])
            .collect();
        *last = Linear::new(columns, &rows, &bias);
        found.size = count;
        found.widest = found.widths().max().unwrap_or(0);
        ROOM.with_borrow_mut(|room| found.grow(room));
        Ok(found)
    }

    /// Numbers between its layers, and at both ends.
    fn widths(&self) -> impl Iterator<Item = usize> {
        let rows = self.steps.iter().filter_map(|step| match step {
            Step::Linear(layer) => Some(layer.rows),
            _ => None,
        });
        rows.chain([self.channels])
    }

    /// Run `N` columns; `first(n, c)` is input c of column n, and `take(n, outputs)` receives the
    /// outputs.
    #[inline(always)]
    fn columns<const N: usize>(
        &self,
        tangents: bool,
        first: impl Fn(usize, usize) -> f64,
        mut take: impl FnMut(usize, &[f32]),
    ) {
        let stride = layers::stride(self.widest);
        ROOM.with_borrow_mut(|room| {
            self.grow(room);
            let (x, next) = room[..2 * N * stride].split_at_mut(N * stride);
            for n in 0..N {
                (0..self.channels).for_each(|c| x[n * stride + c] = first(n, c) as f32);
            }
            let found = self.arch.dispatch(Pass::<N> {
                steps: &self.steps,
                width: self.channels,
                x: Columns {
                    numbers: x,
                    stride,
                    tangents,
                },
                next: Columns {
                    numbers: next,
                    stride,
                    tangents,
                },
            });
            (0..N).for_each(|n| take(n, &found[n * stride..][..self.size]));
        });
    }

    /// The outputs at up to `COLUMNS` commands.
    fn some(&self, rows: &[f64], out: &mut [f64]) {
        let (channels, size, count) = (self.channels, self.size, rows.len() / self.channels);
        // If fewer commands are given than columns, the last one is repeated.
        let first = |n: usize, c: usize| rows[n.min(count - 1) * channels + c];
        let take = |n: usize, found: &[f32]| {
            if n < count {
                let row = out[n * size..(n + 1) * size].iter_mut();
                row.zip(found).for_each(|(out, v)| *out = f64::from(*v));
            }
        };
        match count {
            1 => self.columns::<1>(false, first, take),
            2 => self.columns::<2>(false, first, take),
            3 => self.columns::<3>(false, first, take),
            4 => self.columns::<4>(false, first, take),
            _ => self.columns::<COLUMNS>(false, first, take),
        }
    }

    /// The slopes (M, C) at `u`, and the outputs where requested; one pass where there are up
    /// to seven channels.
    fn slopes(&self, u: &[f64], mut values: Option<&mut [f64]>, slopes: &mut [f64]) {
        let channels = self.channels;
        for c in (0..channels).step_by(COLUMNS - 1) {
            let some = (channels - c).min(COLUMNS - 1);
            let first = |n: usize, k: usize| match n.checked_sub(1) {
                None => u[k],
                Some(n) => f64::from(k == c + n),
            };
            let take = |n: usize, found: &[f32]| match n.checked_sub(1) {
                None => {
                    let both = values.iter_mut().flat_map(|values| values.iter_mut());
                    both.zip(found).for_each(|(out, v)| *out = f64::from(*v));
                }
                Some(n) if n < some => {
                    for (row, v) in slopes.chunks_exact_mut(channels).zip(found) {
                        row[c + n] = f64::from(*v);
                    }
                }
                Some(_) => {}
            };
            match some {
                1 => self.columns::<2>(true, first, take),
                2 => self.columns::<3>(true, first, take),
                3 => self.columns::<4>(true, first, take),
                _ => self.columns::<COLUMNS>(true, first, take),
            }
        }
    }
}

/// One run through all layers.
struct Pass<'a, const N: usize> {
    steps: &'a [Step],
    width: usize,
    x: Columns<'a, N>,
    next: Columns<'a, N>,
}

impl<'a, const N: usize> WithSimd for Pass<'a, N> {
    type Output = &'a [f32];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> &'a [f32] {
        let Pass {
            steps,
            mut width,
            mut x,
            mut next,
        } = self;
        for step in steps {
            match step {
                Step::Linear(layer) => {
                    layer.apply(simd, &x, &mut next);
                    width = layer.rows;
                    std::mem::swap(&mut x, &mut next);
                }
                Step::Activation(of) => of.apply(&mut x, width),
                Step::Normalise { epsilon } => normalise(&mut x, width, *epsilon),
                Step::Affine { scale, shift } => affine(&mut x, scale, shift),
            }
        }
        x.numbers
    }
}

impl Shape for Network {
    fn channels(&self) -> usize {
        self.channels
    }

    fn size(&self) -> usize {
        self.size
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        self.some(u, out);
    }

    fn eval_rows(&self, rows: &[f64], out: &mut [f64]) {
        let rows = rows.chunks(COLUMNS * self.channels);
        for (rows, out) in rows.zip(out.chunks_mut(COLUMNS * self.size)) {
            self.some(rows, out);
        }
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        self.slopes(u, None, out);
    }

    fn with_slopes(&self, u: &[f64], values: &mut [f64], slopes: &mut [f64], _work: &mut Work) {
        self.slopes(u, Some(values), slopes);
    }
}

#[cfg(test)]
mod tests;

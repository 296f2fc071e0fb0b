//! A trained network as a shape: commands in, points of the body out, with exact slopes.
//!
//!   x₀ = u,   x_{k+1} = a_k(W_k x_k + b_k),   out = W x + b
//!
//! with Relu, Gelu (Hendrycks & Gimpel 2016, arXiv:1606.08415) or a normalised layer (Ba et al. 2016, arXiv:1607.06450) as a_k. Constants
//! before and after a linear layer are folded into it in double precision when the file is read (`onnx.rs`); the layers then run in single
//! precision, several commands side by side, or one command with its slopes (a tangent for each channel) in the same pass.
//! Limits: values are right to some 1e-6 of the size of the outputs; at a kink of Relu the slope is that of the side above.

mod layers;
mod onnx;

pub use layers::LANES;
use layers::{Activation, Lanes, Linear, normalise};

use crate::error::{Result, invalid};
use crate::modes::wide;
use crate::shape::Shape;

/// A layer as it stands in a file.
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
    /// y = s x + t, number by number.
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
}

/// x ↦ scale·x + shift, number by number, which waits for a linear layer.
struct Waiting {
    scale: Vec<f64>,
    shift: Vec<f64>,
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
        Ok(Network {
            channels,
            size: width,
            widest,
            steps,
        })
    }

    /// Numbers that were trained.
    pub fn parameters(&self) -> usize {
        let of = |step: &Step| match step {
            Step::Linear(layer) => layer.weights.len() + layer.bias.len(),
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
        let rows = (0..count * columns)
            .map(|k| through(&|i| last.weights[i * columns + k % columns], k / columns) as f32);
        let (rows, bias) = (
            rows.collect(),
            (0..count).map(|m| (through(&|i| last.bias[i], m) + offset[m]) as f32),
        );
        let bias = bias.collect();
        *last = Linear {
            columns,
            weights: rows,
            bias,
        };
        found.size = count;
        found.widest = found.widest.max(count);
        Ok(found)
    }

    /// Run all layers on `x`, `count` lanes of which are asked for; as `tangents` lane 0 is the value and the others slopes.
    fn run(&self, x: &mut Vec<Lanes>, biased: &Lanes, count: usize, tangents: bool) {
        x.reserve(self.widest);
        let mut next: Vec<Lanes> = Vec::with_capacity(self.widest);
        for step in &self.steps {
            match step {
                Step::Linear(layer) => {
                    next.clear();
                    next.resize(layer.bias.len(), [0.0; LANES]);
                    wide(
                        #[inline(always)]
                        || layer.apply(x, biased, &mut next),
                    );
                    std::mem::swap(x, &mut next);
                }
                Step::Activation(of) if tangents => {
                    x.iter_mut().for_each(|v| of.with_slopes(v, count))
                }
                Step::Activation(of) => x
                    .iter_mut()
                    .for_each(|v| v[..count].iter_mut().for_each(|v| *v = of.at(*v).0)),
                Step::Normalise { epsilon } => normalise(x, *epsilon, tangents),
                Step::Affine { scale, shift } => {
                    for ((v, s), t) in x.iter_mut().zip(scale).zip(shift) {
                        (0..LANES).for_each(|k| v[k] = v[k] * s + t * biased[k]);
                    }
                }
            }
        }
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
        self.eval_rows(u, out);
    }

    fn eval_rows(&self, rows: &[f64], out: &mut [f64]) {
        let each = LANES * self.channels;
        for (rows, out) in rows.chunks(each).zip(out.chunks_mut(LANES * self.size)) {
            let count = rows.len() / self.channels;
            let mut x: Vec<Lanes> = (0..self.channels)
                .map(|c| {
                    std::array::from_fn(|k| {
                        if k < count {
                            rows[k * self.channels + c] as f32
                        } else {
                            0.0
                        }
                    })
                })
                .collect();
            self.run(&mut x, &[1.0; LANES], count, false);
            for k in 0..count {
                (0..self.size).for_each(|m| out[k * self.size + m] = f64::from(x[m][k]));
            }
        }
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let mut biased = [0.0; LANES];
        biased[0] = 1.0;
        for first in (0..self.channels).step_by(LANES - 1) {
            let some = (self.channels - first).min(LANES - 1);
            let along = |c: usize, k: usize| {
                if k > 0 && c == first + k - 1 {
                    1.0
                } else {
                    0.0
                }
            };
            let mut x: Vec<Lanes> = (0..self.channels)
                .map(|c| std::array::from_fn(|k| if k == 0 { u[c] as f32 } else { along(c, k) }))
                .collect();
            self.run(&mut x, &biased, some + 1, true);
            for (m, lanes) in x.iter().enumerate() {
                (0..some)
                    .for_each(|k| out[m * self.channels + first + k] = f64::from(lanes[k + 1]));
            }
        }
    }
}

impl Waiting {
    fn none(width: usize) -> Waiting {
        Waiting {
            scale: vec![1.0; width],
            shift: vec![0.0; width],
        }
    }
}

/// W (s x + t) + b as one layer.
fn folded(
    before: Option<Waiting>,
    columns: usize,
    mut weights: Vec<f64>,
    mut bias: Vec<f64>,
) -> Linear {
    if let Some(before) = before {
        for (row, bias) in weights.chunks_exact_mut(columns).zip(&mut bias) {
            *bias += row
                .iter()
                .zip(&before.shift)
                .map(|(w, t)| w * t)
                .sum::<f64>();
            row.iter_mut().zip(&before.scale).for_each(|(w, s)| *w *= s);
        }
    }
    Linear {
        columns,
        weights: weights.iter().map(|w| *w as f32).collect(),
        bias: bias.iter().map(|b| *b as f32).collect(),
    }
}

/// What waits after the last of `steps`: s (W x + b) + t as one layer, else a step of its own.
fn settle(steps: &mut Vec<Step>, after: Option<Waiting>) {
    let Some(after) = after else { return };
    let Some(Step::Linear(layer)) = steps.last_mut() else {
        let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect();
        steps.push(Step::Affine {
            scale: single(after.scale),
            shift: single(after.shift),
        });
        return;
    };
    for (r, row) in layer.weights.chunks_exact_mut(layer.columns).enumerate() {
        row.iter_mut()
            .for_each(|w| *w = (f64::from(*w) * after.scale[r]) as f32);
        layer.bias[r] = (f64::from(layer.bias[r]) * after.scale[r] + after.shift[r]) as f32;
    }
}

#[cfg(test)]
mod tests;

//! Constants before and after a linear layer, folded into it in double precision when a file is
//! read.

use super::Step;
use super::layers::Linear;

/// x ↦ scale·x + shift, elementwise, to be folded into a linear layer.
pub(super) struct Waiting {
    pub scale: Vec<f64>,
    pub shift: Vec<f64>,
}

impl Waiting {
    pub fn none(width: usize) -> Waiting {
        Waiting {
            scale: vec![1.0; width],
            shift: vec![0.0; width],
        }
    }
}

/// W (s x + t) + b as one layer.
pub(super) fn folded(
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
    Linear::new(columns, &weights, &bias)
}

/// Fold the pending map into the last of `steps`: s (W x + b) + t as one layer, else add a separate
/// step.
pub(super) fn settle(steps: &mut Vec<Step>, after: Option<Waiting>) {
    let Some(after) = after else { return };
    let Some(Step::Linear(layer)) = steps.last_mut() else {
        let single = |values: Vec<f64>| values.into_iter().map(|v| v as f32).collect();
        steps.push(Step::Affine {
            scale: single(after.scale),
            shift: single(after.shift),
        });
        return;
    };
    for r in 0..layer.rows {
        for c in 0..layer.columns {
            let weight = layer.weight_mut(r, c);
            *weight = (f64::from(*weight) * after.scale[r]) as f32;
        }
        layer.bias[r] = (f64::from(layer.bias[r]) * after.scale[r] + after.shift[r]) as f32;
    }
}

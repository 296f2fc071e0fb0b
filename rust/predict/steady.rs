//! A predictor under constant conditions, as a shape: the model of inverse kinematics.
//!
//! out = prior(u) + Σ c_k(u)·field_k(u) + …, u the effective command, without sensing. Slopes of
//! the prior are its own. Slopes of the load responses are central differences over [`STEP`] to
//! both sides, because they change slowly. Shape effects with memory are at rest, without memory.

use super::Predictor;
use super::job::Body;
use crate::effects::{Chain, Context};
use crate::error::{Result, invalid};
use crate::shape::modes::accumulate;
use crate::shape::{Shape, Work};
use std::sync::Arc;

/// mm of command.
const STEP: f64 = 0.02;

struct Still {
    predictor: Arc<Predictor>,
    body: Body,
    chain: Chain,
    params: Vec<f64>,
    /// Memory of the chain's shape effects (M,): none.
    relaxed: Vec<f64>,
    context: Context,
}

/// The outputs of `predictor` under the shape and prior effects of a chain with `params` (P,), in
/// one context: its prior if there are no loads.
pub fn still(
    predictor: &Arc<Predictor>,
    chain: &Chain,
    params: &[f64],
    context: Context,
) -> Result<Arc<dyn Shape>> {
    chain.check(params)?;
    let body = predictor.body.changed(&chain.factors(params))?;
    let channels = body.prior.channels();
    if chain.channels() != channels {
        return Err(invalid(format!(
            "the chain has {} channels, the prior {channels}; make the chain for this model",
            chain.channels()
        )));
    }
    // A missing field is reported here, at home and to both sides of it; later it would be ignored.
    let relaxed = vec![0.0; chain.remembered()];
    let mut loaded = false;
    for side in 0..=2 * channels {
        let mut u = vec![0.0; channels];
        if let Some(side) = side.checked_sub(1) {
            u[side / 2] = if side % 2 == 0 { 1.0 } else { -1.0 };
        }
        let loads = predictor.loads_at(chain, params, &u, &relaxed, &context)?;
        loaded |= loads.iter().any(|c| *c != 0.0);
    }
    if !loaded {
        return Ok(body.prior);
    }
    Ok(Arc::new(Still {
        predictor: predictor.clone(),
        body,
        chain: chain.clone(),
        params: params.to_vec(),
        relaxed,
        context,
    }))
}

impl Still {
    /// Add the response to loads at `u` to `out`.
    fn load(&self, u: &[f64], out: &mut [f64], by: f64) {
        let asked =
            self.predictor
                .loads_at(&self.chain, &self.params, u, &self.relaxed, &self.context);
        let Ok(loads) = asked else { return };
        let mut scratch = self.predictor.scratch();
        let mut moved = vec![0.0; out.len()];
        let fields = &self.body.fields;
        self.predictor
            .under(fields, &loads, u, &mut scratch, &mut moved);
        accumulate(out, &moved, by);
    }
}

impl Shape for Still {
    fn channels(&self) -> usize {
        self.body.prior.channels()
    }

    fn size(&self) -> usize {
        self.body.prior.size()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        self.body.prior.eval(u, out);
        self.load(u, out, 1.0);
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        self.with_slopes(u, &mut vec![0.0; self.size()], out, &mut Work::default());
    }

    fn with_slopes(&self, u: &[f64], values: &mut [f64], slopes: &mut [f64], work: &mut Work) {
        self.body.prior.with_slopes(u, values, slopes, work);
        self.load(u, values, 1.0);
        let (channels, mut at) = (self.channels(), u.to_vec());
        for c in 0..channels {
            let mut change = vec![0.0; self.size()];
            for side in [STEP, -STEP] {
                at[c] = u[c] + side;
                self.load(&at, &mut change, 0.5 / side);
            }
            at[c] = u[c];
            for (row, change) in slopes.chunks_exact_mut(channels).zip(change) {
                row[c] += change;
            }
        }
    }
}

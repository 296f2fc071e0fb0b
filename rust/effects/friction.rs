//! Friction along the tendon: the larger the pull, the larger the reversal before it moves.
//!
//! Play whose width grows with the pull, for elements along the tendon: `y_j = clamp(y_j, x − w_j,
//! x + w_j)` with `w_j = mu·f_j·(|x| + preload)` and `f_j = (j − ½)/5`, j = 1…5, the share of the
//! wrap that lies before the element. The effective command is the mean over the elements. mm, for
//! each channel; mu ≤ 0 is none. Memory starts centred, `y_j = x`. Both bounds of the play rise
//! with x while mu < 1, so it is exact for commands monotonic between samples. Limit: to first
//! order in mu of the capstan's exponential; wrap and pull in proportion to the command.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "friction",
        family: "reversal hysteresis",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "y = mean of y_j,  y_j = clamp(y_j, x − w_j, x + w_j),  w_j = mu · f_j · (|x| + \
            preload)",
        doc: "Coulomb friction of the tendon in its guides: tension is lost along the way, the \
              more the tighter and the more it is wrapped.",
        signature: "A loop between loading and unloading that is narrow near home and widens with \
              the bend; after a reversal the far end moves last.",
        reference: "Tendon friction: Kaneko and others, Int. Conf. Advanced Robotics 1991; \
              generalised play: Visintin, Differential Models of Hysteresis, Springer 1994.",
        experiment: ("small loops at a small and at a large bend", 1.5),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "mu",
                "1",
                0.0,
                0.1,
                0.01,
                0.5,
                "friction of the complete tendon: half-width of the loop at its far end, over the \
                pull",
            )
            .shared(),
            Parameter::new(
                "preload",
                "mm",
                2.0,
                2.0,
                0.2,
                10.0,
                "pull at home, as a shortening",
            )
            .shared()
            .reaching(Reach::HalfRanges(2.0)),
        ],
    },
    law: Law::Channel(&Friction),
};

struct Friction;

const ELEMENTS: usize = 5;

impl ChannelEffect for Friction {
    fn state_size(&self, channels: usize) -> usize {
        channels * ELEMENTS
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        for (x, elements) in x.iter().zip(state.chunks_exact_mut(ELEMENTS)) {
            elements.fill(*x);
        }
    }

    #[inline]
    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        let (mu, preload) = params.split_at(x.len());
        let numbers = mu.iter().zip(preload);
        let channels = x.iter_mut().zip(state.chunks_exact_mut(ELEMENTS));
        for ((x, elements), (mu, preload)) in channels.zip(numbers) {
            let (width, mut lag) = (mu.max(0.0) * (x.abs() + preload.max(0.0)), 0.0);
            for (j, y) in elements.iter_mut().enumerate() {
                let half = width * ((j as f64 + 0.5) / ELEMENTS as f64);
                *y = y.max(*x - half).min(*x + half);
                lag += *x - *y;
            }
            *x -= lag / ELEMENTS as f64;
        }
    }
}

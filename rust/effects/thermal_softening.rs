//! Thermal softening: a warmer body bends further under the same command.
//!
//! `y = x·(1 + rate/100·(T − T₀))`, `T₀` the first temperature of the run, which is memory; without
//! a temperature it does nothing. It is linear in the rate, so a fit needs no start; a hardening
//! body has a negative rate. Limit: the complete body has the temperature of the run.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "thermal_softening",
        family: "slow drift",
        stage: Stage::Material,
        kind: Kind::Effect,
        formula: "y = x · (1 + rate/100 · (T − T₀))",
        doc: "Rubber and tendon change with temperature, from the motors next to them or from the \
            room.",
        signature: "Error in proportion to the command that follows the temperature, whatever the \
            moves.",
        reference: "Treloar, The Physics of Rubber Elasticity, 1975.",
        experiment: (
            "the same moves before and after a warm-up, temperature recorded",
            5.0,
        ),
        alike: &[],
        needs: &["temperature"],
        parameters: &[Parameter::new(
            "rate",
            "%/K",
            0.0,
            0.5,
            -6.0,
            6.0,
            "change of the response for each kelvin above the first temperature",
        )],
    },
    law: Law::Channel(&ThermalSoftening),
};

struct ThermalSoftening;

impl ChannelEffect for ThermalSoftening {
    /// Whether a temperature was declared, and the first one.
    fn state_size(&self, _channels: usize) -> usize {
        2
    }

    fn settle(&self, _params: &[f64], _x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        if !context.temperature.is_finite() {
            return;
        }
        if state[0] == 0.0 {
            state.copy_from_slice(&[1.0, context.temperature]);
        }
        let more = 0.01 * params[0] * (context.temperature - state[1]);
        x.iter_mut().for_each(|x| *x += *x * more);
    }
}

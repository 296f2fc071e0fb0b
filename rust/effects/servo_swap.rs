//! Servo swap: one servo is reversed, or two are exchanged; a fault, not physics.
//!
//! An integer is the case: 0 none, 1…C the sign of that channel, then the exchanged pairs (0,1),
//! (0,2), …. Up to nine channels, the list has every pair, 45 cases; with more, only neighbours, so
//! it is linear in the channels. The value is rounded to the nearest integer; beyond the list it
//! has no effect. No memory. Limit: one exchange or one sign; two faults at once are not in the
//! list.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "servo_swap",
        family: "wiring",
        stage: Stage::Command,
        kind: Kind::Fault,
        formula: "x = u with one sign turned, or two channels exchanged",
        doc: "A servo is wired or mounted the other way round, or two have each other’s place.",
        signature: "Gross error in one direction of command, mirrored or on another axis, none at \
            home.",
        reference: "Signed permutations of the channels, one at a time.",
        experiment: ("each channel alone, one after the other", 0.5),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "case",
            "1",
            0.0,
            1.0,
            1.0,
            511.0,
            "0 none; 1 to C: that channel’s sign; beyond: the pairs exchanged, in order",
        )
        .integer()
        .up_to(cases)
        .meaning(meaning)],
    },
    law: Law::Channel(&ServoSwap),
};

struct ServoSwap;

/// Most channels for which every pair can be exchanged; beyond, only neighbours.
const EVERY_PAIR: usize = 9;

/// The number of cases for a number of channels.
fn cases(channels: usize) -> usize {
    let far = channels <= EVERY_PAIR;
    channels
        + if far {
            channels * channels.saturating_sub(1) / 2
        } else {
            channels - 1
        }
}

/// The channels exchanged as number `at` (from 0) of the list of pairs.
fn exchanged(at: usize, channels: usize) -> (usize, usize) {
    if channels > EVERY_PAIR {
        return (at, at + 1);
    }
    let (mut first, mut rest) = (0, at);
    while rest >= channels - 1 - first {
        rest -= channels - 1 - first;
        first += 1;
    }
    (first, first + 1 + rest)
}

/// The fault of a case.
enum Case {
    Nothing,
    Turned(usize),
    Exchanged(usize, usize),
}

fn case(number: f64, channels: usize) -> Case {
    let number = number.round();
    if !(1.0..=cases(channels) as f64).contains(&number) {
        return Case::Nothing;
    }
    let at = number as usize - 1;
    if at < channels {
        return Case::Turned(at);
    }
    let (a, b) = exchanged(at - channels, channels);
    Case::Exchanged(a, b)
}

fn meaning(number: f64, channels: usize) -> String {
    match case(number, channels) {
        Case::Nothing => "nothing is swapped".to_string(),
        Case::Turned(at) => format!("channel {at} runs the wrong way"),
        Case::Exchanged(a, b) => format!("channels {a} and {b} are exchanged"),
    }
}

impl ChannelEffect for ServoSwap {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        match case(params[0], x.len()) {
            Case::Nothing => {}
            Case::Turned(at) => x[at] = -x[at],
            Case::Exchanged(a, b) => x.swap(a, b),
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_is_another_and_nothing_is_forgotten() {
        for channels in [0, 1, 2, 3, 6, 9, 10, 256] {
            let mut seen = vec![];
            for case in 0..=cases(channels) + 1 {
                let mut x: Vec<f64> = (1..=channels).map(|c| c as f64).collect();
                ServoSwap.settle(&[case as f64], &mut x, &mut []);
                seen.push(x);
            }
            assert_eq!(
                seen.first(),
                seen.last(),
                "0 and beyond the list are nothing"
            );
            seen.pop();
            let count = seen.len();
            seen.sort_by(|a, b| a.partial_cmp(b).unwrap());
            seen.dedup();
            assert_eq!(
                (seen.len(), count),
                (cases(channels) + 1, cases(channels) + 1)
            );
        }
        assert_eq!(cases(256), 511);
        let said = [0.0, 2.0, 3.0, 4.0].map(|number| meaning(number, 2));
        assert_eq!(
            said.each_ref().map(String::as_str),
            [
                "nothing is swapped",
                "channel 1 runs the wrong way",
                "channels 0 and 1 are exchanged",
                "nothing is swapped"
            ]
        );
    }
}

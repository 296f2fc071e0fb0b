//! Memory: rate-independent hysteresis. The error depends on past reversals of the command, not on
//! speed.
//!
//! Play operators of all widths span every Prandtl-Ishlinskii hysteresis; times |x|, the loop can
//! grow with the bend. Such loops close after each small cycle. Dahl elements keep drifting, like
//! sheaths and the Bouc-Wen model. Source: M. Brokate, J. Sprekels, Hysteresis and Phase
//! Transitions (1996), ch. 2.

use super::declaration::*;
use super::operators::{dahl, geometric, play, with};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "memory",
    kind: Kind::Memory,
    doc: "Loading and unloading give different shapes at the same command, at any speed: backlash, \
        friction or hysteresis.",
    experiment: ("triangles of growing size, up and back, at one speed", 2.0),
    mimics: &["delay", "rate", "creep"],
    members: &["backlash", "friction", "hysteresis", "body_friction"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// Number of half widths. Every third one is also multiplied by |x|.
const WIDTHS: usize = 12;
const THIRD: usize = 3;

/// Half widths in half ranges, from barely visible to nearly the full range.
fn widths(wide: bool) -> [f64; WIDTHS] {
    if wide {
        // A static map learned on data with play can hide a play of up to the full range.
        geometric(0.03, 1.9)
    } else {
        geometric(0.012, 0.9)
    }
}

/// Number of Dahl elements, and of those whose powers count too: their reaches are from barely
/// visible to beyond the range.
const ELEMENTS: usize = 3;
const REACHES: usize = 6;

/// Half widths of the plays of other channels that drag this one along.
const DRAGGED: [f64; 3] = [0.08, 0.2, 0.5];
/// Most channels for which other channels are tried, on a map that is not free: beyond, a run
/// cannot identify so many columns.
const OTHERS: usize = 3;

/// Output of the play minus its input, of the channel and of the others, and of Dahl elements, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let (x, half) = (&series.x[channel], series.half[channel]);
    let mut out = vec![0.0; series.samples()];
    let lost = |width: f64, out: &mut [f64]| {
        play(x, width, out);
        with(out, x, |y, x| half * (y - x));
    };
    let widths = widths(false);
    for width in widths {
        lost(width, &mut out);
        emit(&out);
    }
    for width in widths.into_iter().skip(THIRD - 1).step_by(THIRD) {
        lost(width, &mut out);
        with(&mut out, x, |column, x| column * x.abs());
        emit(&out);
    }
    for reach in geometric::<ELEMENTS>(0.06, 0.9) {
        dahl(x, reach, &mut out);
        with(&mut out, x, |z, _| half * z);
        emit(&out);
    }
    let others = series.x.iter().enumerate();
    let few = series.channels() <= OTHERS && !series.free_map;
    for (_, y) in others.filter(|(other, _)| *other != channel && few) {
        for width in DRAGGED {
            play(y, width, &mut out);
            with(&mut out, y, |held, y| half * (held - y));
            emit(&out);
        }
    }
}

fn signals(series: &Series, channel: usize, wide: bool, emit: Emit) {
    let mut out = vec![0.0; series.samples()];
    for width in widths(wide) {
        play(&series.x[channel], width, &mut out);
        emit(&out);
    }
    for reach in geometric::<REACHES>(0.03, 3.0) {
        dahl(&series.x[channel], reach, &mut out);
        emit(&out);
    }
}

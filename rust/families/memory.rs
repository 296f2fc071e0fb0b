//! Memory: the error depends on the last reversals of the command, at whatever speed (play, friction, hysteresis).
//!
//! The play operators of all widths span every hysteresis of Prandtl and Ishlinskii; times |x| it may grow with the bend.
//! Source: M. Brokate, J. Sprekels, Hysteresis and Phase Transitions (1996), ch. 2.

use super::declaration::*;
use super::operators::{geometric, play, with};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "memory",
    kind: Kind::Memory,
    doc: "The shape at a command depends on where the last reversals were, not on speed: a loop between there and back.",
    mimics: &["delay", "rate", "creep"],
    members: &["backlash", "friction", "hysteresis"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// Numbers of widths, and every third of them counts times |x| too.
const WIDTHS: usize = 12;
const THIRD: usize = 3;

/// Half widths from play that hardly shows to play that eats nearly the whole range, in half ranges.
fn widths(wide: bool) -> [f64; WIDTHS] {
    if wide {
        // A map that is learned with the play may have taken up to all of the motion.
        geometric(0.03, 1.9)
    } else {
        geometric(0.012, 0.9)
    }
}

/// What the play holds back, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let (x, half) = (&series.x[channel], series.half[channel]);
    let mut out = vec![0.0; series.samples()];
    let held_back = |width: f64, out: &mut [f64]| {
        play(x, width, out);
        with(out, x, |y, x| half * (y - x));
    };
    let widths = widths(false);
    for width in widths {
        held_back(width, &mut out);
        emit(&out);
    }
    for width in widths.into_iter().skip(THIRD - 1).step_by(THIRD) {
        held_back(width, &mut out);
        with(&mut out, x, |column, x| column * x.abs());
        emit(&out);
    }
}

fn signals(series: &Series, channel: usize, wide: bool, emit: Emit) {
    let mut out = vec![0.0; series.samples()];
    for width in widths(wide) {
        play(&series.x[channel], width, &mut out);
        emit(&out);
    }
}

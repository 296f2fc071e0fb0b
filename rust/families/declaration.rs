//! What a family of effects declares about itself: what it depends on, what it acts on, and what can draw the same.
//!
//! A *family* is everything that depends on the same things (the command now, its history, time, …) without saying by which
//! law. Its representative is linear: *columns* that are added to a channel's command at full rate, and *fields*, changes of
//! the shape, multiplied by *modulations*. Effects of the library that may stand for a family are its members.

use super::series::{Seen, Series};

/// What a family's error depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// On what is commanded now.
    Static,
    /// On what was commanded before.
    Memory,
    /// On a declared condition.
    Condition,
    /// On the time since the run began.
    Time,
}

impl Kind {
    pub fn name(self) -> &'static str {
        match self {
            Kind::Static => "static",
            Kind::Memory => "memory",
            Kind::Condition => "condition",
            Kind::Time => "time",
        }
    }
}

/// Takes one column after another; each is gone when the next is computed, so a long record is never held for all of them.
pub type Emit<'a> = &'a mut dyn FnMut(&[f64]);

/// Gives the columns (T,) mm that act on the command of one channel of a series.
pub type Columns = fn(&Series, usize, Emit);

/// Gives the signals (T,) of one channel in half ranges; widely spaced where the static map is learned with them.
pub type Signals = fn(&Series, usize, bool, Emit);

/// Gives the rows (K,) by which a field is multiplied at the seen times.
pub type Modulation = fn(&Seen, Emit);

/// A declared family.
#[derive(Debug)]
pub struct Family {
    pub name: &'static str,
    pub kind: Kind,
    /// One sentence for users.
    pub doc: &'static str,
    /// Fields of a run that must be declared and vary within it.
    pub needs: &'static [&'static str],
    /// Families that can draw the same where a run does not tell them apart.
    pub mimics: &'static [&'static str],
    /// Effects of the library that may stand for it.
    pub members: &'static [&'static str],
    pub columns: Option<Columns>,
    pub signals: Option<Signals>,
    /// Effects whose signatures are its fields.
    pub fields: &'static [&'static str],
    /// Leading spatial modes that are its fields too.
    pub modes: usize,
    pub modulation: Modulation,
}

/// A family without anything: what a declaration leaves out.
pub const NOTHING: Family = Family {
    name: "",
    kind: Kind::Static,
    doc: "",
    needs: &[],
    mimics: &[],
    members: &[],
    columns: None,
    signals: None,
    fields: &[],
    modes: 0,
    modulation: alone,
};

impl Family {
    /// Whether it changes the shape by fields.
    pub fn has_fields(&self) -> bool {
        self.modes > 0 || !self.fields.is_empty()
    }
}

/// A field as it is.
pub fn alone(seen: &Seen, emit: Emit) {
    emit(&vec![1.0; seen.share.len()]);
}

/// A field, and it times x and x² of every channel.
pub fn by_command(seen: &Seen, emit: Emit) {
    alone(seen, emit);
    for x in &seen.x {
        emit(x);
        emit(&x.iter().map(|x| x * x).collect::<Vec<f64>>());
    }
}

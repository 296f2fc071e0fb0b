//! Declaration of an effect family: its inputs, its linear representative, its members, and the
//! families it can mimic.
//!
//! A *family* groups all effects that depend on the same inputs (present command, command history,
//! time, …), whatever their law. Its representative is linear: *columns* are added to the command
//! of a channel at full rate; *fields* are changes of shape, multiplied by *modulations*. The
//! *members* are the effects of the library that belong to the family.

use super::series::{Seen, Series};

/// Input that the error of a family depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The present command.
    Static,
    /// The history of the command.
    Memory,
    /// A declared condition, such as temperature.
    Condition,
    /// The time since the start of the run.
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

/// Consumer of columns. It receives one column at a time, so memory does not grow with their number
/// at full rate.
pub type Emit<'a> = &'a mut dyn FnMut(&[f64]);

/// Emit the columns (T,) mm that are added to the command of one channel.
pub type Columns = fn(&Series, usize, Emit);

/// Emit the signals (T,) of one channel in half ranges. The flag selects wide spacing, for models
/// whose static map is learned together with the memory.
pub type Signals = fn(&Series, usize, bool, Emit);

/// Emit the rows (K,) that multiply each field at the capture times.
pub type Modulation = fn(&Seen, Emit);

/// A family as declared.
#[derive(Debug)]
pub struct Family {
    pub name: &'static str,
    pub kind: Kind,
    /// One sentence for users: what the error looks like.
    pub doc: &'static str,
    /// Fields of a run that must be declared and must vary.
    pub needs: &'static [&'static str],
    /// Families that can produce the same error if the run cannot distinguish them.
    pub mimics: &'static [&'static str],
    /// Experiment that separates the family from those it can mimic, and its minutes; empty if
    /// there is none.
    pub experiment: (&'static str, f64),
    /// Effects of the library that belong to the family.
    pub members: &'static [&'static str],
    pub columns: Option<Columns>,
    pub signals: Option<Signals>,
    /// Effects whose signatures serve as fields.
    pub fields: &'static [&'static str],
    /// Number of leading spatial modes that serve as fields.
    pub modes: usize,
    pub modulation: Modulation,
}

/// Defaults of a declaration: no columns, no fields.
pub const NOTHING: Family = Family {
    name: "",
    kind: Kind::Static,
    doc: "",
    needs: &[],
    mimics: &[],
    experiment: ("", 0.0),
    members: &[],
    columns: None,
    signals: None,
    fields: &[],
    modes: 0,
    modulation: constant,
};

impl Family {
    /// Whether the family has fields.
    pub fn has_fields(&self) -> bool {
        self.modes > 0 || !self.fields.is_empty()
    }
}

/// Use each field once, unchanged.
pub fn constant(seen: &Seen, emit: Emit) {
    emit(&vec![1.0; seen.share.len()]);
}

/// Use each field unchanged, and times x and x² of every channel.
pub fn by_command(seen: &Seen, emit: Emit) {
    constant(seen, emit);
    for x in &seen.x {
        emit(x);
        emit(&x.iter().map(|x| x * x).collect::<Vec<f64>>());
    }
}

//! The declaration of an effect, and its four possible roles.
//!
//! A *channel* effect changes the C commands (mm) and may have memory. A *shape* effect gives the
//! coefficients of named fields. A *sensing* effect moves the measured points. A *prior* effect
//! changes a parameter of the prior. At null parameters each is the identity. All memory is in flat
//! slices owned by the caller, so it can be copied, reset and replayed.

use super::conditions::{Conditions, Context};
use crate::error::Result;

pub use super::conditions::Camera;
pub use crate::response::loads::*;

/// Where in the path from command to camera an effect acts; chains are composed in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    Command,
    Transmission,
    Material,
    Shape,
    Sensing,
}

impl Stage {
    pub fn name(self) -> &'static str {
        match self {
            Stage::Command => "command",
            Stage::Transmission => "transmission",
            Stage::Material => "material",
            Stage::Shape => "shape",
            Stage::Sensing => "sensing",
        }
    }
}

/// Physics of the robot, or a fault of the measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Effect,
    Fault,
}

/// One number of an effect. At `null` the effect is absent; fits search from `low` to `high`,
/// starting at `start`.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    pub name: &'static str,
    pub unit: &'static str,
    /// Always valid, even outside [low, high]. If another parameter switches the effect off, this
    /// is a typical value.
    pub null: f64,
    /// A plausible strength: where a search begins and at which signatures are compared.
    pub start: f64,
    pub low: f64,
    pub high: f64,
    pub doc: &'static str,
    /// One number for the robot, or one for each channel or pair.
    pub each: Each,
    /// An integer: it has no slope, so fits try each value from low to high as a start and keep it.
    pub integer: bool,
    /// A time within the run, far enough from its ends that both sides of it are visible.
    pub instant: bool,
    /// How far beyond `high` a fit may go if the data require it.
    pub reach: Reach,
    /// The upper end of the search while a static map of the commands is fitted as well.
    pub with_map: WithMap,
    /// For an integer that counts channels: the highest meaningful value.
    pub most: Option<fn(usize) -> usize>,
    /// For an integer that encodes a case: its meaning, for a number of channels.
    pub meaning: Option<fn(f64, usize) -> String>,
}

/// How far a fit may go beyond the plausible range of a parameter, in a measure of the robot
/// itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reach {
    /// Not at all.
    High,
    /// So many times half the range of the commands.
    HalfRanges(f64),
    /// A weight that would move the tip sideways by so many body lengths with a linear response.
    Lengths(f64),
}

/// The upper end of a search while a static map of the commands is fitted as well. The scale of such
/// a map is free, and its output may be a force: an effect may then take up almost all motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WithMap {
    /// That of other fits.
    High,
    /// So many times half the range of the commands.
    HalfRanges(f64),
    /// So much, in the unit of the parameter.
    UpTo(f64),
}

/// The objects that a parameter has a number for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Each {
    Robot,
    Channel,
    /// One for each channel, all equal unless the data require more: fits move them together, and
    /// one label without an index is used for all of them (`Chain::tie`).
    Shared,
    /// As [`Each::Shared`], with one for each of the two cables that a channel pulls: that of +x,
    /// then that of −x.
    Cable,
    /// What [`pairs`] gives.
    Pair,
}

/// Most channels for all ordered pairs; beyond, only neighbours count, so the number of pairs is
/// linear in the channels and a search stays affordable.
const EVERY_PAIR: usize = 4;

/// The ordered pairs (i, j), i ≠ j, that an effect between channels has a number for.
pub fn pairs(channels: usize) -> impl Iterator<Item = (usize, usize)> {
    let reach = if channels <= EVERY_PAIR { channels } else { 1 };
    (0..channels).flat_map(move |i| {
        let last = (i + reach).min(channels - 1);
        (i.saturating_sub(reach)..=last)
            .filter(move |j| *j != i)
            .map(move |j| (i, j))
    })
}

impl Parameter {
    /// One number for all channels, searched from `low` to `high`.
    pub const fn new(
        name: &'static str,
        unit: &'static str,
        null: f64,
        start: f64,
        low: f64,
        high: f64,
        doc: &'static str,
    ) -> Parameter {
        Parameter {
            name,
            unit,
            null,
            start,
            low,
            high,
            doc,
            each: Each::Robot,
            integer: false,
            instant: false,
            reach: Reach::High,
            with_map: WithMap::High,
            most: None,
            meaning: None,
        }
    }

    /// One number for each channel.
    pub const fn per_channel(mut self) -> Parameter {
        self.each = Each::Channel;
        self
    }

    /// One number for each channel, equal for all unless they are set separately.
    pub const fn shared(mut self) -> Parameter {
        self.each = Each::Shared;
        self
    }

    /// One number for each cable, equal for all unless they are set separately.
    pub const fn per_cable(mut self) -> Parameter {
        self.each = Each::Cable;
        self
    }

    /// One number for each of the [`pairs`] of channels.
    pub const fn per_pair(mut self) -> Parameter {
        self.each = Each::Pair;
        self
    }

    /// A whole number.
    pub const fn integer(mut self) -> Parameter {
        self.integer = true;
        self
    }

    /// A time within the run.
    pub const fn instant(mut self) -> Parameter {
        self.instant = true;
        self
    }

    /// A fit may go so far beyond `high`.
    pub const fn reaching(mut self, reach: Reach) -> Parameter {
        self.reach = reach;
        self
    }

    /// The upper end of the search while a static map is fitted as well.
    pub const fn with_map(mut self, with_map: WithMap) -> Parameter {
        self.with_map = with_map;
        self
    }

    /// Nothing beyond `most(channels)` means anything.
    pub const fn up_to(mut self, most: fn(usize) -> usize) -> Parameter {
        self.most = Some(most);
        self
    }

    /// Its values mean what `meaning(value, channels)` says.
    pub const fn meaning(mut self, meaning: fn(f64, usize) -> String) -> Parameter {
        self.meaning = Some(meaning);
        self
    }

    /// The upper end of the search for a number of channels.
    pub fn highest(&self, channels: usize) -> f64 {
        self.most.map_or(self.high, |most| {
            (most(channels) as f64).clamp(self.low, self.high)
        })
    }

    /// Whether fits search on a logarithmic scale: they do where the lower bound is positive.
    pub fn log(&self) -> bool {
        self.low > 0.0 && !self.integer
    }

    /// What follows the name in the label of each of its numbers.
    pub fn indices(&self, channels: usize) -> Vec<String> {
        match self.each {
            Each::Robot => vec![String::new()],
            Each::Channel | Each::Shared => (0..channels).map(|c| format!("[{c}]")).collect(),
            Each::Cable => (0..channels)
                .flat_map(|c| [format!("[{c}+]"), format!("[{c}-]")])
                .collect(),
            Each::Pair => pairs(channels).map(|(i, j)| format!("[{i},{j}]")).collect(),
        }
    }

    /// Whether its numbers are equal unless they are set separately.
    pub fn tied(&self) -> bool {
        matches!(self.each, Each::Shared | Each::Cable)
    }

    /// How many numbers it has.
    pub fn count(&self, channels: usize) -> usize {
        match self.each {
            Each::Robot => 1,
            Each::Channel | Each::Shared => channels,
            Each::Cable => 2 * channels,
            Each::Pair => pairs(channels).count(),
        }
    }
}

/// The declaration of an effect for pages, screens, tests and fits.
#[derive(Debug)]
pub struct Declaration {
    pub name: &'static str,
    pub family: &'static str,
    pub stage: Stage,
    pub kind: Kind,
    pub formula: &'static str,
    pub doc: &'static str,
    /// The appearance of the error while the model lacks the effect.
    pub signature: &'static str,
    pub reference: &'static str,
    /// The experiment that shows the effect, and its minutes.
    pub experiment: (&'static str, f64),
    /// Effects of the same form, and the property of a run that distinguishes them: "orientation",
    /// "load", "roll", "base" (points of the clamped base, or a model that has the other effect) or
    /// "never".
    pub alike: &'static [(&'static str, &'static str)],
    /// Fields that a run must declare for the effect.
    pub needs: &'static [&'static str],
    pub parameters: &'static [Parameter],
}

impl Declaration {
    /// Number of parameter values for `channels` channels.
    pub fn width(&self, channels: usize) -> usize {
        self.parameters.iter().map(|p| p.count(channels)).sum()
    }
}

/// A change of the commands, with or without memory.
pub trait ChannelEffect: Sync {
    /// Numbers of memory for `channels` channels.
    fn state_size(&self, _channels: usize) -> usize {
        0
    }

    /// Set `state` to the equilibrium with `x` held forever, and `x` to its output.
    fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]);

    /// Advance one sample: `x` (C,) is changed in place.
    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context);

    /// Advance a complete record `samples` (T, C) in place. The loop is compiled once per effect,
    /// with `step` inlined.
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        state: &mut [f64],
        conditions: &Conditions,
    ) {
        for (k, x) in samples.chunks_exact_mut(channels).enumerate() {
            self.step(params, x, state, &conditions.at(k));
        }
    }

    /// Reject parameters that are invalid for the effect.
    fn check(&self, _params: &[f64]) -> Result<()> {
        Ok(())
    }
}

/// A user-defined change of the commands that maps a complete record at once (`own.rs`). It has no
/// state.
pub trait RecordEffect: Sync {
    /// Change a complete record `samples` (T, C) in place, T and C at least 1. It begins in
    /// equilibrium with its first sample.
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        conditions: &Conditions,
    ) -> Result<()>;
}

/// Coefficients of shape fields.
pub trait ShapeEffect: Sync {
    /// The coefficients of the effect for a number of channels: indices into [`FIELDS`], [`TENDON`]
    /// or [`CONTACT`].
    fn fields(&self, channels: usize) -> Vec<usize>;

    /// Add the effect's coefficients to `out`, at the command `u` (C,) that acts.
    fn add(&self, params: &[f64], u: &[f64], context: &Context, out: &mut Coefficients);
}

/// Coefficients of shape fields that depend on earlier effective commands. The memory covers
/// complete records and belongs to the shape. A single state at rest has no memory.
pub trait RememberingEffect: Sync {
    /// As of [`ShapeEffect`].
    fn fields(&self, channels: usize) -> Vec<usize>;

    /// Size of the memory at every sample, for a number of channels.
    fn memory(&self, channels: usize) -> usize;

    /// Write the memory (T, M) to `out` for a complete record `samples` (T, C) of effective
    /// commands, T and C at least
    /// 1. It begins in equilibrium with the first sample.
    fn remember(&self, params: &[f64], samples: &[f64], channels: usize, out: &mut [f64]);

    /// Add the effect's coefficients to `out`, at the effective command `u` (C,) and the memory
    /// `remembered` at that time.
    fn add(
        &self,
        params: &[f64],
        u: &[f64],
        remembered: &[f64],
        context: &Context,
        out: &mut Coefficients,
    );
}

/// A change of the measured points.
pub trait SensingEffect: Sync {
    /// Move `points` (V, 3) in place; where `positions` is false, the vector is a direction, which
    /// shifts do not change.
    fn apply(
        &self,
        _params: &[f64],
        _positions: &[bool],
        _points: &mut [f64],
        _context: &Context,
        _cameras: &[Camera],
    ) {
    }

    /// Delay of the time stamp of a frame, s.
    fn late(&self, _params: &[f64]) -> f64 {
        0.0
    }
}

/// A change of a parameter of the prior.
pub trait PriorEffect: Sync {
    /// The prior's name of the parameter.
    fn number(&self) -> &'static str;

    /// The factor of the prior's own value.
    fn factor(&self, params: &[f64]) -> f64;
}

/// An effect's law in its role.
pub enum Law {
    Channel(&'static dyn ChannelEffect),
    /// Also a channel effect, user-defined.
    Record(&'static dyn RecordEffect),
    Shape(&'static dyn ShapeEffect),
    /// Also a shape effect, with memory.
    Remembering(&'static dyn RememberingEffect),
    Sensing(&'static dyn SensingEffect),
    Prior(&'static dyn PriorEffect),
}

impl Law {
    pub fn role(&self) -> &'static str {
        match self {
            Law::Channel(_) | Law::Record(_) => "channel",
            Law::Shape(_) | Law::Remembering(_) => "shape",
            Law::Sensing(_) => "sensing",
            Law::Prior(_) => "prior",
        }
    }
}

/// A declared effect.
pub struct Effect {
    pub declaration: Declaration,
    pub law: Law,
}

impl std::fmt::Debug for Effect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.declaration.name)
    }
}
